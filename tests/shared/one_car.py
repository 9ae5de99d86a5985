"""One car of the embedded simulator, moved by the kernels that move many."""

from __future__ import annotations

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road import Road
from frenetic.simulators.embedded import single_track
from frenetic.simulators.embedded.rollout import PERIOD, STEP, STEPS_PER_PERIOD, ground_under

_ONLY_CAR = np.zeros(1, np.int64)


def advance(
    state: FloatArray,
    steering: float,
    throttle: float,
    brake: float,
    parameters: FloatArray,
    dt: float,
    steps: int = 1,
) -> None:
    """Move a car by some steps of ``dt`` s; its state, (7,), is changed in place."""
    inputs = np.array([[steering, throttle, brake]])
    single_track.advance(state[np.newaxis], inputs, parameters[np.newaxis], _ONLY_CAR, dt, steps)


def advance_period(
    state: FloatArray,
    controls: tuple[float, float, float],
    parameters: FloatArray,
    road: Road,
    s: float,
) -> float:
    """Move a car on a road with slopes by a control period; return where it was, in m."""
    ground, s = ground_under(
        parameters, road.table, road.sub_step, road.slopes, None, state, s, PERIOD
    )
    advance(state, *controls, ground, STEP, STEPS_PER_PERIOD)
    return s
