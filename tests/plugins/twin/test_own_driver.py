"""The twin that is the driver under test in a car that is fitted."""

from __future__ import annotations

import gc
import multiprocessing
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import twin_drivers
from contents import contents
from twin_drivers import SHARP, Follower, Forgetful, Leaving, Raising, Seeing, Uncopied, Untouched

from frenetic import BeamngAi, EmbeddedSimulator, Planner, Stanley
from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.evaluation import evaluate
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.drivers import Driver, DriveSetup
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.twin.foresight import SearchTwin, foresight
from frenetic.plugins.twin.own_driver import DriverUnderTest, OwnDriverTwin
from frenetic.plugins.twin.twin_drives import UnsuitableDriverError
from frenetic.road import Road
from frenetic.search import Candidate, Evaluation, Frenetic, RandomSearch
from frenetic.search.archive import critical_places
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.spec import Spec

pytestmark = pytest.mark.usefixtures("new_process_server")

HIDDEN_CAR = replace(
    Vehicle(), tyre_peak=0.8, steering_lag=0.2, engine_acceleration=3.0, drive_front_share=0.5
)
"""Car of the slow simulator, whose engine and tyres the twin has to find."""
Drives = Sequence[tuple[Candidate, Evaluation]]


class SlowSimulator(EmbeddedSimulator):
    """A simulator that tells drivers of another car than the hidden one."""

    def setup(self, road: Road) -> DriveSetup:
        return Vehicle().setup(self.rules, road, 0.05)


def drive_all(driver: Driver, roads: int | Sequence[Candidate]) -> Drives:
    """Return roads, or a number of random ones, with evaluations of drives in the hidden car."""
    simulator, search = SlowSimulator(vehicle=HIDDEN_CAR), RandomSearch(seed=1)
    drives = []
    for candidate in [search.ask() for _ in range(roads)] if isinstance(roads, int) else roads:
        road = candidate.road(4.0)
        drives.append((candidate, evaluate(candidate, road, simulator.drive(road, driver))))
    return drives


def under_test(driver: Driver, spec: Spec | None = None) -> DriverUnderTest:
    return DriverUnderTest(spec or Spec(), driver, SlowSimulator(vehicle=HIDDEN_CAR))


def learnt(driver: Driver, drives: Drives, spec: Spec | None = None) -> SearchTwin:
    """Return a twin that has learnt from drives."""
    twin = SearchTwin(under_test(driver, spec), None)
    for candidate, evaluation in drives:
        twin.learn(candidate, evaluation)
    return twin


def foreseen_well(twin: SearchTwin, drives: Drives) -> tuple[float, list[float]]:
    """Return the share of foreseen outcomes, and how far foreseen failures are from real ones."""
    agreed, differences = 0, []
    foreseen = twin.foresee([candidate for candidate, _ in drives])
    for (candidate, evaluation), prediction in zip(drives, foreseen, strict=True):
        assert prediction is not None
        agreed += prediction.outcome == evaluation.outcome
        if Outcome.FAIL == prediction.outcome == evaluation.outcome:
            places = (
                critical_places(e, candidate, e.moobd or 0.0)[0] for e in (prediction, evaluation)
            )
            differences.append(float(np.linalg.norm(np.subtract(*(p.vector for p in places)))))
    return agreed / len(drives), differences


@pytest.mark.heavy
@pytest.mark.parametrize("driver", [Planner(), Follower()], ids=["compiled", "python"])
def test_the_own_driver_in_the_fitted_car_fails_as_in_the_hidden_one(driver: Driver) -> None:
    drives = drive_all(driver, 60)
    twin = learnt(driver, drives[:20])
    assert twin.is_ready
    assert twin.facts()["twin"].startswith("your driver, tyre_peak 0.8")
    assert twin.facts()["loss"] < 0.02
    agreed, differences = foreseen_well(twin, drives[20:])
    assert agreed > 0.9
    assert len(differences) > 3
    assert np.median(differences) < 0.5


