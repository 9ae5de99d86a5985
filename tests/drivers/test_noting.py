"""Notes of drivers: what they were told, noted and planned, in each process."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sample_programs

from frenetic import Controls, EmbeddedSimulator, Observation, Planner, Road
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import driving
from frenetic.drivers import CommandDriver, Driver
from frenetic.oracle.notes import OBSERVED, DriverNotes
from frenetic.spec.terms import Terms

ROAD = Road([0.0] * 4 + [0.02] * 6, 10.0)
CODE = sample_programs.DRIVER.replace(
    "acts += 1",
    "acts += 1; plan = values['ahead'][:3]; notes = {'y': values['ahead'][4][1]}",
).replace('"throttle": 0.2}', '"throttle": 0.2, "notes": notes, "plan": plan}')


class Noting(Planner):
    """A planner that notes its target on even decisions, and shows a plan."""

    def act(self, observation: Observation) -> Controls:
        """Return the planner's controls."""
        is_even = round(observation.time / 0.05) % 2 == 0
        self.trace_notes = {"y": observation.ahead[4, 1]} if is_even else {}
        self.trace_plan = observation.ahead[:3] if is_even else None
        return super().act(observation)


class Wrong(Planner):
    """A planner with attributes of the wrong type."""

    def __init__(self, **wrong: object) -> None:
        super().__init__()
        vars(self).update(wrong)


def notes_of(driver: Driver, **conditions: float) -> DriverNotes:
    tester = RoadTester(EmbeddedSimulator(), driver, Terms(), keeps_notes=True)
    drive = tester.drive(ROAD, conditions)
    assert drive.trouble is None
    assert drive.notes is not None
    return drive.notes


def test_without_errors_a_driver_is_told_what_the_car_does() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner(), Terms(), keeps_notes=True)
    drive, plain = tester.drive(ROAD), EmbeddedSimulator().drive(ROAD, Planner())
    assert (drive.trajectory.to_rows() == plain.trajectory.to_rows()).all()
    assert drive.notes is not None
    observed = dict(zip(OBSERVED, drive.notes.observed.T, strict=True))
    n = len(drive.notes.observed)
    assert n == len(drive.trajectory) - 1  # no decision after the end
    for name in ("time", "speed", "yaw_rate", "steering"):
        np.testing.assert_array_equal(observed[name], getattr(drive.trajectory, name)[:n])
    assert plain.notes is None


def test_a_driver_is_told_the_errors_of_its_sensors() -> None:
    biased = notes_of(Planner(), lateral_bias=0.3)
    assert biased.observed[0, [*OBSERVED].index("lateral_offset")] == pytest.approx(0.3, abs=1e-9)


def test_notes_and_plans_are_kept_decision_by_decision() -> None:
    notes = notes_of(Noting(), noise=0.1)
    assert notes.names == ("y",)
    assert np.isfinite(notes.noted[::2]).all()
    assert np.isnan(notes.noted[1::2]).all()
    assert notes.plan_lengths == (3, 0) * (len(notes.observed) // 2) + (3,) * (
        len(notes.observed) % 2
    )
    times, plans = zip(*notes.plans(), strict=True)
    np.testing.assert_allclose(times, notes.observed[::2, 0])
    assert plans[0].shape == (3, 2)


def test_a_decision_holds_until_the_next() -> None:
    observed = np.zeros((2, len(OBSERVED)))
    observed[:, 0], observed[:, 1] = (0.0, 0.1), (1.0, 2.0)
    notes = DriverNotes(observed, ("y",), np.array([[5.0], [6.0]]))
    rows = notes.at(np.array([0.0, 0.05, 0.1, 0.15]))
    assert rows[:, 1].tolist() == [1.0, 1.0, 2.0, 2.0]
    assert rows[:, -1].tolist() == [5.0, 5.0, 6.0, 6.0]
    assert np.isnan(DriverNotes().at(np.zeros(3))).all()


def test_a_program_notes_and_plans_in_a_process_of_its_own(tmp_path: Path) -> None:
    command = sample_programs.command(tmp_path, CODE.replace("BAD", "pass"))
    tester = RoadTester(EmbeddedSimulator(), CommandDriver(command), Terms(), keeps_notes=True)
    with driving(tester, isolate=True) as drive:
        notes = drive(ROAD, {}).notes
    assert notes is not None
    assert notes.names == ("y",)
    assert np.isfinite(notes.noted).all()
    assert set(notes.plan_lengths) == {3}


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"trace_notes": [1.0]}, "trace_notes are"),
        ({"trace_notes": {"y": "far"}}, "trace_notes are"),
        ({"trace_notes": {"y, m": 1.0}}, "letters, digits"),
        ({"trace_notes": {1: 1.0}}, "trace_notes are"),
        ({"trace_plan": [1.0, 2.0]}, "trace_plan is"),
        ({"trace_plan": "straight on"}, "trace_plan is"),
    ],
)
def test_notes_of_another_type_are_refused(wrong: dict[str, object], text: str) -> None:
    tester = RoadTester(EmbeddedSimulator(), Wrong(**wrong), Terms(), keeps_notes=True)
    trouble = tester.drive(ROAD).trouble
    assert trouble is not None
    assert text in trouble.reason
    # Only a trace reads them.
    assert RoadTester(EmbeddedSimulator(), Wrong(**wrong), Terms()).drive(ROAD).trouble is None
