"""The preset of the planner that is tuned to rank roads as BeamNG.AI fares on them."""

from dataclasses import fields

import numpy as np
import numpy.typing as npt
import pytest

from frenetic.drivers import BeamngAi, Planner
from frenetic.drivers.layers import compiled_form
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators.drive import Rules
from frenetic.simulators.embedded import EmbeddedSimulator

RULES = Rules(speed_limit=120.0, oob_tolerance=0.5)


def test_it_is_a_planner_with_other_values_of_the_same_parameters() -> None:
    assert issubclass(BeamngAi, Planner)
    assert [f.name for f in fields(BeamngAi)] == [f.name for f in fields(Planner)]
    assert BeamngAi().aggression == Planner().aggression == 1.0
    assert not np.array_equal(BeamngAi().parameters(), Planner().parameters())


def test_its_values_can_be_changed_and_are_checked() -> None:
    assert BeamngAi(braking=3.0).braking == 3.0
    with pytest.raises(ValueError, match="braking is 0: a positive number is needed"):
        BeamngAi(braking=0)


def test_it_drives_in_the_compiled_rollout_as_the_planner_with_its_values_does() -> None:
    preset = BeamngAi()
    twin = Planner(**{f.name: getattr(preset, f.name) for f in fields(preset)})
    road = Road(np.array([0, 2, 4, 1, -3, -5, -2, 0, 0, 0]) / 100, lane_width=5.0)
    simulator = EmbeddedSimulator(rules=RULES)
    assert compiled_form(preset, simulator.setup(road).period) is not None
    mine = simulator.drive(road, preset).trajectory.to_rows()
    np.testing.assert_array_equal(mine, simulator.drive(road, twin).trajectory.to_rows())
    assert not np.array_equal(mine, simulator.drive(road, Planner()).trajectory.to_rows())


def test_it_masters_a_straight_road_and_leaves_some_of_the_winding_ones() -> None:
    simulator = EmbeddedSimulator(rules=RULES)
    rng = np.random.default_rng(1)
    straight = Road(np.zeros(20), lane_width=5.0)
    assert judge(straight, simulator.drive(straight, BeamngAi())).outcome is Outcome.PASS
    winding = [Road(_wander(rng), lane_width=5.0) for _ in range(60)]
    failed = [judge(r, simulator.drive(r, BeamngAi())).outcome is Outcome.FAIL for r in winding]
    assert 6 <= sum(failed) <= 54


def _wander(rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Curvatures of a random road as the search proposes them."""
    values = [0.0]
    while len(values) < 20:
        values.append(float(np.clip(values[-1] + rng.uniform(-0.05, 0.05), -0.07, 0.07)))
    return np.array(values)
