"""The fit of a twin's car to recorded motion, without the driver.

A drive's record has the controls that the driver chose. So the car is fitted alone: it starts with
the recorded motion, gets the recorded controls for a second, and is compared with the record. Such
a piece of a drive is a *window*. The steps of the fit are by Levenberg (1944) and Marquardt (1963).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
from frenetic.oracle.drive import Trajectory
from frenetic.plugins.twin.car_model import CarModel
from frenetic.simulators.embedded.rollout import STEP, STEPS_PER_PERIOD
from frenetic.simulators.embedded.single_track import (
    INPUT_SIZE,
    MOST_CARS,
    STATE_SIZE,
    advance,
)

# All values are our choice.
_WINDOW: Final = 20  # records of a window after the first one: 1 s
_STRIDE: Final = 10  # records between the starts of two windows
_MOST_WINDOWS: Final = 400  # that a fit compares
_LEAST_SPEED: Final = 3.0  # [m/s] at a window's start
_COMPARED: Final = (_WINDOW // 2, _WINDOW)  # records of a window that are compared
_SCALES: Final = np.array([0.5, 0.2, 0.05, 0.5])  # [m, m, rad, m/s] ahead, left, turned, faster
_SATURATION: Final = 1.5  # bound of a scaled difference, so that no window outweighs all others
_PRIOR: Final = 0.02  # weight of a parameter's distance from its start, which keeps it if unknown
_SLOPE_WIDTH: Final = 0.01  # of the finite differences, in unit values
_MOST_STEPS: Final = 20
_MAX_STEP: Final = 0.2  # of each parameter, in unit values
_DAMPINGS: Final = (1.0, 10.0, 100.0, 1e3, 1e4)  # factors that are tried for a step
_FIRST_DAMPING: Final = 0.01
_DAMPING_DECAY: Final = 0.25
_MIN_DAMPING: Final = 1e-5
_SMALL_GAIN: Final = 0.99  # ratio of new to old loss from which on a step gained little
_RIDGE: Final = 1e-6

Residuals: TypeAlias = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """The windows of one drive."""

    records: FloatArray
    """Records, (n, 11) in the order of a `Trajectory`; the velocities follow from the poses."""
    starts: IntArray
    """Index of each window's first record, (k,)."""
    demands: FloatArray
    """Largest lateral acceleration in each window, (k,) in m/s^2."""
    conditions: Mapping[str, float]
    """Parameter of the car -> value that the conditions of the drive gave it."""

    @classmethod
    def of(
        cls, trajectory: Trajectory, count: int, conditions: Mapping[str, float]
    ) -> RecordedMotion:
        """Return the windows in the first ``count`` records of a trajectory."""
        records = trajectory.to_rows()[:count].copy()
        if count > 1:
            _derive_velocities(records)
        starts = np.arange(0, max(count - _WINDOW, 0), _STRIDE)
        starts = starts[records[starts, 4] > _LEAST_SPEED]
        lateral = np.abs(records[:, 4] * records[:, 6])
        demands = np.array([lateral[k : k + _WINDOW].max() for k in starts.tolist()])
        return cls(records, starts, demands, conditions)

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.starts)


def _derive_velocities(records: FloatArray) -> None:
    """Replace speeds and yaw rate by those that follow from the poses, in place.

    Simulators disagree about the moment at which they measure velocities.
    """
    time, heading = records[:, 0], records[:, 3]
    east, north = np.gradient(records[:, 1], time), np.gradient(records[:, 2], time)
    cos_h, sin_h = np.cos(heading), np.sin(heading)
    records[:, 4] = cos_h * east + sin_h * north
    records[:, 5] = cos_h * north - sin_h * east
    records[:, 6] = np.gradient(heading, time)


@njit(error_model="numpy")
def compare_windows(
    records: FloatArray,
    starts: IntArray,
    count: int,
    p: FloatArray,
    differences: FloatArray,
) -> None:
    """Write how a car's motion differs from a record: ahead, left, turned and faster.

    Args:
        records: (n, 11) in the order of a `Trajectory`.
        starts: index of each window's first record, (k,).
        count: records of a window after the first one.
        p: `Vehicle.to_array()`.
        differences: (k, count, 4) in m, m, rad and m/s, which is written.
    """
    windows = len(starts)
    states, inputs = np.empty((windows, STATE_SIZE)), np.empty((windows, INPUT_SIZE))
    grounds, cars = np.empty((windows, len(p))), np.arange(windows)
    for k in range(windows):
        states[k] = records[starts[k], 1:8]
        grounds[k] = p
    for j in range(count):
        for k in range(windows):
            inputs[k] = records[starts[k] + j, 8:11]
        for first in range(0, windows, MOST_CARS):
            group = cars[first : first + MOST_CARS]
            advance(states, inputs, grounds, group, STEP, STEPS_PER_PERIOD)
        for k in range(windows):
            state, row = states[k], records[starts[k] + j + 1]
            east, north = state[0] - row[1], state[1] - row[2]
            cos_h, sin_h = math.cos(row[3]), math.sin(row[3])
            differences[k, j, 0] = cos_h * east + sin_h * north
            differences[k, j, 1] = cos_h * north - sin_h * east
            differences[k, j, 2] = state[2] - row[3]
            differences[k, j, 3] = state[3] - row[4]


