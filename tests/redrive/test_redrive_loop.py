"""Driving again: the same drives as before, whoever drives, and whatever breaks on the way."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest

from frenetic.campaign import CampaignStore, Test
from frenetic.campaign.record import Attempt
from frenetic.campaign.tester import Placement, RoadTester
from frenetic.drivers import Driver, Planner
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.loop import Task, campaign_tester, redriving
from frenetic.road import Pose, Road
from frenetic.search import Candidate, Origin
from frenetic.simulators import Drive, EmbeddedSimulator
from frenetic.simulators.worlds import USUAL, Conditions
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["searched_campaign"]


@pytest.fixture
def campaign(searched_campaign: Path) -> Path:
    return searched_campaign


def records_of(folder: Path) -> list[Test]:
    with CampaignStore.open(folder) as store:
        return [record for record in store.tests() if record.outcome.is_driven]


def made_tester(folder: Path) -> RoadTester:
    with CampaignStore.open(folder) as store:
        return campaign_tester(store, EmbeddedSimulator(), Planner())


def tasks_of(records: list[Test], conditions: Conditions = USUAL) -> list[Task]:
    return [Task.of(i, record, conditions) for i, record in enumerate(records, start=1)]


def driven(tasks: list[Task], tester: RoadTester, workers: int = 1) -> dict[int, Attempt]:
    found: dict[int, Attempt] = {}
    with redriving(tester, workers=workers) as drive_tasks:
        for attempt in drive_tasks(tasks):
            assert attempt.candidate_id not in found
            assert attempt.seconds >= 0.0
            found[attempt.candidate_id] = attempt
    return found


def gentle(number: int = 1) -> Task:
    """A gentle road somewhere on the map."""
    candidate = Candidate(number, np.zeros(11), 10.0, Origin("redrive"))
    return Task(candidate, Placement(Pose(100.0, 50.0, 1.5)))


@pytest.mark.parametrize("workers", [1, 2])
def test_a_campaign_driven_again_ends_bit_for_bit_alike(campaign: Path, workers: int) -> None:
    records = records_of(campaign)
    found = driven(tasks_of(records), made_tester(campaign), workers)
    assert len(found) == len(records) == 60
    for number, record in enumerate(records, start=1):
        result = found[number].result
        assert result.outcome is record.outcome
        assert result.moobd == record.moobd
        assert result.reason == record.reason


def test_the_conditions_reach_workers(campaign: Path) -> None:
    records = records_of(campaign)[:6]
    tasks = tasks_of(records, Conditions(friction=0.5, noise=0.3, noise_seed=4))
    here, there = (driven(tasks, made_tester(campaign), workers) for workers in (1, 2))
    usual = driven(tasks_of(records), made_tester(campaign))
    assert [t.result for t in here.values()] == [there[n].result for n in here]
    assert all(here[n].result != usual[n].result for n in here)


def test_a_road_that_is_not_valid_any_more_is_not_driven() -> None:
    tester = RoadTester(EmbeddedSimulator(), Planner(), map_size=120.0)
    tested = driven([gentle()], tester)[1]
    assert tested.result.outcome is Outcome.INVALID
    assert "map" in tested.result.reason


def test_only_roads_that_were_driven_are_driven_again() -> None:
    candidate = Candidate(9, np.zeros(2), 10.0, Origin("random"))
    facts = {"told": 1, "reason": "", "budget_spent": 0.0, "seconds": 0.0}
    pose = (0.0, 0.0, 0.0)
    refused = Test(candidate=candidate, outcome=Outcome.INVALID, pose=pose, **facts)  # type: ignore[arg-type]
    lost = Test(candidate=candidate, outcome=Outcome.ERROR, **facts)  # type: ignore[arg-type]
    for record in (refused, lost):
        with pytest.raises(CampaignError, match=f"test 9 is {record.outcome}: only a road that"):
            Task.of(1, record)


class BreaksOnce(DummySimulator):
    """Breaks in its first drive, or in so many."""

    def __init__(self, times: int) -> None:
        super().__init__()
        self.times = times
        self.starts = self.ends = 0

    def __enter__(self) -> BreaksOnce:
        self.starts += 1
        return self

    def __exit__(self, *_: object) -> None:
        self.ends += 1

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.times -= 1
        if self.times >= 0:
            raise ConnectionError("the simulator has gone")
        return super().drive(road, driver)


def test_a_simulator_that_breaks_is_started_again_and_the_road_tried_once_more() -> None:
    simulator = BreaksOnce(1)
    tested = driven([gentle(1), gentle(2)], RoadTester(simulator, DummyDriver()))
    assert [t.result.outcome for t in tested.values()] == [Outcome.PASS, Outcome.PASS]
    assert simulator.starts == 2


def test_a_simulator_that_breaks_twice_is_an_error_of_that_road_only() -> None:
    tested = driven([gentle(1), gentle(2)], RoadTester(BreaksOnce(2), DummyDriver()))
    assert tested[1].result.outcome is Outcome.ERROR
    assert "the simulator has gone" in tested[1].result.reason
    assert tested[2].result.outcome is Outcome.PASS


def test_ctrl_c_ends_after_what_runs() -> None:
    found: list[int] = []
    said: list[str] = []

    tester = RoadTester(DummySimulator(), DummyDriver())
    with redriving(tester, on_interrupt=lambda: said.append("stopping")) as drive_tasks:
        for attempt in drive_tasks([gentle(number) for number in range(1, 10)]):
            found.append(attempt.candidate_id)
            if attempt.candidate_id == 3:
                signal.raise_signal(signal.SIGINT)
        assert not list(drive_tasks([gentle(10)])), "nothing begins afterwards"
    assert found == [1, 2, 3]
    assert said == ["stopping"]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_may_decide_on_the_next_batch(workers: int) -> None:
    tester = RoadTester(DummySimulator(), DummyDriver())
    with redriving(tester, workers=workers) as drive_tasks:
        first = [attempt.candidate_id for attempt in drive_tasks([gentle(1), gentle(2)])]
        second = [one.candidate_id for one in drive_tasks([gentle(max(first) + 1)])]
    assert (sorted(first), second) == ([1, 2], [3])


def test_a_simulator_that_the_caller_has_entered_is_left_by_the_caller() -> None:
    simulator = BreaksOnce(1)
    with simulator:
        with redriving(RoadTester(simulator, DummyDriver()), is_entered=True) as drive_tasks:
            assert simulator.starts == 1
            (attempt,) = drive_tasks([gentle()])
        assert attempt.result.outcome is Outcome.PASS
        assert (simulator.starts, simulator.ends) == (2, 1), "it broke once and was started again"
    assert simulator.ends == 2


def test_nothing_to_drive_is_no_trouble() -> None:
    assert driven([], RoadTester(DummySimulator(), DummyDriver()), workers=3) == {}


@pytest.mark.parametrize("workers", [0, 1.5, True])
def test_a_number_of_workers_that_is_none_is_refused(workers: int) -> None:
    with pytest.raises(ValueError, match="workers is"):
        driven([gentle()], RoadTester(DummySimulator(), DummyDriver()), workers)


def test_a_damaged_configuration_is_one_line(campaign: Path, tmp_path: Path) -> None:
    with CampaignStore.create(tmp_path / "c", {"map_size": "large"}):
        pass
    with (
        CampaignStore.open(tmp_path / "c") as store,
        pytest.raises(CampaignError, match=r"is damaged: .*map_size is 'large'"),
    ):
        campaign_tester(store, EmbeddedSimulator(), Planner())
