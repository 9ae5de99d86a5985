"""Speed limits along a road: drivers see them and keep them, criteria judge by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frenetic import Controls, DriveSetup, EmbeddedSimulator, Observation, Planner, Road, Stanley
from frenetic.criteria.criterion import CriteriaSet
from frenetic.drivers import BeamngAi, LimitedView
from frenetic.drivers.builtin import BuiltIn
from frenetic.drivers.wrappers import Hasty
from frenetic.oracle.drive import Drive, Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge

STRAIGHT = Road(np.zeros(61), speed_limits=[(0, 50), (200, 30), (400, 80)])


class Watching:
    """A driver around another, which records its setup and its observations."""

    def __init__(self, driver: BuiltIn | None = None) -> None:
        self.driver = driver or Planner()
        self.observations: list[Observation] = []

    def reset(self, setup: DriveSetup) -> None:
        self.setup = setup
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        self.observations.append(observation)
        return self.driver.act(observation)


def speeds(drive: Drive, *places: float) -> list[float]:
    """Speed in km/h at places in m along a straight road."""
    path = drive.trajectory
    return [3.6 * float(np.interp(place, path.y, path.speed)) for place in places]


def test_a_driver_sees_the_limit_at_its_place_and_the_limits_ahead() -> None:
    watching = Watching()
    EmbeddedSimulator().drive(STRAIGHT, watching)
    assert watching.setup.speed_limit == pytest.approx(50 / 3.6)
    for observation in watching.observations:
        limit = 50 if observation.distance < 200 else 30 if observation.distance < 400 else 80
        assert observation.speed_limit == pytest.approx(limit / 3.6)
        starts = observation.distance + 2.0 * np.arange(len(observation.ahead))
        fine = starts[:, None] + np.linspace(0.0, 2.0, 41)[:-1]
        limits = np.where(fine < 200, 50, np.where(fine < 400, 30, 80)).min(axis=1)
        near = (np.abs(starts + 2.0 - 200) < 0.1) | (np.abs(starts + 2.0 - 400) < 0.1)
        assert observation.speed_limit_ahead[~near] == pytest.approx(limits[~near] / 3.6)
        assert not observation.speed_limit_ahead.flags.writeable


def test_wrappers_change_each_limit() -> None:
    inner = Watching()
    EmbeddedSimulator().drive(STRAIGHT, Hasty(LimitedView(inner, distance=20.0), excess=18.0))
    assert inner.setup.speed_limit == pytest.approx(68 / 3.6)
    last = inner.observations[-1]
    assert last.speed_limit == pytest.approx(98 / 3.6)
    assert len(last.speed_limit_ahead) == len(last.ahead) == 11


@pytest.mark.parametrize("kind", [Planner, Stanley, BeamngAi])
def test_built_in_drivers_keep_each_limit_compiled_and_in_python(kind: type[BuiltIn]) -> None:
    compiled = EmbeddedSimulator(vehicle="default").drive(STRAIGHT, kind())
    in_python = EmbeddedSimulator(vehicle="default").drive(STRAIGHT, Watching(kind()))
    assert np.array_equal(compiled.trajectory.to_rows(), in_python.trajectory.to_rows())
    before, at_lower, in_lower, behind = speeds(compiled, 120, 205, 390, 590)
    assert 44 < before <= 51
    assert at_lower <= 33  # it has braked before the sign
    assert 24 < in_lower <= 31
    assert 70 < behind <= 81


def test_the_limit_of_a_road_acts_as_the_limit_of_the_rules() -> None:
    with_road_limit = EmbeddedSimulator().drive(
        replace(STRAIGHT, speed_limits=np.array([[0.0, 40.0]])), Planner()
    )
    rules = Rules(speed_limit=40.0)
    with_rules = EmbeddedSimulator(rules=rules).drive(Road(np.zeros(61)), Planner())
    assert np.array_equal(with_road_limit.trajectory.to_rows(), with_rules.trajectory.to_rows())


def test_a_criterion_judges_by_the_limit_at_the_place_of_the_car() -> None:
    criteria = CriteriaSet.from_entries("own", {"speed_excess": 6.0})
    rules = Rules(speed_limit=50.0, criteria=criteria)
    sharp = replace(STRAIGHT, speed_limits=np.array([[0.0, 50.0], [200.0, 30.0]]))
    drive = EmbeddedSimulator(rules=replace(rules, road_limits="ignored")).drive(sharp, Planner())
    assert judge(sharp, drive).outcome is Outcome.PASS  # nobody went faster than 50 km/h
    result = judge(sharp, replace(drive, rules=rules))
    assert result.outcome is Outcome.FAIL
    assert result.finding is not None
    assert result.finding.criterion == "speed_excess"
    assert result.finding.distance > 200.0
    slow = EmbeddedSimulator(rules=rules).drive(sharp, Planner())
    assert judge(sharp, slow).outcome is Outcome.PASS
