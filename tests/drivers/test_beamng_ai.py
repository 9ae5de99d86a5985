"""`BeamngAi`, the model of BeamNG.AI."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import DriveProcess
from frenetic.drivers import BeamngAi, Planner
from frenetic.drivers.compiled_form import compiled_form
from frenetic.drivers.wrappers import Noisy
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive, Rules
from frenetic.plugins.twin.model import TwinModel
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.simulators.embedded import EmbeddedSimulator, Vehicle
from frenetic.spec import Spec

BEND = Road(np.array([0, 0, 0, 2, 5, 5, 5, 2, 0, 0, 0]) / 100)


class InPython(BeamngAi):
    """`BeamngAi`, called from Python."""


def drive(road: Road, driver: BeamngAi, limit: float = 70.0) -> Drive:
    """Return a drive in the car of BeamNG.AI, at a limit in km/h."""
    rules = Rules(speed_limit=limit, oob_tolerance=1.0)
    return EmbeddedSimulator(rules=rules, vehicle="etk800").drive(road, driver)


def test_it_brings_its_car_unless_one_is_chosen() -> None:
    embedded = drive(BEND, BeamngAi())
    simulator = EmbeddedSimulator(rules=embedded.rules)
    for driver in (BeamngAi(), Noisy(BeamngAi(), offset=0.0, heading=0.0), InPython()):
        brought = simulator.drive(BEND, driver)
        np.testing.assert_array_equal(brought.trajectory.to_rows(), embedded.trajectory.to_rows())
        assert brought.car == embedded.car
        simulator.drive(BEND, Planner())
        assert simulator.vehicle == Vehicle(), "others drive in the default car"
    for chosen in ("default", {"mass": 1500.0}, Vehicle(length=5.0)):
        simulator = EmbeddedSimulator(vehicle=chosen)
        before = simulator.vehicle
        simulator.drive(BEND, BeamngAi())
        assert simulator.vehicle == before


def test_it_keeps_the_friction_of_the_road_in_its_car() -> None:
    simulator = EmbeddedSimulator(friction=0.6)
    simulator.drive(BEND, BeamngAi())
    assert simulator.vehicle == replace(Vehicle.named("etk800"), friction=0.6)


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


def test_it_has_its_car_in_another_process() -> None:
    drives = []
    for simulator in ("embedded", "embedded,vehicle=etk800"):
        tester = RoadTester.of(Spec(driver="beamng-ai", simulator=simulator))
        with DriveProcess(tester) as process:
            drives.append(process.drive(BEND))
    brought, chosen = drives
    np.testing.assert_array_equal(brought.trajectory.to_rows(), chosen.trajectory.to_rows())
    assert brought.car == chosen.car


def test_a_twin_of_it_begins_with_its_car() -> None:
    model = TwinModel.of("beamng-ai", ["aiming_point"], vehicle={"mass": 1600.0})
    _, simulator = model.make({}, Rules())
    assert simulator.vehicle == replace(Vehicle.named("etk800"), mass=1600.0)
    chosen = TwinModel.of("beamng-ai", ["aiming_point"], vehicle={"name": "default"})
    assert chosen.make({}, Rules())[1].vehicle == Vehicle()


def test_it_drives_alike_compiled_and_in_python() -> None:
    assert compiled_form(BeamngAi(), 0.05) is not None
    np.testing.assert_array_equal(
        drive(BEND, BeamngAi()).trajectory.to_rows(), drive(BEND, InPython()).trajectory.to_rows()
    )


def test_it_cuts_corners_and_stays_in_the_middle_of_a_straight_road() -> None:
    straight = assess(Road(np.zeros(12)), drive(Road(np.zeros(12)), BeamngAi()))
    assert np.abs(straight.lateral_offset).max() < 0.01
    inside = assess(BEND, drive(BEND, BeamngAi())).lateral_offset.max()
    near = assess(BEND, drive(BEND, BeamngAi(lookahead_time=0.3))).lateral_offset.max()
    assert inside > near + 0.1 > 0.1, "the inside of a left bend is on the left"


def test_the_clearance_of_its_plan_changes_its_path() -> None:
    middle = drive(BEND, BeamngAi(clearance=2.0)).trajectory.to_rows()
    stiff = drive(BEND, BeamngAi(band_strength=0.0, forgiveness=0.0)).trajectory.to_rows()
    np.testing.assert_array_equal(middle, stiff)
    assert not np.array_equal(middle, drive(BEND, BeamngAi()).trajectory.to_rows())


def test_its_speed_follows_aggression_grip_and_limit() -> None:
    def slowest(driver: BeamngAi, limit: float = 70.0) -> float:
        result = drive(BEND, driver, limit)
        return float(result.trajectory.speed[100:].min())

    assert slowest(BeamngAi(aggression=0.4)) < slowest(BeamngAi()) - 1.0
    assert slowest(BeamngAi(aggression=0.9, grip=0.5)) == slowest(BeamngAi(aggression=0.5))
    fastest = drive(BEND, BeamngAi(), 30.0).trajectory.speed.max()
    assert fastest <= 30.0 / 3.6
