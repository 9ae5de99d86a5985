"""Conformance suites for strategies, simulators and drivers, and stand-ins to start from.

The suites need pytest (``pip install pytest``): subclass one in a test file and say how to make
yours.
"""

from frenetic.testing.driver_contract import DriverContract
from frenetic.testing.dummy import DummyDriver, DummySimulator, converse, operators_of
from frenetic.testing.simulator_contract import SimulatorContract
from frenetic.testing.strategy_contract import StrategyContract

__all__ = [
    "DriverContract",
    "DummyDriver",
    "DummySimulator",
    "SimulatorContract",
    "StrategyContract",
    "converse",
    "operators_of",
]
