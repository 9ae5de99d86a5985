"""A driver, a strategy and a simulator."""

import numpy as np

from frenetic import (
    Candidate,
    Controls,
    Drive,
    Driver,
    DriveSetup,
    EmbeddedSimulator,
    Evaluation,
    Observation,
    Road,
    Rules,
    Strategy,
)
from frenetic.search import Origin
from frenetic.search.strategy import Ledger


class Hasty:
    """A driver that steers for a point 10 m ahead and keeps one speed."""

    def __init__(self, speed: float = 50.0) -> None:
        self.speed = speed

    def reset(self, setup: DriveSetup) -> None:
        pass

    def act(self, observation: Observation) -> Controls:
        x, y = observation.ahead[5]
        gas = min(max(self.speed / 3.6 - observation.speed, 0.0), 1.0)
        return Controls(float(2.0 * y / (x * x + y * y)), throttle=gas)


class Zigzag(Strategy):
    """A strategy of zigzag roads that get sharper and sharper."""

    def __init__(self, seed: int) -> None:
        self.ledger, self.seed = Ledger(), seed

    def ask(self) -> Candidate:
        sharpness = 0.01 + 0.004 * self.ledger.issued
        bends = sharpness * np.sin(0.7 * np.arange(20) + self.seed)
        return self.ledger.issue(bends, 10.0, Origin("zigzag"))

    def tell(self, evaluation: Evaluation) -> None:
        self.ledger.settle(evaluation)


class Rails(EmbeddedSimulator):
    """The embedded simulator with tyres that hardly slide."""

    def __init__(self, *, rules: Rules | None = None) -> None:
        super().__init__(rules=rules, friction=1.4)

    def drive(self, road: Road, driver: Driver) -> Drive:
        return super().drive(road, driver)
