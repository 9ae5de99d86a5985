"""Conformance suites for strategies, simulators and drivers, and stand-ins to start from.

The suites need pytest (``pip install pytest``): subclass one in a test file and make yours in it.
The stand-ins need nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from frenetic.testing.dummy import DummyDriver, DummySimulator, converse

if TYPE_CHECKING:
    from frenetic.testing.driver_contract import DriverContract
    from frenetic.testing.simulator_contract import SimulatorContract
    from frenetic.testing.strategy_contract import StrategyContract

_CONTRACTS = {
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
]


def __getattr__(name: str) -> Any:
    if name not in _CONTRACTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_CONTRACTS[name]), name)
