"""The sweep drives each bend once at each speed limit, on roads of the radius that it says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from frenetic import Candidate, EmbeddedSimulator, Road
from frenetic.road.classes import class_of
from frenetic.road.road_values import USUAL_CHANGE
from frenetic.search import Sweep
from frenetic.search.strategy import SearchEnded
from frenetic.testing import DummySimulator


def candidates(**options: Any) -> Iterator[Candidate]:
    strategy = Sweep(**{"seed": 1, **options})
    while True:
        try:
            yield strategy.ask()
        except SearchEnded:
            return


def radius_of(candidate: Candidate) -> float:
    return float(1.0 / np.abs(candidate.curvatures).max())


def turn_of(candidate: Candidate) -> float:
    """Return the angle by which the road turns, in degrees, positive to the left."""
    road = candidate.road(4.0)
    return float(np.degrees(road.headings[-1] - road.headings[0]))


def test_every_cell_has_the_same_bends_and_comes_once_before_any_comes_again() -> None:
    options = {"radii": 3, "speeds": 4, "turns": 3, "repeats": 2}
    asked = list(candidates(**options))
    assert len(asked) == 3 * 4 * 3 * 2 * 2
    cells = [(round(radius_of(road), 1), road.conditions["speed"]) for road in asked]
    assert {radius for radius, _ in cells} == {15.0, 38.7, 100.0}
    assert {speed for _, speed in cells} == {30.0, 46.7, 63.3, 80.0}
    for first in range(0, len(cells), 12):
        assert len(set(cells[first : first + 12])) == 12
    bends = {cell: Counter[tuple[float, int]]() for cell in cells}
    for cell, road in zip(cells, asked, strict=True):
        bends[cell][round(turn_of(road)), road.repeat] += 1
    gentle = bends[100.0, 30.0]
    turns = 60, 75, 90, -60, -75, -90
    assert set(gentle) == {(turn, repeat) for turn in turns for repeat in (0, 1)}
    for counts in bends.values():
        assert len(counts) == 12
        assert set(counts.values()) == {1}


def test_all_usual_roads_are_valid_on_the_usual_map_and_change_as_roads_may() -> None:
    for candidate in candidates():
        placed, verdict = candidate.road(4.0).placed(200.0)
        assert placed is not None, radius_of(candidate)
        assert verdict.valid, (verdict.message, radius_of(candidate))
        changes = np.abs(np.diff(candidate.curvatures)) / candidate.step
        assert changes.max() <= 1.001 * USUAL_CHANGE / 10.0
        assert candidate.curvatures[0] == candidate.curvatures[-1] == 0.0


def test_another_seed_drives_the_same_bends_in_another_order() -> None:
    first, second = ([_key(road) for road in candidates(seed=seed)] for seed in (1, 2))
    assert first != second
    assert Counter(first) == Counter(second)
    assert [_key(road) for road in candidates(seed=1)] == first


def _key(road: Candidate) -> tuple[bytes, float]:
    return road.curvatures.tobytes(), road.conditions["speed"]


def test_roads_of_a_class_keep_its_rules() -> None:
    road_class = class_of("rural-80")
    assert road_class is not None
    asked = list(candidates(road_class=road_class, step=road_class.step, run_up=100.0))
    assert min(map(radius_of, asked)) == pytest.approx(road_class.min_radius)
    assert max(map(radius_of, asked)) == pytest.approx(4.0 * road_class.min_radius, rel=0.01)
    for candidate in asked:
        road = candidate.road(road_class.lane_width, road_class=road_class)
        assert road_class.verdict(road).message == ""


def test_a_rolling_start_is_at_the_speed_limit() -> None:
    for candidate in candidates(rolling=True, run_up=20.0, radii=2, speeds=2):
        assert candidate.conditions["start_speed"] == candidate.conditions["speed"]
    assert "start_speed" not in next(candidates()).conditions
    assert list(candidates(rolling=True, radii=1, simulator=EmbeddedSimulator()))
    with pytest.raises(ValueError, match="in DummySimulator a car cannot start at a speed"):
        Sweep(seed=1, rolling=True, simulator=DummySimulator())
    assert Sweep(seed=1, simulator=DummySimulator()).options == Sweep(seed=1).options


def test_one_step_is_the_least_value() -> None:
    (left, right) = candidates(radii=1, speeds=1, turns=1, least_radius=40.0)
    assert radius_of(left) == pytest.approx(40.0)
    assert {round(turn_of(left)), round(turn_of(right))} == {60, -60}
    assert left.conditions == {"speed": 30.0}
    assert Road(left.curvatures, left.step).length > 130.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"least_radius": 14.0},
            "the bends of these roads have at least 14.3 m",
        ),
        (
            {"least_radius": 50.0, "largest_radius": 40.0},
            "least_radius is 50 and largest_radius 40",
        ),
        ({"least_turn": 50.0}, "a bend of 15 m turns by at least 58.6 degrees"),
        ({"least_speed": 90.0}, "least_speed is 90 and largest_speed 80"),
        ({"least_speed": 0.0}, "least_speed is 0"),
        ({"largest_turn": 30.0}, "least_turn is 60 and largest_turn 30"),
        ({"radii": 0}, "radii is 0"),
        ({"repeats": 0}, "repeats is 0"),
    ],
)
def test_what_cannot_be_swept_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Sweep(seed=1, **options)