def test_the_campaigns_driver_is_not_touched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(twin_drivers.__file__, "mine.py")
    twin = learnt(Untouched(), drive_all(Follower(), 21), Spec(driver="mine.py:Follower"))
    assert twin.is_ready
    assert twin.facts()["twin"].startswith("your driver")


def test_a_driver_without_a_name_is_copied() -> None:
    driver = Follower()
    drives = drive_all(driver, 21)
    twin = learnt(driver, drives)
    assert twin.is_ready
    assert driver.resets == len(drives)


def test_the_twins_process_ends_with_the_twin() -> None:
    before = set(multiprocessing.active_children())
    twin = learnt(Follower(), drive_all(Follower(), 20))
    assert len(set(multiprocessing.active_children()) - before) == 1
    del twin
    gc.collect()
    assert set(multiprocessing.active_children()) <= before


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("driver", "reason"),
    [
        (Raising(), "your driver broke in the twin's car: the driver raised RuntimeError: no idea"),
        (Forgetful(), "your driver does not drive twice alike"),
        (Seeing(), "your driver has a camera, and the twin draws nothing"),
        (Uncopied(), "cannot be copied"),
    ],
)
def test_a_law_stands_in_for_a_driver_that_cannot_drive(driver: Driver, reason: str) -> None:
    twin = learnt(driver, drive_all(Stanley(), 20))
    assert twin.is_ready
    facts = twin.facts()
    assert facts["twin"].partition(",")[0] in ("planner", "stanley")
    assert reason in facts["your driver does not drive in the twin"]


def test_a_law_stands_in_for_a_driver_that_drives_elsewhere() -> None:
    twin = SearchTwin(DriverUnderTest(Spec(), None, None), None)
    assert twin.facts()["your driver does not drive in the twin"] == "somebody else drives"
    beamng = DriverUnderTest(Spec(simulator="beamng"), BeamngAi(), EmbeddedSimulator())
    with pytest.raises(UnsuitableDriverError, match=r"BeamNG\.tech itself drives"):
        OwnDriverTwin(beamng)


@pytest.mark.heavy
def test_the_law_learns_from_all_drives_when_it_takes_over() -> None:
    drives = drive_all(Stanley(), 20)
    facts = learnt(Raising(), drives).facts()
    law = foresight(Spec(seed=1), laws=True)
    assert isinstance(law, Frenetic)
    twin = law._foresight
    assert twin is not None
    for candidate, evaluation in drives:
        twin.learn(candidate, evaluation)
    assert facts["twin"] == twin.facts()["twin"]


def test_a_road_on_which_the_driver_ends_its_process_is_not_foreseen() -> None:
    search = RandomSearch(seed=1)
    gentle = replace(search.ask(), curvatures=np.linspace(0.0, 0.02, 20))
    sharp = replace(gentle, curvatures=np.linspace(0.0, 1.2 * SHARP, 14))
    twin = learnt(Leaving(), drive_all(Follower(), [gentle] * 20))
    first, second, third = twin.foresee([gentle, sharp, gentle])
    assert second is None
    assert first is not None
    assert third is not None
    assert third.moobd == first.moobd
    twin.foresee([sharp])  # the third loss of the process, after those of the three and of the one
    assert not twin.is_ready
    assert "your driver ended its process or hung too often" in twin.facts()["twin"]
    assert twin.foresee([sharp]) == [None]


@pytest.mark.heavy
def test_a_resumed_campaign_goes_on_with_the_same_roads(tmp_path: Path) -> None:
    spec = Spec(
        strategy="foresight,random_roads=15,random_budget=0.5",
        driver="stanley,lateral_acceleration=7.5",
        seed=3,
        simulations=36,
    )
    whole = Campaign.of(spec, folder=tmp_path / "whole", workers=1)
    whole.run()
    with CampaignStore.open(tmp_path / "whole") as store:
        facts: Any = store.fact(SEARCH_FACTS)
    assert facts["twin"].startswith("your driver")
    assert facts["children with foresight"] > 0
    Campaign.of(spec, folder=tmp_path / "found", workers=1).run(25)
    Campaign.of(spec, folder=tmp_path / "found", workers=1).resume()
    assert contents(tmp_path / "found") == contents(tmp_path / "whole")
