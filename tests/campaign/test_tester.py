"""`RoadTester`: one road is placed, checked, driven in its conditions and judged."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from campaigns import refused
from pids import LIMIT
from user_modules import own_modules

from frenetic.campaign import Campaign, CampaignStore, RoadTester
from frenetic.campaign.record import Attempt, Test
from frenetic.campaign.workers import DriveProcess
from frenetic.drivers import Delayed, Driver, Planner
from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import DRIVERS, STRATEGIES
from frenetic.road import Road
from frenetic.search import Candidate, Origin
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Trajectory
from frenetic.spec import Spec
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


def curved(*curvatures: float) -> Candidate:
    return Candidate(1, np.array(curvatures), 10.0, Origin("random"))


def through(*points: tuple[float, float]) -> Candidate:
    return Candidate(1, np.empty(0), 1.0, Origin("generator"), np.array(points, dtype=float))


class Altered(DummySimulator):
    """Counts its drives, and changes the record of each."""

    def __init__(self, drift: float = 0.0, alter: Callable[[Drive], Drive] = lambda d: d) -> None:
        super().__init__(lambda road: drift)
        self.alter = alter
        self.drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.drives += 1
        return self.alter(super().drive(road, driver))


def attempt_at(candidate: Candidate, simulator: Altered | None = None) -> Attempt:
    """Attempt at a candidate, which is driven exactly if its road is valid."""
    simulator = simulator or Altered()
    attempt = RoadTester(simulator, DummyDriver()).test(candidate)
    assert simulator.drives == (attempt.result.outcome is not Outcome.INVALID)
    return attempt


def test_a_road_is_driven_where_it_fits_the_map() -> None:
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
    assert points.pose == pytest.approx((20.0, 30.0, 0.0), abs=1e-6)  # points are not moved


def test_a_test_has_the_road_that_was_driven() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    points = np.array([(20.0, 20.0), (60.0, 40.0), (120.0, 60.0)])
    through_points = Road.from_points(points)
    values = through_points.curvatures, through_points.step
    for candidate in (curved(*[0.01] * 12), Candidate(1, *values, Origin("generator"), points)):
        (attempt,) = tester.test_many([candidate])
        assert attempt.road is not None
        road = Test.of(
            candidate, attempt, result_number=1, budget_spent=0.0, setting=tester.setting
        ).road
        stored = candidate.road(tester.terms.lane_width, attempt.pose)
        np.testing.assert_array_equal(road.table, stored.table)
        # Points describe the road that is driven; its test's road follows from the curvatures.
        assert (road is attempt.road) == (candidate.points is None)
    assert tester.attempt(candidate).road is None  # it may cross to another process


def test_conditions_of_a_candidate_hold_for_its_drive_only() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner())
    bent = curved(0.0, 0.02, 0.04, 0.04, 0.02, 0.0, 0.0, 0.0)
    usual, slow, repeated = (
        tester.test(replace(bent, conditions=conditions))
        for conditions in ({}, {"speed": 30.0, "noise": 0.2}, {})
    )
    assert usual.result == repeated.result != slow.result
    assert usual.trajectory is not None
    assert slow.trajectory is not None
    assert slow.trajectory.speed.max() < 9.0 < usual.trajectory.speed.max()


@pytest.mark.parametrize(
    ("candidate", "reason", "is_placed"),
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
def test_invalid_roads_are_not_driven(candidate: Candidate, reason: str, is_placed: bool) -> None:
    attempt = attempt_at(candidate)
    assert attempt.result.outcome is Outcome.INVALID
    assert reason in attempt.result.reason
    assert (attempt.pose is not None) == is_placed
    assert attempt.trajectory is None
    assert attempt.result.duration is None


def test_a_simulator_that_raises_or_records_nan_makes_the_test_an_error() -> None:
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
    this_file = "test_tester.py"
    assert (fault.part, fault.kind, fault.file) == ("simulator", "ConnectionError", this_file)
    message = "the simulator raised ConnectionError: lost the simulator"
    assert result.reason.startswith(f"{message} ({this_file}:{fault.line}:")
    assert 'raise ConnectionError("lost the\\nsimulator")' in result.reason
    assert broken.trouble is not None
    assert "in break_down\n" in broken.trouble.traceback


SAME = """
import numpy as np
from frenetic.search import Candidate, Origin, Strategy

class Same(Strategy):
    def __init__(self, domain=None):
        self.domain = domain

    def ask(self):
        domain, values = self.domain, np.array([0.0, 0.02, 0.04, 0.04, 0.02, 0.0, 0.0, 0.0])
        conditions = {} if domain is None else domain.at(np.full(domain.dimension, 0.5), 70.0)
        return Candidate(1, values, 10.0, Origin("same"), conditions=conditions)

    def tell(self, evaluation):
        pass
