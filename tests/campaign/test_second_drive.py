"""A campaign drives its first failure a second time, and reports whether the drive repeats."""

from __future__ import annotations

from pathlib import Path
from random import SystemRandom
from typing import Any

import pytest
from campaigns import campaign, quick_search
from contents import contents
from events import on_result
from repeats import Counting

from frenetic.campaign import Budget, Campaign, CampaignStore, Summary
from frenetic.campaign.second_drive import SECOND_DRIVE, not_repeatable
from frenetic.drivers import Controls, Driver, DriveSetup, Observation, Planner
from frenetic.oracle.outcome import Outcome
from frenetic.report.html import write_report
from frenetic.rerun.rerun import rerun
from frenetic.road import Road
from frenetic.search import Frenetic2021, RandomSearch
from frenetic.simulators import Drive, EmbeddedSimulator


class Restless(Planner):
    """Steers with another error in every drive, from 2 s on."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self._error = SystemRandom().uniform(0.05, 0.3)

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        error = self._error if observation.time >= 1.999 else 0.0
        return Controls(controls.steering + error, controls.throttle, controls.brake)


class Raising(Planner):
    """Raises in every other drive."""

    def __init__(self) -> None:
        super().__init__()
        self._drives = 0

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self._drives += 1

    def act(self, observation: Observation) -> Controls:
        if self._drives % 2 == 1 and observation.time > 1.0:
            raise ValueError("every other time")
        return super().act(observation)


class Drying(EmbeddedSimulator):
    """Has a dry road where it has driven before."""

    def __init__(self) -> None:
        super().__init__()
        self._known: set[bytes] = set()

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.friction = 1.0 if self._knows(road) else 0.4
        return super().drive(road, driver)

    def _knows(self, road: Road) -> bool:
        known = road.curvatures.tobytes() in self._known
        self._known.add(road.curvatures.tobytes())
        return known


class Breaking(Drying):
    """Breaks where it has driven before."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        if self._knows(road):
            raise RuntimeError("it was here before")
        return EmbeddedSimulator.drive(self, road, driver)


class Drifting(EmbeddedSimulator):
    """Has a little less friction in every drive."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.friction *= 0.9999
        return super().drive(road, driver)


def run_search(folder: Path, **parts: Any) -> Summary:
    defaults: dict[str, Any] = {"simulator": EmbeddedSimulator(), "driver": Planner()}
    defaults |= {"strategy": RandomSearch(seed=3), "budget": Budget(failures=1)}
    return Campaign(folder=folder, **(defaults | parts)).run()


@pytest.mark.parametrize(
    ("parts", "outcomes", "culprit"),
    [
        ({"driver": Restless()}, "", "the driver, whose controls differ from 2.0 s on"),
        ({"driver": Restless(), "workers": 2}, "", "the driver, whose controls differ from 2.0 s"),
        ({"driver": Raising()}, "PASS, not FAIL", "probably the driver"),
        ({"simulator": Drying()}, "PASS, not FAIL", "the simulator, which moves the car otherwise"),
        ({"simulator": Breaking()}, "ERROR, not FAIL", "probably the simulator"),
    ],
    ids=["restless", "restless in another process", "raising", "drying", "breaking"],
)
def test_a_drive_that_does_not_repeat_is_reported_once(
    tmp_path: Path, parts: dict[str, Any], outcomes: str, culprit: str
) -> None:
    summary = run_search(tmp_path / "c", **parts)
    note = summary.not_repeatable
    assert "repeatable: driven a second time, it gave " in note
    assert outcomes in note
    assert culprit in note
    assert summary.as_json()["not_repeatable"] == note
    with CampaignStore.open(tmp_path / "c") as store:
        (first, *_) = store.tests(Outcome.FAIL)
        assert store.fact(SECOND_DRIVE) == {"test": first.id, "note": note}
        assert note[1:] in write_report(store).read_text()
    assert note in (tmp_path / "c" / "campaign.log").read_text()


@pytest.mark.parametrize("simulator", [EmbeddedSimulator(), Drifting()])
def test_second_drives_are_compared_as_exactly_as_the_simulator_repeats(
    tmp_path: Path, simulator: EmbeddedSimulator
) -> None:
    """The embedded simulator has to repeat exactly, others only to fail in the same way."""
    assert run_search(tmp_path / "c", simulator=simulator).not_repeatable == ""
    with CampaignStore.open(tmp_path / "c") as store:
        (first,) = store.tests(Outcome.FAIL)
        assert store.fact(SECOND_DRIVE) == {"test": first.id, "note": ""}


def test_in_the_embedded_simulator_every_bit_counts(tmp_path: Path) -> None:
    class Trembling(Restless):
        drives = 0

        def reset(self, setup: DriveSetup) -> None:
            super().reset(setup)
            self.drives += 1
            self._error = 0.1 * self.drives

        def act(self, observation: Observation) -> Controls:
            controls = Planner.act(self, observation)
            steering = controls.steering + 1e-6 * self._error
            return Controls(steering, controls.throttle, controls.brake)

    note = run_search(tmp_path / "c", driver=Trembling()).not_repeatable
    assert " is not exactly repeatable: driven a second time, it gave a MOOBD " in note
    assert "(probably the driver" in note
    assert note.endswith("so the same seed may find other roads")


class ExpectsFailures(Frenetic2021):
    """A search that expects failures, so that no failure is driven a second time."""

    expects_failures = True


@pytest.mark.parametrize("workers", [1, 2])
def test_the_second_drive_changes_no_result(tmp_path: Path, workers: int) -> None:
    budget = Budget(simulations=60)
    for name, kind in (("with", Frenetic2021), ("without", ExpectsFailures)):
        strategy = kind(seed=4, random_budget=0.1, cross_freq=10, cross_num=6, max_redraws=10)
        run_search(tmp_path / name, strategy=strategy, budget=budget, workers=workers)
        with CampaignStore.open(tmp_path / name) as store:
            assert (SECOND_DRIVE in store.facts) == (name == "with")
    assert contents(tmp_path / "with") == contents(tmp_path / "without")


def test_a_search_makes_one_second_drive_and_a_rerun_none(tmp_path: Path) -> None:
    simulator = Counting()
    summary = run_search(tmp_path / "c", simulator=simulator, budget=Budget(failures=3))
    assert simulator.driven == summary.simulations + 1
    simulator.driven = 0
    reruns = rerun(tmp_path / "c", simulator, Planner())
    assert simulator.driven == len(reruns.tests) == 3, "a rerun needs no second drive"


def test_a_resumed_campaign_makes_the_second_drive(tmp_path: Path) -> None:
    def break_off(summary: Summary) -> None:
        if summary.failed:
            raise KeyboardInterrupt

    def facts() -> dict[str, Any]:
        with CampaignStore.open(tmp_path / "c") as store:
            return dict(store.facts)

    stopped = campaign(tmp_path / "c").run(on_event=on_result(break_off))
    assert stopped.interrupted
    assert SECOND_DRIVE not in facts()
    resumed = campaign(tmp_path / "c", strategy=quick_search())
    assert resumed.resume().not_repeatable == not_repeatable(facts()) == ""
    first: Any = facts()[SECOND_DRIVE]
    with CampaignStore.open(tmp_path / "c") as store:
        assert first["test"] == next(store.tests(Outcome.FAIL)).id
