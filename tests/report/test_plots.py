"""Plots on Matplotlib's axes, and the pictures in notebooks."""

from __future__ import annotations

import base64
import importlib.metadata
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from html_campaigns import HOSTILE, make_hostile
from matplotlib import pyplot as plt
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from test_picture import HAIRPIN, SHORT, WINDING, drive_along

from frenetic import Campaign, EmbeddedSimulator, Frenetic, Planner
from frenetic._support.notebook import NotebookRepr
from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.comparison import compare_measured
from frenetic.analysis.spaces import SPACES
from frenetic.analysis.unlike import UnlikeFailures
from frenetic.campaign import CampaignStore
from frenetic.campaign.counts import Counts
from frenetic.drivers import Stanley
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.report import animate, plot, plot_progress
from frenetic.report.plots import draw_comparison
from frenetic.road import Road


@pytest.fixture(autouse=True)
def figures() -> Iterator[None]:
    """Closes all figures, and asserts that plots change no setting of Matplotlib."""
    before = mpl.rcParams.copy()
    yield
    plt.close("all")
    settings = before.keys() - {"backend"}  # pyplot chooses the backend when it first draws
    assert [name for name in settings if mpl.rcParams[name] != before[name]] == []


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A finished campaign with failures."""
    search = Campaign(
        strategy=Frenetic(seed=7),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        folder=tmp_path_factory.mktemp("plots") / "searched",
    )
    assert search.run(60).failed > 3
    return search


class Elements(HTMLParser):
    """Names of the elements in a text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.names.append(tag)


