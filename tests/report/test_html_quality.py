"""The page of a comparison of two versions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from made_up_quality import drives

from frenetic.analysis import QualityComparison
from frenetic.report.html.page import Chart, Section, Table
from frenetic.report.html.quality import (
    CHARTED,
    classes_report,
    quality_report,
    write_quality_page,
)
from frenetic.rerun.back_to_back import BackToBack
from frenetic.rerun.paired_roads import PairedRoads
from frenetic.rerun.versions_by_class import VersionsByClass

QUALITY = QualityComparison.of([drives(), drives("noise 0.1 m", rms_offset=0.2, crossing=100.0)])
NO_ROADS = PairedRoads(Path("roads"), ())
RESULT = BackToBack(
    *({"class": "a:Old"}, {"class": "a:New"}, {"class": "s:S"}, 0, NO_ROADS, NO_ROADS),
    quality=QUALITY,
)


def test_the_page_says_first_what_differs(tmp_path: Path) -> None:
    page = write_quality_page(RESULT, tmp_path / "q.html", command="frenetic compare v1 --driver b")
    text = page.read_text(encoding="utf-8")
    assert (
        '<p class="lead">With noise 0.1 m, new crosses the edge of its lane on 100 % of the roads'
        " (old 0 %) and keeps 0.20 m farther from the middle (0.20 to 0.20)." in text
    )
    assert "--driver" in text
    assert "Root mean square of the distance of the centre of mass from the lane" in text


def test_tables_have_all_measures_and_charts_the_bins() -> None:
    report = quality_report(RESULT, QUALITY)
    blocks = {section.id: section.blocks for section in report.sections}
    tables = [block for block in blocks["differences"] if isinstance(block, Table)]
    assert [len(table.rows) for table in tables] == [7, 8]
    charts = [block for block in blocks["over-radius"] if isinstance(block, Chart)]
    assert len(charts) == len(
        [name for name in CHARTED if name in QUALITY.drives[0].pairs[0][0].values]
    )
    usual, noisy, zero = charts[0].series
    assert (usual.name, noisy.name, zero.name) == ("as in the campaign", "noise 0.1 m", "alike")
    assert noisy.x == (75.0, 1000.0)
    assert noisy.y == pytest.approx((0.4, 0.2), abs=0.01)
    assert noisy.low < noisy.y < noisy.high
    assert "configuration" not in blocks


def test_a_page_needs_all_drives(tmp_path: Path) -> None:
    interrupted = replace(RESULT, quality=None, missing=3)
    with pytest.raises(ValueError, match="3 drives are missing"):
        write_quality_page(interrupted, tmp_path / "q.html")
    assert not list(tmp_path.iterdir())


# Several road classes


def alike_on(*quality: QualityComparison) -> VersionsByClass:
    """Return a comparison on roads of classes "town", "country", and so on."""
    names = ("town", "country", "motorway")
    results = {
        name: replace(RESULT, quality=each) for name, each in zip(names, quality, strict=False)
    }
    return VersionsByClass.of(results)


def test_a_page_of_several_classes_has_a_section_for_each(tmp_path: Path) -> None:
    compared = alike_on(QUALITY, QualityComparison.of([drives(rms_offset=-0.1)]))
    sections = {section.id: section for section in classes_report(compared).sections}
    assert [*sections] == ["summary", "classes", "class-1", "class-2", "measures"]
    assert (sections["class-1"].title, sections["class-2"].title) == ("Town", "Country")
    assert sections["class-2"].lead == "New keeps 0.10 m closer to the middle (0.10 to 0.10)."
    page = write_quality_page(compared, tmp_path / "q.html", command="frenetic compare a b")
    text = page.read_text(encoding="utf-8")
    assert "On town, with noise 0.1 m, new crosses the edge of its lane on 100 % of the" in text
    assert "; on country, new keeps 0.10 m closer to the middle (0.10 to 0.10)." in text


def tables_of(section: Section) -> list[Table]:
    return [block for block in section.blocks if isinstance(block, Table)]


def test_the_overview_has_a_column_for_each_class_and_only_what_is_shown() -> None:
    compared = alike_on(QUALITY, QualityComparison.of([drives(rms_offset=-0.1, mean_speed=-5.0)]))
    failures, overview = tables_of(classes_report(compared).sections[1])
    assert [row[0] for row in failures.rows] == ["town", "country"]
    assert overview.columns == ("quality", "with", ">town", ">country")
    assert overview.rows == (
        ("roads with the lane's edge crossed [%]", "noise 0.1 m", "+100.0, old", "–"),
        ("offset, rms [m]", "noise 0.1 m", "+0.20, old", "–"),
        ("offset, rms [m]", "", "–", "−0.10, new"),
        ("mean speed [km/h]", "", "–", "−5.0"),
    )


def test_charts_of_a_class_show_only_measures_that_differ_there() -> None:
    compared = alike_on(QUALITY, QualityComparison.of([drives()]))
    sections = {section.id: section for section in classes_report(compared).sections}
    charts = [block for block in sections["class-1"].blocks if isinstance(block, Chart)]
    assert {chart.y_title for chart in charts} == {"offset, rms: new minus old [m]"}
    assert not [block for block in sections["class-2"].blocks if isinstance(block, Chart)]
    assert len(tables_of(sections["class-2"])) == 1, "tables have all measures"
