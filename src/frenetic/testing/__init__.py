"""Tests of drivers for pytest; conformance suites for strategies, simulators and drivers.

`keeps_lane` makes a test of a function that returns a driver. The suites need pytest
(``pip install pytest``): subclass one in a test file and make yours in it. Stand-ins to start from
need nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frenetic.testing.driver_contract import DriverContract
    from frenetic.testing.dummy import DummyDriver, DummySimulator, converse
    from frenetic.testing.keeping import keeps_lane
    from frenetic.testing.simulator_contract import SimulatorContract
    from frenetic.testing.strategy_contract import StrategyContract

# Imported when they are used: pytest loads this package, with the plug-in, in every session.
_LATER = {
    "DummyDriver": "frenetic.testing.dummy",
    "DummySimulator": "frenetic.testing.dummy",
    "converse": "frenetic.testing.dummy",
    "keeps_lane": "frenetic.testing.keeping",
    "DriverContract": "frenetic.testing.driver_contract",
    "SimulatorContract": "frenetic.testing.simulator_contract",
    "StrategyContract": "frenetic.testing.strategy_contract",
}

__all__ = [
    "DriverContract",
    "DummyDriver",
    "DummySimulator",
    "SimulatorContract",
    "StrategyContract",
    "converse",
    "keeps_lane",
]


def __getattr__(name: str) -> Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_LATER[name]), name)
