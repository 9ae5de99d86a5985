"""MetaDrive as a simulator: the contract, its beginning and end, and what goes wrong.

No part of MetaDrive is replaced; one engine after the other runs in this process.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from metadrive.engine.engine_utils import get_engine
from metadrive_drives import STRAIGHT, WINDING, Fixed, run
from panda3d.core import Vec3

from frenetic.drivers import Controls, Observation, Stanley
from frenetic.errors import FreneticError
from frenetic.metadrive import MetaDriveSimulator
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.simulators import Rules, Simulator
from frenetic.testing import SimulatorContract


class TestMetaDrive(SimulatorContract):
    def make(self, rules: Rules) -> Simulator:
        return MetaDriveSimulator(rules=rules)


def test_friction_limits_the_lateral_acceleration() -> None:
    driver = Fixed(Controls(0.4), 5.0, Controls(0.0, throttle=1.0))
    grips = []
    for friction in (1.0, 0.5):
        with MetaDriveSimulator(friction=friction) as simulator:
            t = simulator.drive(STRAIGHT, driver).trajectory
        grips.append(np.abs(t.yaw_rate * t.speed)[102:110].max())
    assert grips[0] == pytest.approx(0.9 * 9.81, rel=0.1)
    assert grips[1] == pytest.approx(0.45 * 9.81, rel=0.15)


def test_options_out_of_range_are_refused() -> None:
    for make, name, value in (
        (MetaDriveSimulator, "friction", 0.0),
        (MetaDriveSimulator, "friction", math.nan),
        (MetaDriveSimulator, "start_offset", 3.0),
    ):
        with pytest.raises(ValueError, match=rf"{name} is {value}: (a number|-2 to 2 m)"):
            make(**{name: value})  # type: ignore[arg-type]


def test_one_engine_per_process() -> None:
    with MetaDriveSimulator() as simulator:
        with pytest.raises(FreneticError, match="a MetaDrive engine is running in this process"):
            MetaDriveSimulator().__enter__()
        assert judge(WINDING, simulator.drive(WINDING, Stanley())).outcome is Outcome.PASS


def test_broken_physics_is_the_simulators_fault() -> None:
    class Saboteur(Fixed):
        def act(self, observation: Observation) -> Controls:
            if observation.time >= 1.0:
                car = get_engine().agent_manager.active_agents["default_agent"]
                car.body.setLinearVelocity(Vec3(1e38))
            return self.controls

    with (
        MetaDriveSimulator() as simulator,
        pytest.raises(ArithmeticError, match="physics broke"),
    ):
        simulator.drive(STRAIGHT, Saboteur(Controls(0.0, throttle=1.0)))
    with MetaDriveSimulator() as simulator:
        assert judge(STRAIGHT, simulator.drive(STRAIGHT, Stanley())).outcome is Outcome.PASS


def test_missing_package_is_said_in_one_line() -> None:
    code = (
        "import sys\n"
        "sys.modules['metadrive'] = None\n"
        "from frenetic.errors import FreneticError\n"
        "from frenetic.registry import SIMULATORS\n"
        "try:\n"
        "    SIMULATORS.make('metadrive').__enter__()\n"
        "except FreneticError as error:\n"
        "    print(error)\n"
    )
    assert run(code).splitlines() == [
        'the simulator metadrive needs the package metadrive: pip install ".[metadrive]" in the'
        " clone of Frenetic"
    ]
