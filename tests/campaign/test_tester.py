"""What testing one road gives: placed, judged, driven, and whatever the simulator does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from frenetic.campaign import RoadTester
from frenetic.campaign.record import Attempt
from frenetic.drivers import Driver, Planner
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.search import Candidate, Origin
from frenetic.simulators import Drive, EmbeddedSimulator, Trajectory
from frenetic.testing import DummyDriver, DummySimulator


def curved(*curvatures: float) -> Candidate:
    return Candidate(1, np.array(curvatures), 10.0, Origin("random"))


def through(*points: tuple[float, float]) -> Candidate:
    return Candidate(1, np.empty(0), 1.0, Origin("generator"), np.array(points, dtype=float))


class Altered(DummySimulator):
    """Counts its drives, and alters each."""

    def __init__(self, drift: float = 0.0, alter: Callable[[Drive], Drive] = lambda d: d) -> None:
        super().__init__(lambda road: drift)
        self.alter = alter
        self.drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.drives += 1
        return self.alter(super().drive(road, driver))


def attempt_at(candidate: Candidate, simulator: Altered | None = None) -> Attempt:
    """Its test, which drives if the road is valid, and only then."""
    simulator = simulator or Altered()
    attempt = RoadTester(simulator, DummyDriver()).test(candidate)
    assert simulator.drives == (attempt.result.outcome is not Outcome.INVALID)
    return attempt


def test_passing_road_is_driven_where_it_fits_the_map() -> None:
    attempt = attempt_at(curved(*[0.0] * 10))
    assert attempt.result.outcome is Outcome.PASS
    assert attempt.result.moobd == pytest.approx(2.0, abs=1e-6)
    assert attempt.pose is not None
    assert attempt.trajectory is not None
    assert 10.0 <= attempt.pose.x <= 190.0
    long = attempt_at(curved(*[0.0] * 24)).pose  # 230 m, the map's diagonal has 254 m inside
    assert long is not None
    assert 35.0 < np.degrees(long.heading) % 90.0 < 55.0
    points = attempt_at(through((20.0, 30.0), (60.0, 30.0), (120.0, 30.0)))
    assert points.result.outcome is Outcome.PASS
    assert points.pose == pytest.approx((20.0, 30.0, 0.0), abs=1e-6)  # where they lie


def test_a_candidate_is_driven_in_its_conditions_and_only_it() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    bent = curved(0.0, 0.02, 0.04, 0.04, 0.02, 0.0, 0.0, 0.0)
    usual, slow, again = (
        tester.test(replace(bent, conditions=conditions))
        for conditions in ({}, {"speed": 30.0, "noise": 0.2}, {})
    )
    assert usual.result == again.result != slow.result
    assert usual.trajectory is not None
    assert slow.trajectory is not None
    assert slow.trajectory.speed.max() < 9.0 < usual.trajectory.speed.max()


@pytest.mark.parametrize(
    ("candidate", "why", "is_placed"),
    [
        (curved(*[0.0] * 40), "does not fit the map of 200 m", False),
        (curved(*[0.07] * 12), "self-intersecting", True),
        (curved(0.0, 0.1, 0.1, 0.0), "too sharp", True),
        (curved(0.0, 0.0), "not long enough", True),
        (curved(0.0, float("nan")), "finite", False),
        (curved(0.0), "2 to 10000", False),
        (through((20, 30)), "Not enough road points.", False),
        (through((20, 30), (20, 30)), "the same", False),
        (through((20, 30), (203, 30)), "Not entirely inside the map boundaries", False),
        (through((20, 30), (60, 30), (60, 35), (20, 35)), "self-intersecting", False),
    ],
)
def test_refused_roads_cost_no_simulation(candidate: Candidate, why: str, is_placed: bool) -> None:
    attempt = attempt_at(candidate)
    assert attempt.result.outcome is Outcome.INVALID
    assert why in attempt.result.reason
    assert (attempt.pose is not None) == is_placed
    assert attempt.trajectory is None
    assert attempt.result.duration is None


def test_a_simulator_that_raises_or_records_no_numbers_is_an_error_of_its_test() -> None:
    def break_down(drive: Drive) -> Drive:
        raise ConnectionError("lost the\nsimulator")

    def spoil(drive: Drive) -> Drive:
        rows = drive.trajectory.to_rows()
        rows[5, 1] = np.nan
        return replace(drive, trajectory=Trajectory.from_rows(rows))

    spoilt, broken = (
        attempt_at(curved(*[0.0] * 10), Altered(alter=alter)) for alter in (spoil, break_down)
    )
    assert spoilt.result.outcome is broken.result.outcome is Outcome.ERROR
    assert spoilt.trajectory is broken.trajectory is None
    result, fault = broken.result, broken.result.fault
    assert fault is not None
    here = "test_tester.py"
    assert (fault.part, fault.kind, fault.file) == ("simulator", "ConnectionError", here)
    raised = "the simulator raised ConnectionError: lost the simulator"
    assert result.reason.startswith(f"{raised} ({here}:{fault.line}:")
    assert 'raise ConnectionError("lost the\\nsimulator")' in result.reason
    assert broken.trouble is not None
    assert "in break_down\n" in broken.trouble.traceback
