"""The fit of a twin's parameters to recorded drives.

A fit takes steps by Levenberg (1944) and Marquardt (1963) that lower the squared differences of
lateral offset and speed along the roads. A car that slides makes the differences erratic. A fit
therefore goes through stages: it starts with the parts of the drives that keep to the lane's
middle, and takes slopes between values that lie far apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import driving
from frenetic.drivers.driver import Driver
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive, Rules
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.recorded_drive import RecordedDrive, states_of, thinned
from frenetic.road import Road
from frenetic.simulators.conditions import in_conditions
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True, kw_only=True)
class _FitStage:
    """A stage of a fit."""

    max_offset: float
    """Offset from which on drives are cut off, in m."""
    drives: int
    """Number of drives that are compared, as `thinned` takes it."""
    steps: int
    """Largest number of steps."""
    slope_width: float
    """First distance of the unit values between which slopes are taken."""


# All values are our choice.
_STAGES: Final = (
    _FitStage(max_offset=0.7, drives=20, steps=6, slope_width=0.08),
    _FitStage(max_offset=1.2, drives=20, steps=6, slope_width=0.04),
    _FitStage(max_offset=2.0, drives=40, steps=8, slope_width=0.02),
)
_SMALL_GAIN: Final = 0.8  # ratio of new to old loss from which on a step gained little
_GAIN_SHRINK: Final = 0.5  # factor of the slopes' width after a step that gained little
_FAILURE_SHRINK: Final = 0.4  # factor of the slopes' width where no step lowers the loss
_MIN_SLOPE_WIDTH: Final = 0.004  # [unit values]
_FIRST_DAMPING: Final = 0.01
_MIN_DAMPING: Final = 1e-4
_DAMPING_FACTORS: Final = (1.0, 10.0, 100.0)  # that are tried for a step, in this order
_DAMPING_DECAY: Final = 0.25  # factor of the damping after a step
_RIDGE: Final = 1e-4  # added to the normal matrix: parameters without effect leave it solvable
_MAX_STEP: Final = 0.2  # of each parameter, in unit values
_SCALES: Final = np.array([[1.0], [2.0]])  # [m; m/s] differences of offset, speed that weigh alike
_SATURATION: Final = 2.0  # bound of a scaled difference, so that no position outweighs all others


def drive_twin(
    simulator: Simulator, driver: Driver, road: Road, conditions: Mapping[str, int | float]
) -> Drive:
    """Return the twin's drive in conditions."""
    with in_conditions(conditions, simulator, driver) as changed:
        return simulator.drive(road, changed)


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Unit values of the parameters, and how the twin that has them drives."""

    unit_values: FloatArray
    """Each parameter's value, 0..1 between its bounds, (p,)."""
    residuals: FloatArray
    """Residuals of all drives, (m,), as `joined` returns them."""

    @cached_property
    def loss(self) -> float:
        """Mean of the drives' losses: 0 if the twin drives as they were driven."""
        return float(self.residuals @ self.residuals)


