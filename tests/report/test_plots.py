"""Plots on Matplotlib's axes, and what notebooks show."""

from __future__ import annotations

import base64
import importlib.metadata
import re
from collections.abc import Iterator
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
from test_report_comparison import FIVE, SIX, comparison_of

from frenetic import Campaign, EmbeddedSimulator, Frenetic, Planner
from frenetic._support.notebook import Shown
from frenetic.analysis.failures import distinct_failures
from frenetic.campaign import CampaignStore
from frenetic.drivers import Stanley
from frenetic.errors import FreneticError
from frenetic.outcome import Outcome
from frenetic.report import animate, plot, plot_failures, plot_progress
from frenetic.road import Road


@pytest.fixture(autouse=True)
def figures() -> Iterator[None]:
    before = mpl.rcParams.copy()
    yield
    plt.close("all")
    settings = before.keys() - {"backend"}  # which pyplot chooses when it first draws
    assert [name for name in settings if mpl.rcParams[name] != before[name]] == []


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
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
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.found.append(tag)


def texts(axes: mpl.axes.Axes) -> list[str]:
    return [text.get_text() for text in axes.texts] + [axes.get_title(loc="left")]


def html(thing: Shown) -> str:
    """What a notebook shows."""
    text = thing._repr_html_()
    assert text is not None
    return text


# From above


def test_a_drive_lies_on_the_axes_where_it_is_on_the_map() -> None:
    drive = drive_along(WINDING, drift=3.0)
    axes = Figure(figsize=(6.0, 4.0)).add_subplot()
    assert plot(drive, axes, road=WINDING, map_size=200.0) is axes
    path = max(
        (one for one in axes.collections if isinstance(one, LineCollection)),
        key=lambda one: len(one.get_segments()),
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


def test_lanes_are_as_wide_as_they_are_in_metres() -> None:
    axes = Figure().add_subplot()
    road = Road(SHORT.curvatures, lane_width=5.0)
    plot(road, axes)
    both, other, ego = (patch.get_path().vertices for patch in axes.patches)
    for outline, right, left in ((both, -5.0, 5.0), (other, 0.0, 5.0), (ego, -5.0, 0.0)):
        seen = road.track(outline)[:, 1]
        assert (seen.min(), seen.max()) == pytest.approx((right, left), abs=0.02)


def test_a_second_road_leaves_the_first_in_sight() -> None:
    axes = Figure().add_subplot()
    near, far = Road(SHORT.curvatures), Road(SHORT.curvatures, pose=(300.0, 80.0, 0.0))
    plot(near, axes)
    plot(far, axes)
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < 0.0 < 300.0 < right
    assert bottom < 0.0 < 80.0 < top


def test_without_axes_there_is_a_new_figure_with_a_key() -> None:
    drive = EmbeddedSimulator().drive(HAIRPIN, Stanley())
    axes = plot(drive)
    assert axes.figure is plt.gcf()
    assert any("oob distance" in text.get_text() for text in axes.figure.texts)
    assert re.match(r"(PASS|FAIL), MOOBD [−\d.]+ m$", axes.get_title(loc="left"))
    assert plot(HAIRPIN).figure is plt.gcf() is not axes.figure


def test_a_drive_that_does_not_know_its_road_asks_for_it() -> None:
    drive = drive_along(SHORT)
    for show in (plot, animate):
        with pytest.raises(ValueError, match=r"give it, as in plot\(drive, road=road\)"):
            show(drive)
    assert "<Drive: 35 records" in repr(drive)
    assert animate(drive, road=SHORT).title == "Drive"


# Campaigns


def test_the_sheet_of_failures_names_the_most_severe(campaign: Campaign) -> None:
    with CampaignStore.open(campaign.folder) as store:
        clusters = distinct_failures(store)
        axes = plot_failures(store, number=2)
    words = texts(axes)
    assert f"{len(clusters)} distinct failures" in words[-1]
    assert "the 2 most severe" in words[-1]
    captions = [word for word in words if word.startswith("Test ")]
    assert [int(re.findall(r"\d+", one)[0]) for one in captions] == [
        cluster.most_severe for cluster in clusters.clusters[:2]
    ]
    given = Figure().add_subplot()
    assert plot_failures(campaign, given) is given


def test_progress_ends_at_the_counts(campaign: Campaign) -> None:
    with CampaignStore.open(campaign.folder) as store:
        failed, distinct = store.counts().failed, len(distinct_failures(store))
    axes = plot_progress(campaign)
    labels = axes.get_legend_handles_labels()[1]
    assert labels[:2] == [f"failures: {failed}", f"distinct failures: {distinct}"]
    assert [np.asarray(line.get_ydata())[-1] for line in axes.lines[:2]] == [failed, distinct]
    assert len(labels) == 4  # with the random expectation


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
        for draw in (plot_failures, plot_progress):
            draw(store)
        assert "No failure" in html(store)
        assert "no results" in repr(store)
    search.run(1)
    assert any(text.startswith("Test 1") for text in texts(plot_failures(search)))
    assert "nearest misses" in html(search)


# What notebooks show


def test_everything_is_short_in_words_and_shown_with_a_picture(campaign: Campaign) -> None:
    best = campaign.best_test
    assert best is not None
    with CampaignStore.open(campaign.folder) as store:
        clusters = distinct_failures(store)
        undriven = next(store.tests(Outcome.FAIL))
        for thing in (best, undriven, campaign, store, comparison_of(a=SIX, b=FIVE)):
            assert len(repr(thing)) < 200
            text = html(thing)
            (picture,) = re.findall(r'src="data:image/png;base64,([^"]+)"', text)
            assert base64.b64decode(picture).startswith(b"\x89PNG")
            assert len(text) < 60_000
            assert {"img", "td"} <= set(Elements(text).found)
        assert best.reason in html(best)
        assert f"−{-(best.moobd or 0.0):.2f} m" in html(best)
        assert f"{len(clusters)} distinct failures" in html(store)
        assert "read without drive" in html(undriven)
    assert repr(store) == f"<CampaignStore {campaign.folder}>"  # closed


def test_a_notebook_shows_the_repr_where_nothing_is_installed_that_draws(
    campaign: Campaign, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda **_: ())
    assert campaign._repr_html_() is None


def test_texts_from_outside_stay_texts(campaign: Campaign, tmp_path: Path) -> None:
    with CampaignStore.open(make_hostile(tmp_path, campaign.folder)) as store:
        best = store.test(2)
        for text in (html(best), html(store), animate(best).html):
            assert not {"script", "b>"} & set(Elements(text).found)
            assert "<img src=x" not in text
        assert HOSTILE not in animate(best).page