def group(*failures: int, simulations: int = 40) -> tuple[CampaignMeasures, ...]:
    """Return measures of campaigns that fail from the first simulation on."""
    curves = [np.clip(np.arange(simulations + 1), 0, number) for number in failures]
    return tuple(
        CampaignMeasures(Path("made-up"), None, Counts(), curve, curve // 2, True)
        for curve in curves
    )


SIX, FIVE = group(10, 11, 12, 13, 14, 15), group(3, 4, 5, 6, 7)


def html(thing: NotebookRepr) -> str:
    """Return the HTML that a notebook shows."""
    text = thing._repr_html_()
    assert text is not None
    return text


# Roads and drives from above


def test_a_drive_is_drawn_at_its_place_on_the_map() -> None:
    drive = drive_along(WINDING, drift=3.0)
    axes = Figure(figsize=(6.0, 4.0)).add_subplot()
    assert plot(drive, axes, road=WINDING) is axes
    path = max(
        (lines for lines in axes.collections if isinstance(lines, LineCollection)),
        key=lambda lines: len(lines.get_segments()),
    )
    place = path.get_transform() - axes.transData
    drawn = place.transform(np.concatenate(path.get_segments()))
    driven = np.column_stack([drive.trajectory.x, drive.trajectory.y])
    gaps = np.abs(drawn[:, None] - driven[None]).max(axis=2)
    assert gaps.min(axis=1).max() < 1e-6
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    outline = np.vstack([WINDING.sample(2.0, side) for side in (-4.0, 4.0)])
    assert (outline > (left, bottom)).all()
    assert (outline < (right, top)).all()


def test_lanes_are_drawn_in_their_width() -> None:
    axes = Figure().add_subplot()
    road = Road(SHORT.curvatures, lane_width=5.0)
    plot(road, axes)
    both, other, ego = (patch.get_path().vertices for patch in axes.patches)
    for outline, right, left in ((both, -5.0, 5.0), (other, 0.0, 5.0), (ego, -5.0, 0.0)):
        offsets = road.track(outline)[:, 1]
        assert (offsets.min(), offsets.max()) == pytest.approx((right, left), abs=0.02)


def test_axes_with_two_roads_show_both() -> None:
    axes = Figure().add_subplot()
    near, far = Road(SHORT.curvatures), Road(SHORT.curvatures, pose=(300.0, 80.0, 0.0))
    plot(near, axes)
    plot(far, axes)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < 0.0 < 300.0 < right
    assert bottom < 0.0 < 80.0 < top


def test_without_axes_a_plot_makes_a_figure_with_a_key() -> None:
    drive = EmbeddedSimulator().drive(HAIRPIN, Stanley())
    axes = plot(drive)
    assert axes.figure is plt.gcf()
    assert any("oob distance" in text.get_text() for text in axes.figure.texts)
    assert re.match(r"(PASS|FAIL), MOOBD (−[\d.]+|[\d.]+ of 2.00) m$", axes.get_title(loc="left"))
    assert plot(HAIRPIN).figure is plt.gcf() is not axes.figure


def test_a_drive_without_a_road_asks_for_the_road() -> None:
    drive = drive_along(SHORT)
    for show in (plot, animate):
        with pytest.raises(ValueError, match=r"give it, as in plot\(drive, road=road\)"):
            show(drive)
    assert "<Drive: 35 records" in repr(drive)
    assert animate(drive, road=SHORT).title == "Drive"


# Campaigns


def test_curves_of_progress_end_at_the_counts(campaign: Campaign) -> None:
    with CampaignStore.open(campaign.folder) as store:
        failed, distinct = store.counts().failed, len(distinct_failures(store))
    axes = plot_progress(campaign)
    labels = axes.get_legend_handles_labels()[1]
    assert labels[:2] == [f"failures: {failed}", f"distinct failures: {distinct}"]
    assert [np.asarray(line.get_ydata())[-1] for line in axes.lines[:2]] == [failed, distinct]
    assert len(labels) == 3  # with the random expectation


def test_a_campaign_without_results_or_failures_has_pictures_too(tmp_path: Path) -> None:
    simulator = EmbeddedSimulator()
    search = Campaign(
        strategy=Frenetic(seed=1), simulator=simulator, driver=Planner(), folder=tmp_path / "c"
    )
    assert "nothing stored yet" in repr(search)
    assert "nothing stored yet" in html(search)
    with pytest.raises(FreneticError, match="does not exist"):
        plot_progress(search)
    with CampaignStore.create(tmp_path / "d", search.configuration()) as store:
        plot_progress(store)
        assert "No failure" in html(store)
        assert "no results" in repr(store)
    search.run(1)
    assert "nearest misses" in html(search)


# Comparisons


@pytest.mark.parametrize(
    "groups",
    [
        {"a": SIX[:1], "b": FIVE[:4]},
        {"a": group(0, simulations=0), "b": group(2, simulations=3)},
        {chr(97 + i) * 60: FIVE for i in range(9)},
    ],
    ids=["few", "empty", "many"],
)
def test_any_groups_can_be_drawn(
    groups: dict[str, tuple[CampaignMeasures, ...]], tmp_path: Path
) -> None:
    path, pictures = tmp_path / "a.svg", set()
    for _ in range(2):
        draw_comparison(compare_measured(groups), path)
        pictures.add(path.read_text(encoding="utf-8"))
    (picture,) = pictures
    assert len(re.findall(r">[^<]* campaigns?</text>", picture)) == 2 * len(groups)
    assert {"distinct failures", "failures"} <= set(re.findall(r">([^<]*)</text>", picture))


def test_a_picture_has_a_row_of_curves_over_the_radius(tmp_path: Path) -> None:
    unlike = {name: UnlikeFailures(9, np.linspace(0.1, 2.0, 8)) for name in SPACES}
    groups = {
        name: tuple(replace(campaign, unlike=unlike) for campaign in campaigns)
        for name, campaigns in (("a", SIX), ("b", FIVE))
    }
    path = tmp_path / "a.svg"
    draw_comparison(compare_measured(groups), path)
    texts = re.findall(r">([^<]*)</text>", path.read_text(encoding="utf-8"))
    assert texts.count("radius") == 3
    assert {"failures unlike in behaviour", "failures unlike in bend"} <= {*texts}


def test_each_curve_is_a_median_in_its_own_line_style() -> None:
    groups = compare_measured({f"group {i}": FIVE if i else SIX for i in range(9)})
    curves = plot(groups, Figure().add_subplot()).lines
    assert len({(line.get_color(), line.get_linestyle()) for line in curves}) == 9
    best = next(line for line in curves if str(line.get_label()).startswith("group 0"))
    median = np.median([measures.distinct_after for measures in SIX], axis=0)
    assert np.asarray(best.get_ydata()).tolist() == median.tolist()


# Notebooks


def test_each_object_has_a_short_repr_and_a_picture_in_notebooks(campaign: Campaign) -> None:
    best = campaign.best_test
    assert best is not None
    with CampaignStore.open(campaign.folder) as store:
        clusters = distinct_failures(store)
        undriven = next(store.tests(Outcome.FAIL))
        for thing in (best, undriven, campaign, store, compare_measured({"a": SIX, "b": FIVE})):
            assert len(repr(thing)) < 200
            text = html(thing)
            (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
            assert base64.b64decode(picture).startswith(b"\x89PNG")
            assert len(text) < 60_000
            assert {"img", "td"} <= set(Elements(text).names)
        assert best.reason in html(best)
        assert f"−{-(best.moobd or 0.0):.2f} m" in html(best)
        assert f"{min(500, len(clusters))} distinct failures" in html(store)
        assert "read without drive" in html(undriven)
    assert repr(store) == f"<CampaignStore {campaign.folder}>"  # closed


def test_a_notebook_shows_the_repr_if_no_plot_package_is_installed(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: ())
    assert campaign._repr_html_() is None


def test_texts_from_outside_do_not_become_markup(campaign: Campaign, tmp_path: Path) -> None:
    with CampaignStore.open(make_hostile(tmp_path, campaign.folder)) as store:
        best = store.test(2)
        for text in (html(best), html(store), animate(best).html):
            assert not {"script", "b>"} & set(Elements(text).names)
            assert "<img src=x" not in text
        assert HOSTILE not in animate(best).page
