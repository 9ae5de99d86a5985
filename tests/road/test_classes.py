"""Road classes: their values by formula, and an independent check of the roads of strategies."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import convert, json
from road_rules import RULES, violations

from frenetic import Frenetic, Frenetic2021, RandomSearch, Road
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding
from frenetic.road.classes import RoadClass
from frenetic.search import Evaluation, Strategy
from frenetic.search.records import Trace

ROADS = int(os.environ.get("FRENETIC_CLASS_ROADS", "400"))
"""Roads of each class and strategy; docs/road-classes.md reports a run with 10,000."""
STRATEGIES: list[Callable[..., Strategy]] = [RandomSearch, Frenetic, Frenetic2021]


def road_of(road_class: RoadClass, values: np.ndarray, **options: object) -> Road:
    """Return a road of these curvatures with the slopes of its class."""
    profiles = road_class.profiles(values, road_class.step)
    return Road(values, road_class.step, lane_width=road_class.lane_width, **profiles | options)


def test_the_least_radius_agrees_with_the_green_book() -> None:
    # AASHTO Green Book, minimum radius by limiting e and f: 86, 194 and 328 m with 4, 12 and 12 %;
    # our radii are rounded up.
    for speed, slope, radius in ((50, 0.04, 86.0), (80, 0.12, 194.0), (100, 0.12, 329.0)):
        road_class = RoadClass.from_entries(
            {"name": "x", "design_speed": speed, "max_superelevation": slope}
        )
        assert road_class.min_radius == radius
    assert RoadClass.of("urban-50").min_clothoid == 48.0  # (13.9 m/s)^3 / 1.2 m/s^3 = 47.2 m ^2


def test_a_class_from_a_file_has_the_values_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "lane.toml"
    path.write_text("design_speed = 60\nlane_width = 3.0\nmax_grade = 0.12\n")
    road_class = RoadClass.of(str(path), {"length": 600})
    assert (road_class.name, road_class.lane_width, road_class.max_grade, road_class.length) == (
        "lane",
        3.0,
        0.12,
        600,
    )
    assert road_class.speed_limit == 60.0
    assert road_class.map_size == 700.0
    assert "length" not in road_class.sources
    assert RoadClass.from_entries(road_class.as_json()) == road_class


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("rural-90", {}, "there is no road class 'rural-90': choose competition, urban-50"),
        ("rural-80", {"radius": 3}, "there is no radius; there is design_speed"),
        ("rural-80", {"min_radius": -1}, "min_radius is -1: a number > 0 is needed"),
        ("rural-80", {"min_radius": 4}, "min_radius is 4: more than one and a half"),
        ("rural-80", {"max_grade": 8}, "max_grade is 8: a number <= 0.2 is needed"),
        ("rural-80", {"length": "long"}, "length is 'long': a number is needed"),
    ],
)
def test_an_unknown_class_or_option_is_refused(
    name: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(FreneticError, match=message):
        RoadClass.of(name, options)


@pytest.mark.parametrize("name", list(RULES))
@given(values=st.lists(st.floats(-0.05, 0.05), min_size=2, max_size=60), repeat=st.integers(1, 6))
def test_conformed_curvatures_keep_the_rules(name: str, values: list[float], repeat: int) -> None:
    road_class = RoadClass.of(name)
    wished = np.repeat(np.array(values) * 86.0 / road_class.min_radius, repeat)
    conformed = road_class.conformed(wished, road_class.step)
    road = road_of(road_class, conformed)
    assert not violations(
        name, conformed, road_class.step, road.superelevation, None, road.widening
    )
    assert road_class.breach(road) == ""
    assert np.array_equal(road_class.conformed(conformed, road_class.step), conformed)


@pytest.mark.parametrize(
    "strategy",
    [
        strategy if strategy is Frenetic else pytest.param(strategy, marks=pytest.mark.heavy)
        for strategy in STRATEGIES
    ],
)
@pytest.mark.parametrize("name", list(RULES))
def test_strategies_stay_in_their_class(name: str, strategy: Callable[..., Strategy]) -> None:
    road_class, rng = RoadClass.of(name), np.random.default_rng(1)
    search = strategy(seed=2, road_class=road_class)
    origins: Counter[str] = Counter()
    for i in range(ROADS):
        candidate = search.ask()
        assert candidate is not None
        road = candidate.road(road_class.lane_width, road_class=road_class)
        values = candidate.curvatures, candidate.step, road.superelevation, candidate.grade
        assert not violations(name, *values, road.widening), candidate
        if i < 50:
            assert road_class.breach(road) == ""
        length = (len(candidate.curvatures) - 1) * candidate.step
        origins[candidate.origin.operator] += 1
        # A simulated result: some drives fail, at random places.
        moobd = float(rng.normal(0.0, 1.0))
        along = np.arange(0.0, length, 5.0)
        offsets, speeds = (rng.normal(middle, 3.0, len(along)) for middle in (0.0, 20.0))
        trace = Trace(along, offsets, speeds)
        place = float(rng.uniform(0.0, length))
        search.tell(
            Evaluation(
                candidate,
                Outcome.FAIL if moobd < -1.0 else Outcome.PASS,
                moobd,
                i / ROADS,
                finding=Finding.departure("left", place) if moobd < -1.0 else None,
                worst_place=place,
                read_trace=lambda trace=trace: trace,  # type: ignore[misc]
            )
        )
    if strategy is not RandomSearch:
        assert len(origins) > 8


CLASS = RoadClass.of("rural-80")
BENDS = np.array([0.0, 0.0012, 0.0024, 0.0036, 0.0036, 0.0036, 0.0036, 0.0036, 0.0024, 0.0012, 0.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, ""),
        ({"values": BENDS * 1.2}, r"A radius of 231 m at 48 m: .* at least 240 m \(AASHTO"),
        ({"values": BENDS[::3]}, r"A clothoid with A of 67 m at 0 m: .* at least 109 m"),
        ({"values": np.delete(BENDS, [4, 5, 6, 7])}, r"An arc of 0 m at 48 m: .* 50 m"),
        ({"values": np.delete(BENDS, [4, 5])}, r"An arc of 32 m at 48 m: .* 50 m \(RAL 2012"),
        (
            {"values": np.concatenate([BENDS, [0.0] * 5, BENDS])},
            r"A straight of 96 m between bends to the same side at 160 m: .* 480 m \(RAS-L",
        ),
        ({"superelevation": 0.0}, r"A side friction of 0.18 at 48 m, in .* 278 m .* at most 0.14"),
        ({"superelevation": 0.08}, r"A superelevation of 8.0 % at 0 m: .* at most 7 % \(RAL"),
        (
            {"superelevation": 0.05},
            "A side friction of 0.17 at 32 m, in a radius of 417 m with 5.0 %",
        ),
        ({"grade": 0.07}, r"A grade of 7.0 % at 0 m: .* at most 6.5 %"),
        ({"grade": [(0.0, 0.02), (50.0, 0.0)]}, r"A crest of 2500 m radius at 0 m: .* 5000 m"),
        ({"grade": [(0.0, 0.0), (50.0, 0.02)]}, r"A sag of 2500 m radius at 0 m: .* 3000 m"),
        ({"widening": ()}, ""),
        ({"lane_width": 3.0}, "The lanes are 3 m wide: rural-80 needs at least 3.5 m"),
    ],
)
def test_the_message_names_the_breached_rule(change: dict[str, Any], message: str) -> None:
    values = np.asarray(change.get("values", BENDS))
    options = {name: value for name, value in change.items() if name != "values"}
    lane_width = options.pop("lane_width", CLASS.lane_width)
    road = Road(values, 16.0, lane_width=lane_width, **CLASS.profiles(values, 16.0) | options)
    verdict = road.placed(CLASS.map_size, road_class=CLASS)[1]
    assert bool(verdict) is not bool(message)
    assert re.search(message, verdict.message), verdict.message


def test_a_road_of_a_class_keeps_clear_of_itself_and_the_edge() -> None:
    bend = np.full(120, 1.0 / 240.0)
    circle = road_of(CLASS, bend)
    assert circle.placed(CLASS.map_size, road_class=CLASS)[1].message == (
        "The road is self-intersecting"
    )
    straight = road_of(CLASS, np.zeros(140))
    assert not straight.placed(1000.0, road_class=CLASS)[1]
    assert straight.placed(2400.0, road_class=CLASS)[1]


def test_lanes_widen_in_narrow_bends() -> None:
    urban = RoadClass.of("urban-50")
    assert urban.widening == 50.0  # 10 m squared, halved
    assert CLASS.widening == 0.0  # 50 / 240 is less than 0.25 m
    values = urban.conformed(np.repeat([0.0, 0.02, 0.0], 20), urban.step)
    road = road_of(urban, values)
    assert road.widening[:, 1].max() == pytest.approx(50.0 / urban.min_radius)
    narrow = Road(values, urban.step, lane_width=3.25, superelevation=road.superelevation)
    breach = "A lane of 3.25 m in a radius of 258 m at 200 m: urban-50 needs at least 3.44 m (RAS-L"
    assert urban.breach(narrow).startswith(breach)


@pytest.mark.parametrize("name", list(RULES))
def test_a_recorded_class_is_restored_exactly(name: str) -> None:
    """`minimise` compares recorded classes to recognise a road that `run` has shortened."""
    road_class = RoadClass.of(name)
    entries = json.decode(json.encode(road_class.as_json()))
    assert json.encode(convert(entries, RoadClass)) == json.encode(road_class)
