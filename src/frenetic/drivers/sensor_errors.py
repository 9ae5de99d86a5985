"""Wrappers over any driver: constant errors and dropouts of what its sensors read.

Four readings can err: lateral place, heading, yaw rate and speed. The road ahead moves with lateral
place and heading, as with `frenetic.drivers.wrappers.Noisy`: a driver that reads
`Observation.ahead` is misled as one that reads `Observation.lateral_offset`. A reading passes first
the noise, then its bias, then its dropouts. A camera's picture stays as it is.
"""

from __future__ import annotations

import math
from typing import Any, ClassVar, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, check
from frenetic._support.compiled import njit
from frenetic.conditions.sensors_and_steering import (
    HEADING_BIAS,
    HEADING_DROPOUT,
    LATERAL_BIAS,
    LATERAL_DROPOUT,
    SPEED_BIAS,
    SPEED_DROPOUT,
    YAW_RATE_BIAS,
    YAW_RATE_DROPOUT,
)
from frenetic.drivers.driver import (
    Controls,
    Driver,
    DriveSetup,
    Observation,
    changed_observation,
)
from frenetic.drivers.stack import AmountWrapper
from frenetic.drivers.wrappers import displaced_pose, disturb

BoolArray: TypeAlias = npt.NDArray[np.bool_]

DROPOUT_MS: Final = 500
"""Time that a dropout takes, in ms (our choice); dropouts may follow each other."""

_BLOCK: Final = 256  # number of stretches that are drawn at once

SIGNALS: Final = ("lateral_offset", "heading_error", "yaw_rate", "speed")
"""Attributes of an `Observation` that can err."""
LATERAL, HEADING, YAW_RATE, SPEED = range(len(SIGNALS))
# Rows of a memory, with a value for each signal: the reading; the last reading that did not drop
# out, NaN before the first; and the change of the reading by a dropout.
_READING, _LAST, _JUMP = range(3)


def new_sensor_memories(count: int) -> FloatArray:
    """Return memories of the sensors of ``count`` cars that have read nothing, (count, 3, 4)."""
    return np.full((count, 3, len(SIGNALS)), math.nan)


@njit(error_model="numpy", force_inline=True, interpret_first=0.1)
def misread(
    lateral_offset: float,
    heading_error: float,
    yaw_rate: float,
    speed: float,
    memory: FloatArray,
    biases: FloatArray,
    dropped: BoolArray,
) -> tuple[float, float, float, float]:
    """Return what the sensors read of the four signals, in the order of the arguments.

    Args:
        lateral_offset, heading_error, yaw_rate, speed: true values, see `Observation`.
        memory: memory of the sensors, (3, 4), see `new_sensor_memories`; the kernel changes it.
        biases: constant errors of the signals, (4,) in m, rad, rad/s and m/s.
        dropped: whether each reading stays at its last value now, (4,).
    """
    memory[_READING, LATERAL] = lateral_offset
    memory[_READING, HEADING] = heading_error
    memory[_READING, YAW_RATE] = yaw_rate
    memory[_READING, SPEED] = speed
    for k in range(len(biases)):
        if biases[k] != 0.0:
            memory[_READING, k] += biases[k]
            if k == SPEED:  # a car that rolls forward never seems to roll back
                memory[_READING, k] = max(memory[_READING, k], min(speed, 0.0))
        memory[_JUMP, k] = 0.0
        if dropped[k] and not math.isnan(memory[_LAST, k]):
            memory[_JUMP, k] = memory[_LAST, k] - memory[_READING, k]
            memory[_READING, k] = memory[_LAST, k]
        else:
            memory[_LAST, k] = memory[_READING, k]
    return (
        memory[_READING, LATERAL],
        memory[_READING, HEADING],
        memory[_READING, YAW_RATE],
        memory[_READING, SPEED],
    )


@njit(error_model="numpy", force_inline=True, interpret_first=0.1)
def move_view(
    ahead: FloatArray, first: int, stop: int, memory: FloatArray, biases: FloatArray
) -> None:
    """Move the view ahead, in place, by the errors of lateral place and heading.

    Args:
        ahead, first, stop: the view, see `disturb`.
        memory, biases: see `misread`, which is called before.
    """
    if biases[LATERAL] != 0.0:
        disturb(ahead, first, stop, biases[LATERAL], 0.0)
    if biases[HEADING] != 0.0:
        disturb(ahead, first, stop, 0.0, biases[HEADING])
    if memory[_JUMP, LATERAL] != 0.0:
        disturb(ahead, first, stop, memory[_JUMP, LATERAL], 0.0)
    if memory[_JUMP, HEADING] != 0.0:
        disturb(ahead, first, stop, 0.0, memory[_JUMP, HEADING])


class Dropouts:
    """The dropouts of one signal in a drive, drawn when they are needed.

    A drive is cut into stretches of `DROPOUT_MS`. In each, the reading drops out with the same
    probability. With a larger share and the same seed, a stretch that dropped out still does.

    Args:
        share: probability that a stretch drops out, 0..1.
        seed: seed of the draws; each signal has draws of its own.
        signal: number of the signal.
    """

    def __init__(self, share: float, seed: int, signal: int) -> None:
        self._share = share
        self._rng = np.random.default_rng([seed, 1 + signal])  # 0 is the noise
        self._stretches = np.empty(0, np.bool_)

    def at(self, milliseconds: npt.NDArray[np.int64]) -> BoolArray:
        """Return whether the reading drops out at times since the start, (n,) in ms."""
        stretches = milliseconds // DROPOUT_MS
        while len(self._stretches) <= stretches.max(initial=0):
            drawn = self._rng.random(_BLOCK) < self._share
            self._stretches = np.concatenate([self._stretches, drawn])
        dropped: BoolArray = self._stretches[stretches]
        return dropped


