"""Tests of drivers for pytest; conformance suites for strategies, simulators and drivers.

`keeps_lane` and `steers_well` turn a function that returns a driver into a test. The conformance
suites need pytest (``pip install pytest``): subclass one in a test file, and return your part from
its method `make`. The stand-ins `DummySimulator` and `DummyDriver` need no pytest, nor does
`converse`, a stand-in for a campaign.

Names are imported on use, since pytest loads this package, with its plug-in, in every session.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.testing.driver_contract import DriverContract
    from frenetic.testing.dummies import DummyDriver, DummySimulator, converse
    from frenetic.testing.lane_test import keeps_lane, steers_well
    from frenetic.testing.simulator_contract import SimulatorContract
    from frenetic.testing.strategy_contract import StrategyContract
    from frenetic.testing.tracker_contract import TrackerContract

__all__ = [
    "DriverContract",
    "DummyDriver",
    "DummySimulator",
    "SimulatorContract",
    "StrategyContract",
    "TrackerContract",
    "converse",
    "keeps_lane",
    "steers_well",
]

_MODULES = {
    "DriverContract": "frenetic.testing.driver_contract",
    "DummyDriver": "frenetic.testing.dummies",
    "DummySimulator": "frenetic.testing.dummies",
    "SimulatorContract": "frenetic.testing.simulator_contract",
    "StrategyContract": "frenetic.testing.strategy_contract",
    "TrackerContract": "frenetic.testing.tracker_contract",
    "converse": "frenetic.testing.dummies",
    "keeps_lane": "frenetic.testing.lane_test",
    "steers_well": "frenetic.testing.lane_test",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