"""
"""A strategy that always proposes the same road, in the conditions of its domain."""
AMOUNTS = {"delay": 0.1, "friction": 0.6, "speed": 50.0}
TOML = "\n".join(f"{name} = {amount}" for name, amount in AMOUNTS.items())


def test_conditions_give_the_same_drive_from_every_source(frenetic: Frenetic) -> None:
    """Options, a file, a domain, variations of a rerun, and terms from Python."""
    Path("same.py").write_text(SAME)
    Path("run.toml").write_text(f"[with]\n{TOML}\n")
    Path("domain.toml").write_text(f"[conditions]\n{TOML}\n")
    search = ("--strategy", "same.py:Same", "--simulations", "1", "--workers", "1", "--out")
    options = [text for n, amount in AMOUNTS.items() for text in ("--with", f"{n}={amount}")]
    vary = [text for n, amount in AMOUNTS.items() for text in ("--vary", f"{n}={amount}:{amount}")]
    sources = {
        "options": options,
        "file": ["run.toml"],
        "domain": ["--odd", "domain.toml"],
        "usual": [],
    }
    for folder, words in sources.items():
        answer = frenetic("run", *words, *search, folder)
        assert answer.code == 0, answer.err
    assert frenetic("rerun", "usual", "1", *vary, "--times", "1", "--out", "varied").code in (0, 1)
    Campaign(
        strategy=STRATEGIES.make("same.py:Same"),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        terms=Terms(conditions=AMOUNTS),
        folder="terms",
    ).run(1)
    drives = {}
    for folder in ("usual", "options", "file", "domain", "varied", "terms"):
        with CampaignStore.open(folder) as store:
            trajectory = store.test(1).trajectory
        assert trajectory is not None
        drives[folder] = trajectory.to_rows()
    without = drives.pop("usual")
    by_hand = EmbeddedSimulator(rules=Rules().with_speed(50.0), friction=0.6)
    with CampaignStore.open("terms") as store:
        drive = by_hand.drive(store.test(1).road, Delayed(Planner(), seconds=0.1))
    for rows in drives.values():
        assert rows.shape != without.shape
        np.testing.assert_allclose(rows, drive.trajectory.to_rows(), atol=0.002)
        np.testing.assert_array_equal(rows, drives["terms"])


OWN_DRIVERS = """
import os
from frenetic import Planner

class Mine(Planner):
    def __init__(self):
        super().__init__()
        self.made_in = os.getpid()
        self.session = lambda: None  # it cannot be copied to another process

class Plain(Planner):
    def __init__(self):
        super().__init__()
        self.made_in = os.getpid()
"""


class RecordingProcesses(EmbeddedSimulator):
    """Writes the ids of the processes in which its driver was made and drives."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        Path("processes").write_text(f"{driver.made_in} {os.getpid()}")  # type: ignore[attr-defined]
        return super().drive(road, driver)


def test_another_process_makes_named_parts_anew_and_copies_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(OWN_DRIVERS)
    simulator = f"{__name__}:RecordingProcesses"

    def processes_of(tester: RoadTester) -> list[int]:
        with DriveProcess(tester) as process:
            assert process.drive(Road([0.0] * 8)).trouble is None
        return [int(text) for text in Path("processes").read_text().split()]

    with own_modules():
        named = RoadTester.of(Spec(driver="own.py:Mine", simulator=simulator))
        made_in, driven_in = processes_of(named)
        assert made_in == driven_in != os.getpid()
        copied = RoadTester(RecordingProcesses(), DRIVERS.make("own.py:Plain"))
        made_in, driven_in = processes_of(copied)
        assert made_in == os.getpid() != driven_in
        with refused("cannot be copied to another process"):
            DriveProcess(RoadTester(RecordingProcesses(), DRIVERS.make("own.py:Mine")))


COUNTED_DRIVER = """
import os
from frenetic import Planner

class Counted(Planner):
    def __init__(self):
        super().__init__(aggression=0.5)
        with open("made", "a") as file:
            file.write(f"{os.getpid()}\\n")
"""


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.heavy), 2])
def test_a_users_driver_is_made_once_in_each_process_that_uses_it(
    tmp_path: Path, workers: int
) -> None:
    (tmp_path / "counted.py").write_text(COUNTED_DRIVER)
    search = ["run", "--driver", "counted.py:Counted", "--simulations", "4", "--strategy", "random"]
    subprocess.run(
        [sys.executable, "-m", "frenetic", *search, "--seed", "1", "--workers", str(workers)],
        cwd=tmp_path,
        check=True,
        timeout=LIMIT,
        capture_output=True,
    )
    processes = (tmp_path / "made").read_text().split()
    assert len(processes) == len(set(processes)) == 1 + workers