@dataclass(frozen=True)
class Fit:
    """The fit of a model whose drives follow some rules.

    A *unit value* is the position 0..1 of a parameter's value between its bounds, see
    `frenetic.plugins.twin.model.Parameter.value_at`.
    """

    model: TwinModel
    rules: Rules

    def parts(self, unit_values: FloatArray) -> tuple[Driver, EmbeddedSimulator]:
        """Return the driver and simulator with these unit values of the parameters.

        Raises:
            FreneticError: the driver refuses its values.
            ValueError: the car refuses its values.
        """
        return self.model.make(self.model.values(unit_values.tolist()), self.rules)

    def drive_all(
        self, unit_values: FloatArray, drives: Iterable[RecordedDrive]
    ) -> Iterator[tuple[RecordedDrive, Drive]]:
        """Yield each recorded drive with the twin's drive in its conditions.

        Raises:
            FreneticError: the driver refuses its values.
            ValueError: the car refuses its values.
        """
        driver, simulator = self.parts(unit_values)
        with driving(RoadTester(simulator, driver), isolate=True) as drive:
            for recorded in drives:
                yield recorded, drive(recorded.road, recorded.conditions)

    def residuals_by_drive(
        self, unit_values: FloatArray, drives: Sequence[RecordedDrive]
    ) -> list[FloatArray]:
        """Return the weighted differences from each drive, whose squares add up to its loss.

        Raises:
            FreneticError: the driver refuses its values, or it broke.
            ValueError: the car refuses its values.
        """
        residuals = []
        for recorded, drive in self.drive_all(unit_values, drives):
            if drive.trouble is not None:
                raise FreneticError(f"the driver broke: {drive.trouble.reason}")
            states = states_of(drive, assess(recorded.road, drive, has_shares=False))
            residuals.append(_residuals_of(states, recorded))
        return residuals

    def try_residuals(
        self, unit_values: FloatArray, drives: Sequence[RecordedDrive]
    ) -> list[FloatArray] | None:
        """Return the `residuals_by_drive`; None if there is no such twin, or its driver broke."""
        try:
            return self.residuals_by_drive(unit_values, drives)
        except (FreneticError, ValueError):
            return None

    def run(self, start: FloatArray, drives: Sequence[RecordedDrive]) -> tuple[float, FloatArray]:
        """Return the loss and the unit values that a fit reaches from the unit values of a start.

        The last stage's drives give the loss; it is infinite if there is no twin at its start.
        """
        loss, unit_values = math.inf, start
        for stage in _STAGES:
            cut = [drive.until(stage.max_offset) for drive in thinned(drives, stage.drives)]
            loss, unit_values = self._descend(unit_values, cut, stage)
        return loss, unit_values

    def _descend(
        self, start: FloatArray, drives: Sequence[RecordedDrive], stage: _FitStage
    ) -> tuple[float, FloatArray]:
        """Return loss and unit values after a stage's steps from a start, none of them upwards."""
        point = self._point(start, drives)
        if point is None:
            return math.inf, start
        damping, width = _FIRST_DAMPING, stage.slope_width
        for _ in range(stage.steps):
            slopes = self.slopes(point, drives, width)
            lower, damping_taken = self._lower_point(point, slopes, drives, damping)
            if lower is None:  # slopes over a shorter width may lead to one
                width *= _FAILURE_SHRINK
                if width < _MIN_SLOPE_WIDTH:
                    break
                continue
            if lower.loss > _SMALL_GAIN * point.loss:
                width = max(_GAIN_SHRINK * width, _MIN_SLOPE_WIDTH)
            point, damping = lower, max(_DAMPING_DECAY * damping_taken, _MIN_DAMPING)
        return point.loss, point.unit_values

    def _lower_point(
        self,
        point: FitPoint,
        slopes: FloatArray,
        drives: Sequence[RecordedDrive],
        damping: float,
    ) -> tuple[FitPoint | None, float]:
        """Return the first point of lower loss, and its damping; None if no damping leads to one.

        Marquardt's damping scales with the diagonal of the normal matrix.
        """
        normal = normal_matrix(slopes)
        for factor in _DAMPING_FACTORS:
            damped = normal + factor * damping * np.diag(np.diag(normal))
            step = np.linalg.solve(damped, -slopes.T @ point.residuals)
            moved = point.unit_values + np.clip(step, -_MAX_STEP, _MAX_STEP)
            trial = self._point(np.clip(moved, 0.0, 1.0), drives)
            if trial is not None and trial.loss < point.loss:
                return trial, factor * damping
        return None, damping

    def slopes(self, point: FitPoint, drives: Sequence[RecordedDrive], width: float) -> FloatArray:
        """Return the slopes of the residuals by the unit values, (m, p).

        A slope is a finite difference: the unit value moves by ``width`` towards the middle of its
        bounds. The slope is 0 if the moved value has no twin; then a step leaves this parameter as
        it is.
        """
        unit_values = point.unit_values
        slopes = np.zeros((len(point.residuals), len(unit_values)))
        for k in range(len(unit_values)):
            moved = unit_values.copy()
            moved[k] += width if unit_values[k] < 0.5 else -width
            moved_point = self._point(moved, drives)
            if moved_point is not None:
                change = moved_point.residuals - point.residuals
                slopes[:, k] = change / (moved[k] - unit_values[k])
        return slopes

    def _point(self, unit_values: FloatArray, drives: Sequence[RecordedDrive]) -> FitPoint | None:
        """Return the point at these unit values; None if there is no such twin, or it broke."""
        residuals = self.try_residuals(unit_values, drives)
        return None if residuals is None else FitPoint(unit_values, joined(residuals))


def _residuals_of(states: FloatArray, recorded: RecordedDrive) -> FloatArray:
    """Return the weighted differences of a twin's states from a recorded drive, (2 n,).

    A scaled difference d counts as L tanh(d / L), with L = `_SATURATION`. At positions that the
    twin did not reach, a difference of offset counts as L with the sign of the twin's last offset,
    and a difference of speed as L.

    Args:
        states: offset and speed of the twin at its positions, (2, k).
        recorded: the recorded drive, known at n positions.
    """
    n = recorded.states.shape[1]
    both = min(n, states.shape[1])
    bounded = np.full((2, n), _SATURATION)
    bounded[0] *= np.sign(states[0, both - 1])
    scaled = (states[:, :both] - recorded.states[:, :both]) / _SCALES
    bounded[:, :both] = _SATURATION * np.tanh(scaled / _SATURATION)
    residuals: FloatArray = (bounded * recorded.weight_roots).ravel()
    return residuals


def normal_matrix(slopes: FloatArray) -> FloatArray:
    """Return the matrix of the normal equations of slopes, (m, p), with a small ridge, (p, p)."""
    normal: FloatArray = slopes.T @ slopes + _RIDGE * np.eye(slopes.shape[1])
    return normal


def joined(residuals_by_drive: Sequence[FloatArray]) -> FloatArray:
    """Return the residuals of all drives, (m,), whose squares add up to the drives' mean loss."""
    residuals: FloatArray = np.concatenate(residuals_by_drive) / math.sqrt(len(residuals_by_drive))
    return residuals
