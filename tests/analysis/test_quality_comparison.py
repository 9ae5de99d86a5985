"""The comparison of two versions where both pass, on made-up measures."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import pytest
from made_up_quality import ROADS, USUAL, drives

from frenetic.analysis.quality import QUALITY, DriveQuality
from frenetic.analysis.quality_comparison import (
    BETTER,
    MIXED,
    WORSE,
    QualityComparison,
    classes_sentence,
    common_verdict,
)
from frenetic.analysis.quality_differences import PairedQuality
from frenetic.analysis.quality_text import NO_DIFFERENCE, difference_row
from frenetic.analysis.statistics import holm

BINS: Mapping = {"speed": {}, "radius": {}}  # type: ignore[type-arg]


def test_the_sentence_names_what_differs() -> None:
    comparison = QualityComparison.of([drives(rms_offset=-0.12, rms_steering_rate=0.6)])
    assert comparison.sentence == (
        "new keeps 0.12 m closer to the middle (0.12 to 0.12) and steers 30 % more (30 to 30)"
    )
    assert comparison.verdict == MIXED


def test_the_conditions_come_first_if_all_differences_have_them() -> None:
    usual, noisy = drives(), drives("noise 0.1 m", rms_offset=0.3, edge_distance=-0.2)
    comparison = QualityComparison.of([usual, noisy])
    assert comparison.sentence == (
        "with noise 0.1 m, new keeps 0.30 m farther from the middle (0.30 to 0.30)"
    )
    assert comparison.verdict == WORSE
    both = QualityComparison.of([drives(mean_speed=-7.0), noisy])
    assert both.sentence == (
        "new keeps 0.30 m farther from the middle with noise 0.1 m (0.30 to 0.30) and drives 10 %"
        " slower (10 to 10)"
    )


def test_three_phrases_are_joined_by_commas() -> None:
    comparison = QualityComparison.of(
        [drives(rms_offset=-0.1, rms_steering_rate=-0.4, rms_lateral_jerk=-0.4)]
    )
    assert comparison.sentence.startswith(
        "new keeps 0.10 m closer to the middle (0.10 to 0.10), steers 20 % less (20 to 20), and"
        " jerks 50 % less to the sides (50 to "
    )
    assert comparison.verdict == BETTER


def test_a_difference_that_nobody_notices_is_not_shown() -> None:
    comparison = QualityComparison.of([drives(rms_offset=0.01, mean_speed=0.5)])
    offset = next(d for d in comparison.differences if d.measure.name == "rms_offset")
    assert offset.p_corrected < 1e-6
    assert not offset.is_shown
    assert comparison.verdict == NO_DIFFERENCE
    assert comparison.sentence == (
        "no difference shown: alike within 0.02 m (offset, rms), 0.01 m (least edge distance),"
        " 0.01 °/s (steering rate, rms)"
    )


def test_p_is_corrected_for_all_measures_in_all_conditions() -> None:
    comparison = QualityComparison.of([drives(), drives("gust 10 m/s")])
    found = comparison.differences
    assert len(found) == 2 * len(USUAL) + 1, "failures count in disturbed drives"
    assert [d.p_corrected for d in found] == holm([d.p for d in found])


def test_failures_and_crossings_decide_alone() -> None:
    crossing = drives("noise 0.1 m", crossing=100.0, rms_steering_rate=-0.6)
    comparison = QualityComparison.of([drives(), crossing])
    assert comparison.verdict == WORSE
    assert comparison.sentence.startswith(
        "with noise 0.1 m, new crosses the edge of its lane on 100 % of the roads (old 0 %) and"
        " steers 30 % less"
    )
    failing = QualityComparison.of([drives(), drives("noise 0.1 m", fails=20, rms_offset=-0.1)])
    assert failing.verdict == WORSE
    assert failing.sentence.startswith(
        "with noise 0.1 m, new fails on 33 % of the roads (old 0 %) and keeps 0.10 m closer"
    )
    quiet = QualityComparison.of([drives(fails=20)])
    assert quiet.verdict == NO_DIFFERENCE, "the verdict on failures is another"


def test_few_roads_show_nothing() -> None:
    few = QualityComparison.of([drives(roads=4, rms_offset=1.0)])
    assert few.sentence == "no difference shown: the roads that both pass are too few, 4"
    none = QualityComparison.of([drives(roads=0, fails=3)])
    assert none.sentence == "no difference shown: there is no road that both pass"
    json.dumps(none.as_json(), allow_nan=False)


def test_a_difference_from_nothing_is_told_in_its_unit() -> None:
    still = {**USUAL, "rms_steering_rate": 0.0}
    pairs = [
        (DriveQuality(still, BINS), DriveQuality({**still, "rms_steering_rate": 1.5}, BINS))
    ] * ROADS
    comparison = QualityComparison.of([PairedQuality("", [(False, False)] * ROADS, pairs)])
    assert comparison.sentence == "new steers 1.50 °/s more (1.50 to 1.50)"


def test_rows_have_the_values_and_what_is_shown() -> None:
    comparison = QualityComparison.of([drives("noise 0.1 m", edge_distance=-0.5)])
    rows = {row[0]: row[1:] for row in map(difference_row, comparison.differences)}
    old, new, difference, verdict = rows["least edge distance [m]"]
    assert float(old) == pytest.approx(0.6, abs=0.02)
    assert float(new) == pytest.approx(0.1, abs=0.02)
    assert (difference, verdict) == ("-0.50 (-0.50 to -0.50)", "old is better")
    assert rows["mean speed [km/h]"][2:] == ("0.0 (0.0 to 0.0)", "")


def test_curves_say_where_versions_differ() -> None:
    comparison = QualityComparison.of([drives(rms_offset=0.15)])
    curves = {(axis, measure.name): points for _, axis, measure, points in comparison.curves()}
    bend, straight = curves["radius", "rms_offset"]
    assert (bend.low, bend.high, bend.roads) == (50.0, 100.0, ROADS)
    assert (straight.low, straight.high, straight.roads) == (800.0, np.inf, ROADS)
    assert bend.difference.value == pytest.approx(0.3, abs=0.01)
    assert straight.difference.value == pytest.approx(0.15, abs=0.01)
    (speed,) = curves["speed", "rms_offset"]
    assert (speed.low, speed.high) == (50.0, 60.0)
    assert {name for _, name in curves} == {
        name for name, measure in QUALITY.items() if measure.series is not None
    }
    json.dumps(comparison.as_json(), allow_nan=False)
    assert QualityComparison.of([drives(roads=5)]).as_json()["curves"][0]["points"] == []  # type: ignore[index, call-overload]


# Several road classes


def test_p_is_corrected_for_all_classes() -> None:
    of_class = {"town": [drives()], "country": [drives(), drives("gust 10 m/s", rms_offset=0.1)]}
    classes = QualityComparison.by_class(of_class)
    alone = QualityComparison.of(of_class["country"])
    uncorrected = [d.p for quality in classes.values() for d in quality.differences]
    assert [d.p for d in classes["country"].differences] == [d.p for d in alone.differences]
    corrected = [d.p_corrected for quality in classes.values() for d in quality.differences]
    assert corrected == holm(uncorrected)
    pairs = zip(classes["country"].differences, alone.differences, strict=True)
    assert all(d.p_corrected >= other.p_corrected for d, other in pairs)
    assert list(classes["town"].drives) == of_class["town"]


def test_a_difference_by_chance_on_one_of_many_classes_is_not_shown() -> None:
    """With 11 roads, p is at least 2 / 2^11: enough for one class, not for twenty."""
    shifted = drives(roads=11, rms_offset=0.1)
    assert [d.measure.name for d in QualityComparison.of([shifted]).shown] == ["rms_offset"]
    twenty = QualityComparison.by_class({str(i): [shifted] for i in range(20)})
    assert not any(quality.shown for quality in twenty.values())


def test_the_sentence_says_on_which_classes_versions_differ() -> None:
    classes = QualityComparison.by_class(
        {
            "town": [drives(rms_offset=-0.12, rms_steering_rate=-0.4)],
            "country": [drives()],
            "motorway": [drives(), drives("noise 0.1 m", rms_offset=0.3)],
            "alley": [drives()],
        }
    )
    assert classes_sentence(classes) == (
        "on town, new keeps 0.12 m closer to the middle (0.12 to 0.12); on motorway, with noise"
        " 0.1 m, new keeps 0.30 m farther from the middle (0.30 to 0.30); no difference shown on"
        " country and alley"
    )
    assert [quality.verdict for quality in classes.values()] == [
        BETTER,
        NO_DIFFERENCE,
        WORSE,
        NO_DIFFERENCE,
    ]
    two = {name: classes[name] for name in ("town", "country")}
    assert "and steers 20 % less (20 to 20); no difference shown on country" in classes_sentence(
        two
    )


def test_a_class_on_which_each_version_is_better_in_something_says_both() -> None:
    mixed = [drives(rms_offset=-0.12, rms_steering_rate=0.6)]
    classes = QualityComparison.by_class({str(i): mixed for i in range(4)})
    assert classes_sentence(classes).count("keeps 0.12 m closer to the middle") == 4
    assert classes_sentence(classes).count("and steers 30 % more") == 4


def test_without_a_difference_the_sentence_limits_it_on_all_classes() -> None:
    classes = QualityComparison.by_class({"town": [drives()], "country": [drives(rms_offset=0.01)]})
    assert classes_sentence(classes) == (
        "no difference shown on town and country: alike within 0.02 m (offset, rms), 0.01 m (least"
        " edge distance), 0.01 °/s (steering rate, rms)"
    )
    empty = QualityComparison.by_class({"town": [drives()], "country": [drives(roads=0)]})
    assert classes_sentence(empty).endswith(
        "; no difference shown on country: there is no road that both pass"
    )


def test_verdicts_that_contradict_each_other_are_mixed() -> None:
    assert common_verdict([NO_DIFFERENCE, BETTER, NO_DIFFERENCE]) == BETTER
    assert common_verdict([WORSE, WORSE]) == WORSE
    assert common_verdict([WORSE, BETTER]) == MIXED
    assert common_verdict([MIXED, BETTER]) == MIXED
    assert common_verdict([NO_DIFFERENCE]) == common_verdict([]) == NO_DIFFERENCE