class ErringSensor(AmountWrapper):
    """Base of wrappers whose driver misreads one signal.

    Args:
        driver: the driver underneath.
        amount: amount of the wrapper's condition.
    """

    signal: ClassVar[int]
    """Number of the signal in `SIGNALS`."""

    def __init__(self, driver: Driver, amount: float) -> None:
        super().__init__(driver, amount)
        self._biases = np.zeros(len(SIGNALS))

    def reset(self, setup: DriveSetup) -> None:
        """Forget the readings of the last drive."""
        super().reset(setup)
        (self._memory,) = new_sensor_memories(1)
        self._dropped = np.zeros(len(SIGNALS), np.bool_)

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the reading of the signal."""
        readings = misread(
            observation.lateral_offset,
            observation.heading_error,
            observation.yaw_rate,
            observation.speed,
            self._memory,
            self._biases,
            self._dropped,
        )
        name = SIGNALS[self.signal]
        reading = float(readings[self.signal])
        changes: dict[str, Any] = {name: reading}
        if self.signal in (LATERAL, HEADING):
            ahead = observation.ahead.copy()
            move_view(ahead, 0, len(ahead), self._memory, self._biases)
            error = reading - getattr(observation, name)
            offset, turn = (error, 0.0) if self.signal == LATERAL else (0.0, error)
            changes |= {"ahead": ahead, **displaced_pose(observation, offset, turn)}
        return self.driver.act(changed_observation(observation, **changes))


class SensorBias(ErringSensor):
    """Base of wrappers with a constant error of one signal.

    Args:
        driver: the driver underneath.
        amount: the error.
    """

    amount_name = "error"
    bias_per_amount: ClassVar[float] = 1.0
    """Error in the unit of the signal per amount of the condition."""

    def __init__(self, driver: Driver, amount: float) -> None:
        super().__init__(driver, amount)
        self._biases[self.signal] = self.bias

    @property
    def bias(self) -> float:
        """Error in the unit of the signal."""
        return self.amount * self.bias_per_amount


class LateralBias(SensorBias):
    """A driver that believes itself further left than it is: it keeps to the right of its aim.

    Args:
        driver: the driver underneath.
        amount: the error, in m, positive to the left.
    """

    condition = LATERAL_BIAS
    signal = LATERAL
    place = 10


class HeadingBias(SensorBias):
    """A driver that believes its car turned further to the left than it is.

    Args:
        driver: the driver underneath.
        amount: the error, in rad, positive to the left.
    """

    condition = HEADING_BIAS
    signal = HEADING
    place = 11


class YawRateBias(SensorBias):
    """A driver that reads a yaw rate with a constant error.

    Args:
        driver: the driver underneath.
        amount: the error, in rad/s, positive to the left.
    """

    condition = YAW_RATE_BIAS
    signal = YAW_RATE
    place = 12


class SpeedBias(SensorBias):
    """A driver that reads a speed with a constant error; of a car that rolls forward, at least 0.

    Args:
        driver: the driver underneath.
        amount: the error, in km/h.
    """

    condition = SPEED_BIAS
    signal = SPEED
    place = 13
    bias_per_amount = 1.0 / 3.6


class SensorDropout(ErringSensor):
    """Base of wrappers whose signal stays at its last reading, for 0.5 s or a multiple of it.

    Args:
        driver: the driver underneath.
        amount: share of the time, 0..1.
        seed: seed of the dropouts, at least 0. Every drive has the same dropouts.
    """

    amount_name = "share"

    def __init__(self, driver: Driver, amount: float, *, seed: Index = 0) -> None:
        check({"seed": seed}, SensorDropout.__init__)
        super().__init__(driver, amount)
        self.seed = int(seed)

    @property
    def options(self) -> dict[str, float]:
        """Options of the wrapper."""
        return {**super().options, "seed": self.seed}

    def dropouts(self) -> Dropouts:
        """Return the dropouts in a drive."""
        return Dropouts(self.amount, self.seed, self.signal)

    def reset(self, setup: DriveSetup) -> None:
        """Forget the readings of the last drive, and start the dropouts anew."""
        super().reset(setup)
        self._dropouts = self.dropouts()

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the reading of the signal."""
        now = np.array([round(1e3 * observation.time)])
        self._dropped[self.signal] = self._dropouts.at(now)[0]
        return super().act(observation)


class LateralDropout(SensorDropout):
    """A driver whose lateral place stays at its last reading at times, see `SensorDropout`."""

    condition = LATERAL_DROPOUT
    signal = LATERAL
    place = 14


class HeadingDropout(SensorDropout):
    """A driver whose heading stays at its last reading at times, see `SensorDropout`."""

    condition = HEADING_DROPOUT
    signal = HEADING
    place = 15


class YawRateDropout(SensorDropout):
    """A driver whose yaw rate stays at its last reading at times, see `SensorDropout`."""

    condition = YAW_RATE_DROPOUT
    signal = YAW_RATE
    place = 16


class SpeedDropout(SensorDropout):
    """A driver whose speed stays at its last reading at times, see `SensorDropout`."""

    condition = SPEED_DROPOUT
    signal = SPEED
    place = 17
