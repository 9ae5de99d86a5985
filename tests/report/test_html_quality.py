"""The page of a comparison of two versions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from made_up_quality import drives

from frenetic.analysis import QualityComparison
from frenetic.report.html.page import Chart, Table
from frenetic.report.html.quality import CHARTED, quality_report, write_quality_page
from frenetic.rerun.back_to_back import BackToBack, PairedRoads

QUALITY = QualityComparison([drives(), drives("noise 0.1 m", rms_offset=0.2, crossing=100.0)])
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