def _chosen(motions: Sequence[RecordedMotion]) -> list[RecordedMotion]:
    """Return motions with at most `_MOST_WINDOWS` windows: half the most demanding, half spread."""
    total = sum(map(len, motions))
    if total <= _MOST_WINDOWS:
        return list(motions)
    demands = np.concatenate([motion.demands for motion in motions])
    is_chosen = np.zeros(total, dtype=bool)
    half = _MOST_WINDOWS // 2
    is_chosen[np.argsort(-demands, kind="stable")[:half]] = True
    rest = np.flatnonzero(~is_chosen)
    is_chosen[rest[np.linspace(0, len(rest) - 1, half).astype(int)]] = True
    chosen, first = [], 0
    for motion in motions:
        part = is_chosen[first : first + len(motion)]
        chosen.append(replace(motion, starts=motion.starts[part], demands=motion.demands[part]))
        first += len(motion)
    return chosen


def residuals_of(
    model: CarModel, unit_values: FloatArray, motions: Sequence[RecordedMotion]
) -> FloatArray:
    """Return the bounded differences of a car from recorded motions, whose squares sum to the loss.

    Args:
        model: the car's model.
        unit_values: unit values of the car's parameters, (p,).
        motions: recorded motions.
    """
    parts = []
    for motion in motions:
        differences = np.empty((len(motion), _WINDOW, len(_SCALES)))
        p = model.car(unit_values, motion.conditions).to_array()
        compare_windows(motion.records, motion.starts, _WINDOW, p, differences)
        parts.append(differences[:, [record - 1 for record in _COMPARED]])
    scaled = np.concatenate(parts) / _SCALES
    bounded = _SATURATION * np.tanh(np.nan_to_num(scaled, nan=math.inf) / _SATURATION)
    residuals: FloatArray = bounded.ravel() / math.sqrt(len(bounded))
    return residuals


def fit_car(model: CarModel, start: FloatArray, motions: Sequence[RecordedMotion]) -> FloatArray:
    """Return the unit values of the car's parameters that follow recorded motions best.

    Args:
        model: the car's model, whose start draws parameters that the motions do not determine.
        start: unit values with which the fit begins, (p,).
        motions: recorded motions.
    """
    chosen = [motion for motion in _chosen(motions) if len(motion)]
    if not chosen:
        return start
    usual = model.start_values

    def residuals(unit_values: FloatArray) -> FloatArray:
        windows = residuals_of(model, unit_values, chosen)
        return np.concatenate([windows, _PRIOR * (unit_values - usual)])

    return _descend(residuals, start)


def _descend(residuals: Residuals, start: FloatArray) -> FloatArray:
    """Return the unit values after steps that each lower the sum of squared residuals."""
    values, present, damping, small_gains = start, residuals(start), _FIRST_DAMPING, 0
    for _ in range(_MOST_STEPS):
        slopes = _slopes(residuals, values, present)
        normal, gradient = slopes.T @ slopes, slopes.T @ present
        loss = float(present @ present)
        for factor in _DAMPINGS:
            damped = normal + factor * damping * np.diag(np.diag(normal) + _RIDGE)
            step = np.clip(np.linalg.solve(damped, -gradient), -_MAX_STEP, _MAX_STEP)
            moved = np.clip(values + step, 0.0, 1.0)
            trial = residuals(moved)
            if float(trial @ trial) < loss:
                break
        else:
            return values
        values, present = moved, trial
        damping = max(_DAMPING_DECAY * factor * damping, _MIN_DAMPING)
        small_gains = small_gains + 1 if float(trial @ trial) > _SMALL_GAIN * loss else 0
        if small_gains == 2:
            break
    return values


def _slopes(residuals: Residuals, values: FloatArray, present: FloatArray) -> FloatArray:
    """Return the slopes of residuals by the unit values, (m, p), by finite differences."""
    slopes = np.empty((len(present), len(values)))
    for k, value in enumerate(values.tolist()):
        width = _SLOPE_WIDTH if value < 0.5 else -_SLOPE_WIDTH
        moved = values.copy()
        moved[k] += width
        slopes[:, k] = (residuals(moved) - present) / width
    return slopes
