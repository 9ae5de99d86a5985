from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frenetic.campaign import RoadTester
from frenetic.drivers import Planner
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Origin
from frenetic.simulators import EmbeddedSimulator, Trajectory
from frenetic.testing import DummyDriver, DummySimulator


def candidate(values: list[float], step: float = 10.0) -> Candidate:
    return Candidate(1, np.array(values), step, Origin("random"))


class Counting(DummySimulator):
    drives = 0

    def drive(self, road, driver):  # type: ignore[no-untyped-def]
        self.drives += 1
        return super().drive(road, driver)


def make_tester(drift: float = 0.0, **options: float) -> tuple[RoadTester, Counting]:
    simulator = Counting(lambda road: drift)
    return RoadTester(simulator, DummyDriver(), **options), simulator


def test_passing_road_is_driven_where_it_fits_the_map() -> None:
    tests, simulator = make_tester()
    tested = tests.test(candidate([0.0] * 10))
    assert tested.result.outcome is Outcome.PASS
    assert tested.result.moobd == pytest.approx(2.0, abs=1e-6)
    assert simulator.drives == 1
    assert tested.pose is not None
    assert tested.trajectory is not None
    assert 10.0 <= tested.pose.x <= 190.0


@pytest.mark.parametrize(("drift", "side"), [(4.0, "left"), (-4.0, "right")])
def test_failing_road_says_where_and_on_which_side(drift: float, side: str) -> None:
    result = make_tester(drift)[0].test(candidate([0.0] * 15)).result
    assert result.outcome is Outcome.FAIL
    assert result.departure is not None
    assert result.departure.side == side
    assert 0.0 < result.departure.distance < 70.0
    assert result.moobd is not None
    assert result.moobd < 0.0


def test_a_candidate_is_driven_in_its_conditions_and_only_it() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    bent = candidate([0.0, 0.02, 0.04, 0.04, 0.02, 0.0, 0.0, 0.0])
    usual, slow, again = (
        tester.test(replace(bent, conditions=conditions))
        for conditions in ({}, {"speed": 30.0, "noise": 0.2}, {})
    )
    assert usual.result == again.result != slow.result
    assert usual.trajectory is not None
    assert slow.trajectory is not None
    assert slow.trajectory.speed.max() < 9.0 < usual.trajectory.speed.max()


@pytest.mark.parametrize(
    ("values", "why", "placed"),
    [
        ([0.0] * 40, "does not fit the map of 200 m", False),
        ([0.07] * 12, "self-intersecting", True),
        ([0.0, 0.1, 0.1, 0.0], "too sharp", True),
        ([0.0, 0.0], "not long enough", True),
        ([0.0, float("nan")], "finite", False),
        ([0.0], "2 to 10000", False),
    ],
)
def test_refused_roads_cost_no_simulation(values: list[float], why: str, placed: bool) -> None:
    tests, simulator = make_tester()
    tested = tests.test(candidate(values))
    assert tested.result.outcome is Outcome.INVALID
    assert why in tested.result.reason
    assert (tested.pose is not None) == placed
    assert simulator.drives == 0
    assert tested.trajectory is None
    assert tested.result.duration is None


def test_road_that_is_too_long_is_turned_to_fit() -> None:
    tests, _ = make_tester()
    tested = tests.test(candidate([0.0] * 24))  # 230 m, the map's diagonal has 254 m inside
    assert tested.result.outcome is Outcome.PASS
    assert tested.pose is not None
    turned = np.degrees(tested.pose.heading) % 90.0
    assert 35.0 < turned < 55.0


def test_simulator_that_raises_is_an_error_of_its_test() -> None:
    class Broken(DummySimulator):
        def drive(self, road, driver):  # type: ignore[no-untyped-def]
            raise ConnectionError("lost the\nsimulator")

    tested = RoadTester(Broken(), DummyDriver()).test(candidate([0.0] * 10))
    assert tested.result.outcome is Outcome.ERROR
    assert tested.result.reason.startswith(
        "the simulator raised ConnectionError: lost the simulator (test_tester.py:"
    )
    assert 'raise ConnectionError("lost the\\nsimulator")' in tested.result.reason
    assert "in drive\n" in tested.traceback
    fault = tested.result.fault
    assert fault is not None
    assert (fault.part, fault.kind, fault.file) == (
        "simulator",
        "ConnectionError",
        "test_tester.py",
    )
    assert f"(test_tester.py:{fault.line}:" in tested.result.reason
    assert tested.trajectory is None


def test_records_that_are_no_numbers_are_not_kept() -> None:
    class Wild(DummySimulator):
        def drive(self, road, driver):  # type: ignore[no-untyped-def]
            drive = super().drive(road, driver)
            rows = drive.trajectory.to_rows()
            rows[5, 1] = np.nan
            return replace(drive, trajectory=Trajectory.from_rows(rows))

    tested = RoadTester(Wild(), DummyDriver()).test(candidate([0.0] * 10))
    assert tested.result.outcome is Outcome.ERROR
    assert tested.trajectory is None


def test_map_smaller_than_its_margins_is_refused() -> None:
    with pytest.raises(ValueError, match="more than twice the margin"):
        RoadTester(DummySimulator(), DummyDriver(), map_size=20.0)


def proposed_as_points(points: list[tuple[float, float]]) -> Candidate:
    return Candidate(1, np.empty(0), 1.0, Origin("generator"), np.array(points, dtype=float))


def test_points_are_driven_where_they_lie() -> None:
    tests, simulator = make_tester()
    tested = tests.test(proposed_as_points([(20.0, 30.0), (60.0, 30.0), (120.0, 30.0)]))
    assert tested.result.outcome is Outcome.PASS
    assert simulator.drives == 1
    assert tested.pose == pytest.approx((20.0, 30.0, 0.0), abs=1e-6)


@pytest.mark.parametrize(
    ("points", "why"),
    [
        ([(20.0, 30.0)], "Not enough road points."),
        ([(20.0, 30.0), (20.0, 30.0)], "the same"),
        ([(20.0, 30.0), (203.0, 30.0)], "Not entirely inside the map boundaries"),
        ([(20.0, 30.0), (60.0, 30.0), (60.0, 35.0), (20.0, 35.0)], "self-intersecting"),
    ],
)
def test_points_are_judged_where_they_lie(points: list[tuple[float, float]], why: str) -> None:
    tests, simulator = make_tester()
    tested = tests.test(proposed_as_points(points))
    assert tested.result.outcome is Outcome.INVALID
    assert why in tested.result.reason
    assert simulator.drives == 0
