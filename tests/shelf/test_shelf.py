"""Real drivers off the shelf: the contract, and roads on which a fault of the glue shows."""

from __future__ import annotations

import math
import sys
from importlib.util import find_spec
from typing import Any

import pytest

from frenetic import Driver, EmbeddedSimulator, Rules
from frenetic.errors import FreneticError
from frenetic.registry import DRIVERS
from frenetic.testing import TrackerContract
from frenetic.testing.tracker_contract import ROADS

MODULES = {
    "highway-env": "highway_env",
    "opendbc": "opendbc",
    "rox-control": "rox_control",
    "fiss-planner": "fiss_planner",
}
"""Driver, and so extra -> module of its package."""
KEEPS = {
    "highway-env": 0.2,
    "opendbc": 0.15,
    "rox-control": 0.1,
    "fiss-planner": 0.1,
}
"""Distance from the lane's centre that it keeps on all these roads, in m."""


def among(names: Any) -> list[Any]:
    """The drivers as parameters, skipped where their package is not installed."""
    return [
        pytest.param(
            name,
            marks=pytest.mark.skipif(
                find_spec(MODULES[name]) is None, reason=f"{name} is not installed"
            ),
        )
        for name in names
    ]


class TestContract(TrackerContract):
    @pytest.fixture(autouse=True, params=among(MODULES))
    def _named(self, request: pytest.FixtureRequest) -> None:
        self.name = request.param
        self.keeps = KEEPS[self.name]

    def make(self) -> Driver:
        driver: Driver = DRIVERS.make(self.name)
        return driver


@pytest.mark.parametrize("name", among(MODULES))
def test_it_slows_down_for_bends_as_far_as_it_is_told(name: str) -> None:
    """On a circle of 50 m, the option `lateral` says how fast; 100 leaves the speed limit."""
    fastest = {}
    for lateral in (1.0, 100.0):
        driver = DRIVERS.make(name, lateral=lateral)
        simulator = EmbeddedSimulator(rules=Rules(speed_limit=32.0), steering_lag=0.03)
        drive = simulator.drive(ROADS["left-hand circle"], driver)
        assert drive.error is None, drive.error
        fastest[lateral] = drive.trajectory.speed[-1]
    assert fastest[1.0] == pytest.approx(math.sqrt(1.0 * 52.0), abs=0.5)
    assert fastest[100.0] == pytest.approx(32.0 / 3.6, abs=0.4)


@pytest.mark.parametrize("name", MODULES)
def test_without_its_package_it_says_what_to_install(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in [m for m in sys.modules if m.partition(".")[0] == MODULES[name]]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, MODULES[name], None)
    with pytest.raises(FreneticError, match=rf"{name} needs the package .*\[{name}\]"):
        DRIVERS.make(name)
