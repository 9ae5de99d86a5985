"""Policies as drivers: an observation as a vector of -1..1, and controls from an action of -1..1.

The environment of `frenetic.plugins.gym` trains on this vector and these actions; `PolicyDriver`
drives with them in any simulator. Both call the same kernels, so a policy drives alike in both.
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
from frenetic.drivers.laws import LANE_WIDTH, MAX_STEERING, SPEED_LIMIT, setup_array
from frenetic.errors import DriverError

MAX_SPEED: Final = 40.0
"""Speed that stands as 1 in the vector, in m/s."""
MAX_YAW_RATE: Final = 2.0
"""Yaw rate that stands as 1, in rad/s."""
MAX_HEADING_ERROR: Final = 0.5
"""Heading error that stands as 1, in rad."""
MAX_CURVATURE: Final = 0.1
"""Curvature that stands as 1, in 1/m; valid roads have at most 0.07."""
STEERING_RANGE: Final = 0.5
"""Angle of the front wheels that a steering of 1 asks for, in rad; less if the car's limit is."""
POINTS_APART: Final = 2
"""Points of the view between two curvatures of the vector: 4 m."""
CURVATURES: Final = AHEAD_POINTS // POINTS_APART
"""Curvatures in the vector: 76 m."""
VECTOR_SIZE: Final = 6 + CURVATURES
"""Length of the vector."""
ACTION_SIZE: Final = 2
"""Length of an action: steering, then throttle (above 0) or brake (below)."""


@njit()
def _share(value: float, most: float) -> float:
    return min(max(value / most, -1.0), 1.0)


@njit()
def write_vector(
    speed: float,
    yaw_rate: float,
    steering: float,
    lateral_offset: float,
    heading_error: float,
    curvature_ahead: FloatArray,
    rows: int,
    setup: FloatArray,
    limit: float,
    out: npt.NDArray[np.float32],
) -> None:
    """Write the vector of an observation to ``out``, (VECTOR_SIZE,).

    Args:
        speed, yaw_rate, steering, lateral_offset, heading_error, curvature_ahead: as in an
            `Observation`.
        rows: points of the driver's view; beyond them the vector says straight ahead.
        setup: `setup_array`.
        limit: m/s, the speed limit where the car is.
        out: written to.
    """
    out[0] = _share(speed, MAX_SPEED)
    out[1] = _share(limit - speed, MAX_SPEED)
    out[2] = _share(yaw_rate, MAX_YAW_RATE)
    out[3] = _share(steering, min(STEERING_RANGE, setup[MAX_STEERING]))
    out[4] = _share(lateral_offset, setup[LANE_WIDTH])
    out[5] = _share(heading_error, MAX_HEADING_ERROR)
    for j in range(CURVATURES):
        row = j * POINTS_APART
        out[6 + j] = _share(curvature_ahead[row], MAX_CURVATURE) if row < rows else 0.0


@njit()
def controls_of(steering: float, pedal: float, setup: FloatArray) -> tuple[float, float, float]:
    """(steering [rad], throttle, brake) of an action, whose values are cut to -1..1."""
    steering = min(max(steering, -1.0), 1.0)
    pedal = min(max(pedal, -1.0), 1.0)
    angle = steering * min(STEERING_RANGE, setup[MAX_STEERING])
    return angle, max(pedal, 0.0), max(-pedal, 0.0)


def vector_of(observation: Observation, setup: FloatArray) -> npt.NDArray[np.float32]:
    """Return the vector of an observation, (VECTOR_SIZE,); ``setup`` is `setup_array`."""
    o = observation
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
        float(o.speed_limit if math.isfinite(o.speed_limit) else setup[SPEED_LIMIT]),
        vector,
    )
    return vector


class PolicyDriver:
    """A driver that asks a policy, such as one that was trained in `frenetic.plugins.gym`.

    Args:
        policy: a function from a vector, (26,) float32 in -1..1, to an action, (2,): steering, then
            throttle (above 0) or brake (below), in -1..1. It remembers nothing: the same vector
            gives the same action. `write_vector` says what the vector holds.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when the same policy gets other controls; campaigns record it."""

    def __init__(self, policy: Callable[[npt.NDArray[np.float32]], npt.ArrayLike]) -> None:
        self.policy = policy

    def reset(self, setup: DriveSetup) -> None:
        """Prepares for the next drive."""
        self._setup = setup_array(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the controls of the policy's action.

        Raises:
            DriverError: the action is not two finite numbers.
        """
        action = np.asarray(self.policy(vector_of(observation, self._setup)), dtype=np.float64)
        if action.shape != (ACTION_SIZE,) or not np.isfinite(action).all():
            raise DriverError(
                f"the policy returned {repr(action)[:80]}: steering and pedal, two finite numbers,"
                " are needed"
            )
        return Controls(*controls_of(action[0], action[1], self._setup))
