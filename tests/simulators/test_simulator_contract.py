from __future__ import annotations

from frenetic.simulators import EmbeddedSimulator, Rules, Simulator
from frenetic.testing import DummySimulator, SimulatorContract


class TestEmbedded(SimulatorContract):
    def make(self, rules: Rules) -> Simulator:
        return EmbeddedSimulator(rules=rules)


class TestDummy(SimulatorContract):
    asks_driver = False

    def make(self, rules: Rules) -> Simulator:
        return DummySimulator(rules=rules)
