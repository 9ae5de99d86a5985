"""Wind, a condition of this package: it turns the wheels a little."""

from dataclasses import replace

from frenetic import Controls, Driver, DriveSetup, Observation
from frenetic.conditions import Condition

CONDITIONS = (
    Condition(
        name="wind",
        about="angle by which wind from the right turns the wheels",
        unit="rad",
        low=0.0,
        high=0.5,
        usual=(0.0, 0.1),
        no_effect=0.0,
        wrapper="lane_lab.wind:Windy",
    ),
)


class Windy:
    """A driver in wind from the right."""

    def __init__(self, driver: Driver, amount: float) -> None:
        self.driver, self.amount = driver, amount

    @classmethod
    def over(cls, driver: Driver, amount: float) -> "Windy":
        return cls(driver, amount)

    def reset(self, setup: DriveSetup) -> None:
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        controls = self.driver.act(observation)
        return replace(controls, steering=controls.steering + self.amount)
