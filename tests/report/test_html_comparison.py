"""The page of a comparison: its contents."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sample_comparisons import campaign, comparison, three_groups

from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.analysis.measures import SHARED_TEXT
from frenetic.errors import FreneticError
from frenetic.report.html.comparison import POINTS, comparison_report, write_comparison_page


@pytest.fixture
def three(tmp_path: Path) -> Comparison:
    """A comparison of the groups low, high and never."""
    return three_groups(tmp_path)


def blocks_of(groups: Comparison, folder: Path) -> dict[str, list[Any]]:
    """Return the blocks of the page, by section."""
    report = comparison_report(groups, folder)
    return {section.id: list(section.blocks) for section in report.sections}


def test_groups_have_the_order_of_the_headline_and_one_colour_each(
    three: Comparison, tmp_path: Path
) -> None:
    groups = [group for group, _ in blocks_of(three, tmp_path)["results"][0].data["rows"]]
    assert [group["name"] for group in groups] == ["high", "low", "never"]
    assert [group["role"] for group in groups] == ["group-1", "group-0", "group-2"]


def test_the_table_has_medians_and_quartiles_and_constant_measures_once(
    three: Comparison, tmp_path: Path
) -> None:
    medians = blocks_of(three, tmp_path)["results"][0].data
    titles = [measure.short for measure in medians["columns"]]
    first, _, never = (dict(zip(titles, cells, strict=True)) for _, cells in medians["rows"])
    assert first["distinct"] == ("14", "12 to 16")
    assert first["behaviour 1"] == ("15", "14 to 16")
    assert never["sparseness"] == ("none", "")
    assert medians["caption"].endswith("The same in all campaigns: cells of the feature map 7.")
    others = [measure.short for measure in blocks_of(three, tmp_path)["results"][1].data["columns"]]
    assert {"behaviour 0.5", "driven road 2", "invalid"} <= {*others}
    assert not {*titles} & {*others}


def test_long_curves_are_thinned_and_large_groups_have_bands(tmp_path: Path) -> None:
    long = tuple(campaign(tmp_path / str(i), 9 + i, simulations=3000) for i in range(5))
    few = (campaign(tmp_path / "x", 4), campaign(tmp_path / "y", 6))
    groups = compare_measured({"long": long, "few": few})
    chart, *_ = blocks_of(groups, tmp_path)["curves"]
    distinct = {curve.name: curve for curve in chart.series}
    curve = distinct["long"]
    assert len(curve.x) == len(curve.y) == len(curve.low) == POINTS
    assert (curve.x[0], curve.x[-1]) == (0, 3000)
    assert (curve.low[-1], curve.y[-1], curve.high[-1]) == (10.0, 11.0, 12.0)
    assert curve.singles == ()
    assert (distinct["few"].low, len(distinct["few"].singles)) == ((), 2)


def test_curves_over_the_radius_have_their_own_charts(three: Comparison, tmp_path: Path) -> None:
    charts = blocks_of(three, tmp_path)["unlike"]
    assert [chart.y_title for chart in charts] == [
        f"failures unlike in {name}" for name in ("behaviour", "bend", "driven road")
    ]
    for chart in charts:
        lines = {line.name: line for line in chart.series}
        high, never = lines["high"], lines["never"]
        assert (high.x[0], high.x[-1], high.y[0], high.y[-1]) == (0.0, 3.0, 28.0, 1.0)
        assert list(high.y) == sorted(high.y, reverse=True)
        assert set(never.y) == {0.0}
    old = tuple(replace(campaign(tmp_path / "x", 4), unlike={}) for _ in range(2))
    blocks = blocks_of(compare_measured({"a": old[:1], "b": old[1:]}), tmp_path)
    assert (len(blocks["curves"]), blocks["unlike"]) == (2, [])


def test_the_page_says_which_measures_a_search_uses(three: Comparison, tmp_path: Path) -> None:
    results = next(
        section
        for section in comparison_report(three, tmp_path).sections
        if section.id == "results"
    )
    assert results.lead == SHARED_TEXT


def test_pairs_state_the_difference_and_claim_nothing_about_few_repeats(
    three: Comparison, tmp_path: Path
) -> None:
    (table,) = blocks_of(three, tmp_path)["pairs"]
    assert table.rows[:2] == (
        ("distinct failures", "high has more than low", "1.00", "large", "0.033"),
        ("", "low has more than never", "1.00", "large", "0.033"),
    )
    blocks = blocks_of(comparison(tmp_path, a=[1, 2], b=[8, 9]), tmp_path)
    (row, *_) = blocks["pairs"][0].rows
    verdict = "a and b: too few repeats to tell"
    assert row == ("distinct failures", verdict, "0.00", "–", "–")
    assert [row["box"] for row in blocks["spreads"][0].data["panels"][0]["spreads"]] == [None] * 2


def test_only_existing_reports_are_linked(three: Comparison, tmp_path: Path) -> None:
    (table,) = blocks_of(three, tmp_path / "pages")["campaigns"]
    links = dict(zip((row[0] for row in table.rows), table.links, strict=True))
    assert links["../high-0"] == "../high-0/report.html"
    assert links["../high-1"] is None
    assert sum(link is not None for link in links.values()) == 2
    folder = tmp_path / "javascript:alert(1)#?"
    folder.mkdir()
    (folder / "report.html").write_text("x")
    groups = compare_measured({"a": (campaign(folder, 1),), "b": (campaign(tmp_path, 2),)})
    (table,) = blocks_of(groups, tmp_path)["campaigns"]
    assert table.links == ("javascript%3Aalert%281%29%23%3F/report.html", None)


def test_the_page_is_the_same_each_time_and_replaces_the_old_file(
    three: Comparison, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    written = []
    for _ in range(2):
        assert write_comparison_page(three, path, title="Bench", command="frenetic bench") == path
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert "<title>Bench</title>" in written[0].decode()
    with pytest.raises(FreneticError, match="cannot be written"):
        write_comparison_page(three, tmp_path / "nowhere" / "page.html")
