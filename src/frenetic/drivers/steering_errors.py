"""Wrappers over any driver: errors of the steering between the driver's command and the car.

A command passes, in this order: its resolution, the gain, the offset, the dead band, the rate, and
last of all the delay of `frenetic.drivers.wrappers.Delayed`. The car's own limit, rate and lag
follow in the simulator. Pedals are carried out as asked.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.conditions.sensors_and_steering import (
    STEERING_CONDITIONS,
    STEERING_DEAD_BAND,
    STEERING_GAIN,
    STEERING_OFFSET,
    STEERING_RATE,
    STEERING_RESOLUTION,
)
from frenetic.drivers.calls import MOST_STEERING, checked_controls
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.stack import AmountWrapper

# Indices of the amounts, in the order of `STEERING_CONDITIONS`.
_RESOLUTION, _GAIN, _OFFSET, _DEAD_BAND, _RATE = range(len(STEERING_CONDITIONS))
# Indices of the state: angles that left the dead band and the limit of the rate.
_BEHIND_DEAD_BAND, _BEHIND_RATE = range(2)
STEERING_STATE_SIZE: Final = 2
"""Number of angles that `carried_out` keeps from command to command; 0 rad at the start."""


def exact_steering() -> FloatArray:
    """Return amounts (5,) for `carried_out` that have no effect."""
    return np.array([float(condition.no_effect or 0.0) for condition in STEERING_CONDITIONS])


@njit(error_model="numpy", force_inline=True, interpret_first=0.1)
def carried_out(command: float, amounts: FloatArray, state: FloatArray, period: float) -> float:
    """Return the steering angle that a commanded angle becomes, in rad.

    Args:
        command: angle that the driver asks for, in rad.
        amounts: amounts of `STEERING_CONDITIONS`, (5,).
        state: angles of the last command, (2,) in rad, which the kernel changes.
        period: time since the last command, in s.
    """
    angle = command
    if amounts[_RESOLUTION] > 0.0:
        angle = np.rint(angle / amounts[_RESOLUTION]) * amounts[_RESOLUTION]
    if amounts[_GAIN] != 1.0:
        angle = min(max(amounts[_GAIN] * angle, -MOST_STEERING), MOST_STEERING)
    if amounts[_OFFSET] != 0.0:
        angle = min(max(angle + amounts[_OFFSET], -MOST_STEERING), MOST_STEERING)
    if amounts[_DEAD_BAND] > 0.0:
        band = amounts[_DEAD_BAND]
        angle = min(max(state[_BEHIND_DEAD_BAND], angle - band), angle + band)
        state[_BEHIND_DEAD_BAND] = angle
    if amounts[_RATE] < math.inf:
        change = amounts[_RATE] * period
        angle = min(max(angle, state[_BEHIND_RATE] - change), state[_BEHIND_RATE] + change)
        state[_BEHIND_RATE] = angle
    return float(angle)


class ErringSteering(AmountWrapper):
    """Base of wrappers whose steering does not reach the car as the driver commands it.

    Args:
        driver: the driver underneath.
        amount: amount of the wrapper's condition.
    """

    def __init__(self, driver: Driver, amount: float) -> None:
        super().__init__(driver, amount)
        self._amounts = exact_steering()
        self._amounts[STEERING_CONDITIONS.index(self.condition)] = self.amount

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive, with straight wheels."""
        super().reset(setup)
        self._period = setup.period
        self._state = np.zeros(STEERING_STATE_SIZE)

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls with the steering that is carried out."""
        command, throttle, brake = checked_controls(self.driver.act(observation))
        angle = carried_out(command, self._amounts, self._state, self._period)
        return Controls(angle, throttle, brake)


class SteeringResolution(ErringSteering):
    """A driver whose steering is rounded to multiples of a step, as by a message's resolution.

    Args:
        driver: the driver underneath.
        amount: the step, in rad; 0 for none.
    """

    condition = STEERING_RESOLUTION
    amount_name = "step"
    place = 22


class SteeringGain(ErringSteering):
    """A driver whose steering is multiplied by a factor, as by a steering ratio that is wrong.

    Args:
        driver: the driver underneath.
        amount: the factor.
    """

    condition = STEERING_GAIN
    amount_name = "factor"
    place = 21


class SteeringOffset(ErringSteering):
    """A driver whose front wheels stand beside the commanded angle, as with a wrong zero.

    Args:
        driver: the driver underneath.
        amount: angle that is added, in rad, positive to the left.
    """

    condition = STEERING_OFFSET
    amount_name = "angle"
    place = 20


class SteeringDeadBand(ErringSteering):
    """A driver whose steering has a dead band, as play in the column has.

    The angle stays until the command is more than the dead band away, and then follows the command
    at this distance.

    Args:
        driver: the driver underneath.
        amount: the distance, in rad: after the command has turned round, twice as much passes
            before the wheels move.
    """

    condition = STEERING_DEAD_BAND
    amount_name = "angle"
    place = 19


class SteeringRate(ErringSteering):
    """A driver whose steering turns no faster than the rate of its actuator.

    Args:
        driver: the driver underneath.
        amount: the rate, in rad/s.
    """

    condition = STEERING_RATE
    amount_name = "rate"
    place = 18
