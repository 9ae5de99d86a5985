"""Minimising: shorter roads with the same failure."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any, Self

import numpy as np
import pytest
from events import on_result, on_test

from frenetic.analysis.failures import Failure
from frenetic.campaign import RoadTester, Summary, Test
from frenetic.campaign.check import check_campaign
from frenetic.drivers import Driver, Planner
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.rerun.minimise import Minimised, StopReason, minimise
from frenetic.rerun.minimising_strategy import GUARD, FailureReason
from frenetic.rerun.shrinker import Shape
from frenetic.road import Road
from frenetic.search import Candidate, Frenetic2021
from frenetic.segments.segment import segment_of
from frenetic.simulators import Drive, EmbeddedSimulator
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator, converse


class Watched(EmbeddedSimulator):
    """Stores the roads that it drives; breaks after a number of drives."""

    def __init__(self, *, breaks_after: float = math.inf, starts_again: bool = True) -> None:
        super().__init__()
        self.driven: list[tuple[float, ...]] = []
        self.breaks_after = breaks_after
        self.starts_again = starts_again

    def __enter__(self) -> Self:
        if self.driven and not self.starts_again:
            raise ConnectionError("no licence")
        return self

    def drive(self, road: Road, driver: Driver) -> Drive:
        if len(self.driven) >= self.breaks_after:
            raise ConnectionError("lost the simulator")
        self.driven.append((road.step, *road.curvatures))
        return super().drive(road, driver)


@pytest.fixture(scope="module")
def failures(endurance: bool) -> list[Road]:
    """Failing roads of searches, evenly spaced in time: 50 of 5 searches, or 4 of 2."""
    tester = RoadTester(EmbeddedSimulator(), Planner())
    roads: list[Road] = []
    searches, drives, each = (5, 300, 10) if endurance else (2, 100, 2)
    for seed in range(1, searches + 1):
        failing: list[Road] = []

        def verdict(
            candidate: Candidate, failing: list[Road] = failing
        ) -> tuple[Outcome, float | None]:
            result = tester.test(candidate).result
            if result.outcome is Outcome.FAIL:
                failing.append(Road(candidate.curvatures, candidate.step))
            return result.outcome, result.moobd

        converse(Frenetic2021(seed=seed, max_redraws=10), verdict, drives)
        roads += [failing[i * len(failing) // each] for i in range(each)]
    return roads


def minimised_by(simulator: EmbeddedSimulator, road: Road, **options: Any) -> Minimised:
    return minimise(road, RoadTester(simulator, Planner()), **options)


def failure_reason(road: Road, drive: Drive) -> FailureReason | None:
    result = judge(road, drive)
    if result.outcome is not Outcome.FAIL:
        return None
    return FailureReason.of(result.departure, result.duration, drive.rules.timeout(road.length))


def reason_alone(road: Road) -> FailureReason | None:
    """Return the reason in a new simulator, without earlier drives."""
    return failure_reason(road, EmbeddedSimulator().drive(road, Planner()))


@pytest.mark.parametrize(
    ("simulator", "reason"),
    [
        (DummySimulator(lambda road: 4.0), FailureReason.LEFT_LANE_LEFT),
        (DummySimulator(lambda road: -4.0), FailureReason.LEFT_LANE_RIGHT),
        (EmbeddedSimulator(), FailureReason.STOOD_STILL),  # no throttle
        (DummySimulator(speed=1.5), FailureReason.RAN_OUT_OF_TIME),
    ],
)
def test_minimising_keeps_the_reason_of_the_failure(
    simulator: DummySimulator | EmbeddedSimulator, reason: FailureReason
) -> None:
    road = Road(np.full(15, 0.01))
    assert failure_reason(road, simulator.drive(road, DummyDriver())) is reason
    minimised = minimise(road, RoadTester(simulator, DummyDriver()))
    assert minimised.reason is reason
    assert minimised.road.length <= 30.0 or reason is FailureReason.RAN_OUT_OF_TIME


# Results


def difference(first: Test, second: Test) -> float:
    """Return the difference of two failures, as clusters use it, computed from their drives."""
    vectors = []
    for failed in (first, second):
        assert failed.drive is not None
        result = judge(failed.road, failed.drive)
        segment = segment_of(failed.road, failed.drive, result.departure)
        failure = Failure.of_judged(result, segment)
        assert failure is not None
        vectors.append(failure.vector())
    return float(np.linalg.norm(vectors[0] - vectors[1]))


@pytest.mark.heavy
@pytest.mark.endurance
def test_roads_become_half_as_long_with_the_same_failure(failures: list[Road]) -> None:
    shares = []
    for road in failures:
        simulator = Watched()
        minimised = minimised_by(simulator, road)
        assert len(simulator.driven) == len(set(simulator.driven)) == minimised.drives <= 500
        original, smallest = minimised.original, minimised.smallest
        assert minimised.reason is reason_alone(road) is reason_alone(smallest.road)
        assert smallest.road.check_validity().valid
        drive = EmbeddedSimulator().drive(smallest.road, Planner())
        assert judge(smallest.road, drive) == smallest.result
        assert minimised.difference == pytest.approx(difference(original, smallest), abs=1e-3)
        assert minimised.difference <= 2.0
        assert (minimised.stop_reason, minimised.error) == (StopReason.MINIMAL, None)
        before, after = minimised.shapes
        assert before.values == tuple(road.curvatures)
        assert Shape(tuple(smallest.road.curvatures), smallest.road.step) == after
        assert after.rank <= before.rank
        assert after.curves <= before.curves
        shares.append(minimised.road.length / road.length)
        for factor in (1.0 - GUARD, 1.0 + GUARD) if minimised.is_guarded else ():
            placed, verdict = Road(factor * minimised.road.curvatures).placed()
            if verdict.valid:
                assert placed is not None
                assert reason_alone(placed) is minimised.reason
    assert median(shares) <= 0.55


GUARDED = [
    *(0.0233, 0.0523, 0.0325, -0.0121, 0.0062, -0.0192, -0.0048, -0.0172, -0.0034, -0.0276, -0.026),
    *(-0.0207, -0.0073, -0.037, 0.0098, -0.0112, -0.0306, -0.0471, -0.0651, -0.0468, -0.0135),
    *(-0.0135, 0.0075, -0.023),
]
UNGUARDED = [
    *(0.043, 0.009, 0.037, 0.035, 0.028, -0.02, -0.054, -0.05, -0.009, -0.028, -0.01, -0.003),
    *(0.007, -0.015, -0.016, -0.02, 0.029, 0.007, -0.005, -0.017, -0.035, 0.002, -0.019, 0.025),
    *(0.022, -0.022, 0.013, 0.05),
]


@pytest.mark.parametrize(
    ("curvatures", "is_guarded"),
    [(GUARDED, True), pytest.param(UNGUARDED, False, marks=pytest.mark.heavy)],
)
def test_roads_whose_neighbours_pass_are_shortened_too(
    curvatures: list[float], is_guarded: bool
) -> None:
    placed, _ = Road(curvatures).placed()
    assert placed is not None
    minimised = minimised_by(EmbeddedSimulator(), placed)
    assert minimised.road.length < 0.7 * placed.length
    assert minimised.is_guarded is is_guarded


@pytest.mark.parametrize("max_drives", [1, 7, 60])
def test_max_drives_limits_the_drives(failures: list[Road], max_drives: int) -> None:
    simulator, tests = Watched(), list[Test]()
    options = {"max_drives": max_drives, "on_event": on_test(tests.append)}
    minimised = minimised_by(simulator, failures[1], **options)
    assert len(simulator.driven) == minimised.drives == max_drives
    assert minimised.stop_reason is StopReason.SPENT
    lengths = [test.candidate.notes["length"] for test in tests[1:]]
    assert lengths == sorted(lengths, reverse=True)
    if max_drives == 1:  # the only drive checks that the road fails
        assert minimised.smallest.id == minimised.original.id == 1


def test_roads_of_many_points_and_wide_lanes_are_minimised(failures: list[Road]) -> None:
    # Like roads in the competition's files: points, joined by a spline.
    road = Road.from_points(failures[0].sample(8.0))
    minimised = minimised_by(EmbeddedSimulator(), road)
    assert minimised.shapes[0].step == road.step < 1.0
    assert minimised.road.step >= 2.0
    assert len(minimised.road.curvatures) < 60
    terms = Terms(lane_width=5.0)
    tester = RoadTester(DummySimulator(lambda road: 6.0), DummyDriver(), terms)
    wide = minimise(Road([0.0, 0.02] * 6, lane_width=5.0), tester).road
    assert wide.lane_width == 5.0
    assert wide.length <= 30.0  # a valid road is longer than 20 m


# Mistakes, faults and interruptions


STRAIGHT = Road([0.0] * 15)


@pytest.mark.parametrize(
    ("road", "options", "words"),
    [
        (STRAIGHT, {}, "PASS: Car reached the end"),
        (Road([0.07] * 15), {}, "INVALID: .*self-intersecting"),
        (STRAIGHT, {"max_drives": 0}, "max_drives is 0"),
        (Road([0.0] * 15, lane_width=5.0), {}, "are 5 m wide, the tester's 4 m"),
    ],
)
def test_roads_that_cannot_be_minimised_are_refused(
    road: Road, options: dict[str, Any], words: str
) -> None:
    with pytest.raises((FreneticError, ValueError), match=words):
        minimised_by(EmbeddedSimulator(), road, **options)


@pytest.mark.parametrize(
    ("starts_again", "drives", "words"),
    [
        (True, 50, "lost the simulator"),  # ten in a row
        (False, 40, "the simulator does not start: ConnectionError: no licence"),
    ],
)
def test_a_simulator_that_breaks_for_good_leaves_the_smallest_road(
    failures: list[Road], starts_again: bool, drives: int, words: str
) -> None:
    simulator = Watched(breaks_after=40, starts_again=starts_again)
    with simulator:
        minimised = minimised_by(simulator, failures[0])
    assert (minimised.stop_reason, minimised.drives) == (StopReason.STOPPED, drives)
    assert words in (minimised.error or "")
    assert minimised.road.length < failures[0].length


def press_at(drives: int) -> Callable[[Summary], None]:
    def press(now: Summary) -> None:
        if now.simulations == drives:
            signal.raise_signal(signal.SIGINT)

    return press


@pytest.mark.heavy
def test_the_next_call_resumes_an_interrupted_and_reads_a_complete_minimisation(
    failures: list[Road], tmp_path: Path
) -> None:
    road, simulator = failures[0], Watched()
    whole = minimised_by(EmbeddedSimulator(), road)
    for drives in (5, 20):
        press = on_result(press_at(drives))
        result = minimised_by(simulator, road, folder=tmp_path, on_event=press)
        assert (result.stop_reason, result.drives) == (StopReason.STOPPED, drives)
        assert len(simulator.driven) == drives
    assert result.road.length < road.length
    for most in (40, 500, 500):
        result = minimised_by(simulator, road, max_drives=most, folder=tmp_path)
        assert len(simulator.driven) == result.drives == min(most, whole.drives)
    assert result.smallest.result == whole.smallest.result
    assert (result.stop_reason, result.is_guarded) == (whole.stop_reason, whole.is_guarded)
    (folder,) = (tmp_path / "rerun").iterdir()
    assert not check_campaign(folder).findings
