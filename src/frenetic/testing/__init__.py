"""Tests of drivers for pytest; conformance suites for strategies, simulators and drivers.

`keeps_lane` makes a test of a function that returns a driver. The suites need pytest
(``pip install pytest``): subclass one in a test file and make yours in it. Stand-ins to start from
need nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.testing.driver_contract import DriverContract
    from frenetic.testing.dummies import DummyDriver, DummySimulator, converse
    from frenetic.testing.lane_test import keeps_lane
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
]

# Imported when they are used: pytest loads this package, with the plug-in, in every session.
__getattr__ = lazy_names(__name__)
