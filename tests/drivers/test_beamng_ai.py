"""The model of BeamNG.AI."""

import numpy as np
import pytest

from frenetic.drive import Drive, Rules
from frenetic.drivers import BeamngAi
from frenetic.drivers.layers import compiled_form
from frenetic.oracle import assess, judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators.embedded import EmbeddedSimulator

BEND = Road(np.array([0, 0, 0, 2, 5, 5, 5, 2, 0, 0, 0]) / 100)


class InPython(BeamngAi):
    """The same driver, called from Python."""


def drive(road: Road, driver: BeamngAi, limit: float = 70.0) -> Drive:
    rules = Rules(speed_limit=limit, oob_tolerance=1.0)
    return EmbeddedSimulator(rules=rules, vehicle="etk800").drive(road, driver)


def test_its_values_are_checked() -> None:
    with pytest.raises(ValueError, match="aggression is 0: a positive number is needed"):
        BeamngAi(aggression=0)


def test_it_drives_alike_compiled_and_from_python() -> None:
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


def test_its_plan_stays_clear_of_the_edges_of_its_lane() -> None:
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


def test_it_masters_a_straight_road() -> None:
    straight = Road(np.zeros(20))
    assert judge(straight, drive(straight, BeamngAi())).outcome is Outcome.PASS
