"""Policies as drivers: they get an observation as a vector, and answer with an action.

All numbers of the vector and of the action lie in -1..1. The environment of
`frenetic.plugins.gym` trains on this vector and these actions; `PolicyDriver` drives with them in
any simulator. Both call the same kernels, so a policy drives alike in both.

The vector, float32, has 26 numbers; the constants below are their full scales:

| index | number | full scale |
| --- | --- | --- |
| 0 | speed | `MAX_SPEED` |
| 1 | speed limit minus speed | `MAX_SPEED` |
| 2 | yaw rate, positive to the left | `MAX_YAW_RATE` |
| 3 | angle of the front wheels, positive to the left | `STEERING_RANGE`, or the car's limit |
| 4 | offset from the lane's centre, positive to the left | width of the lane |
| 5 | heading error, positive to the left | `MAX_HEADING_ERROR` |
| 6..25 | curvature of the lane every 4 m from the car on, positive to the left | `MAX_CURVATURE` |

The action has 2 numbers: steering, where 1 asks for index 3's full scale to the left, and a pedal:
throttle above 0, brake below 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.drivers.driver import AHEAD_POINTS, Controls, DriveSetup, Observation

# LANE_WIDTH, MAX_STEERING and SPEED_LIMIT are no values: they are indices of the array that
# `setup_array` returns.
from frenetic.drivers.laws import LANE_WIDTH, MAX_STEERING, SPEED_LIMIT, setup_array
from frenetic.errors import DriverError

# The full scales are our choice.
MAX_SPEED: Final = 40.0
"""Full scale of speeds, in m/s: a larger speed is cut to 1."""
MAX_YAW_RATE: Final = 2.0
"""Full scale of the yaw rate, in rad/s."""
MAX_HEADING_ERROR: Final = 0.5
"""Full scale of the heading error, in rad."""
MAX_CURVATURE: Final = 0.1
"""Full scale of curvatures, in 1/m; valid roads have at most 0.07."""
STEERING_RANGE: Final = 0.5
"""Full scale of the front wheels' angle, in rad; the car's largest angle if that is less."""
POINTS_APART: Final = 2
"""Every second point of the driver's view gives a curvature: one every 4 m."""
CURVATURES: Final = AHEAD_POINTS // POINTS_APART
"""Number of curvatures in the vector, the last one 76 m ahead."""
VECTOR_SIZE: Final = 6 + CURVATURES
"""Length of the vector."""
ACTION_SIZE: Final = 2
"""Length of an action."""
_MAX_TEXT: Final = 80
"""Largest number of characters of a wrong action in an error's message (our choice)."""


@njit()
def _scaled(value: float, full_scale: float) -> float:
    """Return a value as a share of its full scale, cut to -1..1."""
    return min(max(value / full_scale, -1.0), 1.0)


@njit()
def _full_steering(setup: FloatArray) -> float:
    """Return the full scale of the front wheels' angle, in rad; the car's largest angle if less."""
    return min(STEERING_RANGE, setup[MAX_STEERING])  # type: ignore[no-any-return]


@njit()
def write_vector(
    speed: float,
    yaw_rate: float,
    steering: float,
    lateral_offset: float,
    heading_error: float,
    curvature_ahead: FloatArray,
    points: int,
    setup: FloatArray,
    limit: float,
    out: npt.NDArray[np.float32],
) -> None:
    """Write the vector of an observation to ``out``, (VECTOR_SIZE,).

    Args:
        speed, yaw_rate, steering, lateral_offset, heading_error, curvature_ahead: as in an
            `Observation`.
        points: number of valid values of ``curvature_ahead``; 0 stands for later ones.
        setup: array that `setup_array` returns.
        limit: speed limit where the car is, in m/s.
        out: array that receives the vector.
    """
    out[0] = _scaled(speed, MAX_SPEED)
    out[1] = _scaled(limit - speed, MAX_SPEED)
    out[2] = _scaled(yaw_rate, MAX_YAW_RATE)
    out[3] = _scaled(steering, _full_steering(setup))
    out[4] = _scaled(lateral_offset, setup[LANE_WIDTH])
    out[5] = _scaled(heading_error, MAX_HEADING_ERROR)
    for j in range(CURVATURES):
        point = j * POINTS_APART
        out[6 + j] = _scaled(curvature_ahead[point], MAX_CURVATURE) if point < points else 0.0


@njit()
def controls_of(steering: float, pedal: float, setup: FloatArray) -> tuple[float, float, float]:
    """Return steering in rad, throttle and brake for an action.

    Args:
        steering, pedal: the action; values beyond -1..1 are cut.
        setup: array that `setup_array` returns.
    """
    steering = min(max(steering, -1.0), 1.0)
    pedal = min(max(pedal, -1.0), 1.0)
    angle = steering * _full_steering(setup)
    return angle, max(pedal, 0.0), max(-pedal, 0.0)


def vector_of(observation: Observation, setup: FloatArray) -> npt.NDArray[np.float32]:
    """Return the vector of an observation, (VECTOR_SIZE,).

    Args:
        observation: the observation.
        setup: array that `setup_array` returns; its speed limit is used where the observation's
            limit is infinite.
    """
    o = observation
    limit = o.speed_limit if math.isfinite(o.speed_limit) else setup[SPEED_LIMIT]
    vector = np.empty(VECTOR_SIZE, np.float32)
    write_vector(
        o.speed,
        o.yaw_rate,
        o.steering,
        o.lateral_offset,
        o.heading_error,
        o.curvature_ahead,
        len(o.curvature_ahead),
        setup,
        float(limit),
        vector,
    )
    return vector


class PolicyDriver:
    """A driver that asks a policy, such as one that was trained in `frenetic.plugins.gym`.

    Args:
        policy: a function from a vector to an action, both as `frenetic.plugins.vision.policy`
            describes them. It must not keep state: the same vector gives the same action.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, which campaigns record: increase it when the same policy gets other
    controls."""

    def __init__(self, policy: Callable[[npt.NDArray[np.float32]], npt.ArrayLike]) -> None:
        self.policy = policy

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self._setup = setup_array(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the controls of the policy's action.

        Raises:
            DriverError: the action is not two finite numbers.
        """
        answer = self.policy(vector_of(observation, self._setup))
        try:
            action = np.asarray(answer, dtype=np.float64)
        except (TypeError, ValueError):  # such as a text or lists of different lengths
            action = np.empty(0)
        if action.shape != (ACTION_SIZE,) or not np.isfinite(action).all():
            answer_text = repr(answer)[:_MAX_TEXT]
            raise DriverError(
                f"the policy returned {answer_text}: steering and pedal, two finite numbers, are"
                " needed"
            )
        return Controls(*controls_of(action[0], action[1], self._setup))
