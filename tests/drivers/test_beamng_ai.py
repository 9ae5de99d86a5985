"""The model of BeamNG.AI."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.drive import Drive, Rules
from frenetic.drivers import BeamngAi, Planner
from frenetic.drivers.layers import Noisy, compiled_form
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.simulators.embedded import EmbeddedSimulator, Vehicle

BEND = Road(np.array([0, 0, 0, 2, 5, 5, 5, 2, 0, 0, 0]) / 100)


class InPython(BeamngAi):
    """The same driver, called from Python."""


def drive(road: Road, driver: BeamngAi, limit: float = 70.0) -> Drive:
    rules = Rules(speed_limit=limit, oob_tolerance=1.0)
    return EmbeddedSimulator(rules=rules, vehicle="etk800").drive(road, driver)


def test_it_brings_its_car_unless_one_is_chosen() -> None:
    own = drive(BEND, BeamngAi())
    simulator = EmbeddedSimulator(rules=own.rules)
    for driver in (BeamngAi(), Noisy(BeamngAi(), offset=0.0, heading=0.0), InPython()):
        brought = simulator.drive(BEND, driver)
        np.testing.assert_array_equal(brought.trajectory.to_rows(), own.trajectory.to_rows())
        assert brought.car == own.car
        simulator.drive(BEND, Planner())
        assert simulator.vehicle == Vehicle(), "others drive in the default car"
    for chosen in ("default", {"mass": 1500.0}, Vehicle(length=5.0)):
        simulator = EmbeddedSimulator(vehicle=chosen)
        before = simulator.vehicle
        simulator.drive(BEND, BeamngAi())
        assert simulator.vehicle == before


def test_a_campaign_records_the_car_that_it_brings(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        driver=BeamngAi(),
        simulator=EmbeddedSimulator(),
        budget=Budget(simulations=2),
        folder=tmp_path / "c",
    ).run()
    assert not check_campaign(tmp_path / "c").findings
    with CampaignStore.open(tmp_path / "c") as store:
        assert store.setting.car == Vehicle.named("etk800").body()
        assert store.config["simulator"]["options"]["vehicle"]["mass"] == 1500.0  # type: ignore[index, call-overload]


def test_it_drives_alike_compiled_and_from_python() -> None:
    assert compiled_form(BeamngAi(), 0.05) is not None
    np.testing.assert_array_equal(
        drive(BEND, BeamngAi()).trajectory.to_rows(), drive(BEND, InPython()).trajectory.to_rows()
    )


def test_its_speed_follows_aggression_grip_and_limit() -> None:
    def slowest(driver: BeamngAi, limit: float = 70.0) -> float:
        result = drive(BEND, driver, limit)
        return float(result.trajectory.speed[100:].min())

    assert slowest(BeamngAi(aggression=0.4)) < slowest(BeamngAi()) - 1.0
    assert slowest(BeamngAi(aggression=0.9, grip=0.5)) == slowest(BeamngAi(aggression=0.5))
    fastest = drive(BEND, BeamngAi(), 30.0).trajectory.speed.max()
    assert fastest <= 30.0 / 3.6
