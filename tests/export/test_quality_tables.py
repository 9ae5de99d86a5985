"""Data frames of a comparison of two versions."""

from __future__ import annotations

from typing import Any

import pytest
from made_up_quality import ROADS, USUAL, drives

from frenetic.analysis import QualityComparison
from frenetic.export import quality_frame
from frenetic.export.quality_tables import QualityTable

pytestmark = pytest.mark.heavy

COMPARISON = QualityComparison.of([drives(), drives("noise 0.1 m", fails=3, rms_offset=0.2)])


def test_differences_have_a_row_per_measure_and_conditions() -> None:
    frame = quality_frame(COMPARISON)
    assert len(frame) == 2 * len(USUAL) + 1
    noisy = frame[frame.conditions == "noise 0.1 m"].set_index("measure")
    offset = noisy.loc["rms_offset"]
    assert offset.difference == pytest.approx(0.2, abs=0.01)
    assert offset.low <= offset.difference <= offset.high
    assert (offset.unit, offset.roads, offset.is_shown) == ("m", ROADS, True)
    assert noisy.loc["failing"].roads == ROADS + 3


def test_roads_have_the_values_of_both_versions() -> None:
    frame = quality_frame(COMPARISON, "roads")
    chosen = frame[(frame.conditions == "noise 0.1 m") & (frame.measure == "rms_offset")]
    assert list(chosen.road) == list(range(ROADS))
    assert (chosen.new - chosen.old).median() == pytest.approx(0.2, abs=0.01)


def test_curves_have_a_row_per_bin() -> None:
    frame = quality_frame(COMPARISON, "curves")
    chosen = frame[
        (frame.conditions == "noise 0.1 m")
        & (frame.measure == "rms_offset")
        & (frame.over == "radius")
    ]
    assert list(chosen["from"]) == [50.0, 800.0]
    assert list(chosen.difference) == pytest.approx([0.4, 0.2], abs=0.01)


@pytest.mark.parametrize("table", ["differences", "roads", "curves"])
def test_several_classes_have_a_column_with_their_names(table: QualityTable) -> None:
    classes = QualityComparison.by_class({"town": [drives()], "country": [drives()]})
    frame, town = quality_frame(classes, table), quality_frame(classes["town"], table)
    assert list(frame.columns) == ["class", *town.columns]
    assert list(frame["class"].unique()) == ["town", "country"]
    assert frame[frame["class"] == "town"].drop(columns="class").equals(town)


def test_an_unknown_table_is_refused() -> None:
    table: Any = "road"
    with pytest.raises(ValueError, match="table is 'road': one of roads, differences, curves is"):
        quality_frame(COMPARISON, table)
