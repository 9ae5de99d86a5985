"""The fit of a twin's parameters to recorded drives.

A fit takes steps by Levenberg (1944) and Marquardt (1963) that lower the squared differences of
lateral offset and speed along the roads. A car that slides makes the differences erratic. A fit
therefore goes through three stages. The first compares each drive only until the car is 0.7 m
from the lane's middle, and takes slopes over wide differences of the values. The second and third
follow the car further out, over narrower differences, and the third compares more drives.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
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
from frenetic.simulators.embedded import EmbeddedSimulator


@dataclass(frozen=True, kw_only=True)
class _FitStage:
    """A stage of a fit."""

    max_offset: float
    """Offset from the lane's middle at which recorded drives are cut off, in m."""
    drive_count: int
    """Least number of drives to compare, if there are as many; at most nearly twice as many."""
    max_steps: int
    """Largest number of tries of a step, also of those that only narrow the differences."""
    slope_width: float
    """Width of the finite differences at the stage's start, in unit values."""


# All values are our choice.
_STAGES: Final = (
    _FitStage(max_offset=0.7, drive_count=20, max_steps=6, slope_width=0.08),
    _FitStage(max_offset=1.2, drive_count=20, max_steps=6, slope_width=0.04),
    _FitStage(max_offset=2.0, drive_count=40, max_steps=8, slope_width=0.02),
)
_SMALL_GAIN: Final = 0.8  # ratio of new to old loss from which on a step gained little
_GAIN_SHRINK: Final = 0.5  # factor of the differences' width after a step that gained little
_FAILURE_SHRINK: Final = 0.4  # factor of the differences' width where no step lowers the loss
_MIN_SLOPE_WIDTH: Final = 0.004  # [unit values]
_FIRST_DAMPING: Final = 0.01
_MIN_DAMPING: Final = 1e-4
_DAMPING_FACTORS: Final = (1.0, 10.0, 100.0)  # that are tried for a step, in this order
_DAMPING_DECAY: Final = 0.25  # factor of the damping after a step
_RIDGE: Final = 1e-4  # added to the normal matrix: parameters without effect leave it solvable
_MAX_STEP: Final = 0.2  # of each parameter, in unit values
_SCALES: Final = np.array([[1.0], [2.0]])  # [m; m/s] differences of offset, speed that weigh alike
_SATURATION: Final = 2.0  # bound of a scaled difference, so that no position outweighs all others


class UnusableValuesError(FreneticError):
    """Values that driver or car refuse, or with which the driver breaks: no twin has them."""


@dataclass(frozen=True, eq=False)
class FitPoint:
    """Unit values of the parameters, and how the twin that has them drives."""

    unit_values: FloatArray
    """Each parameter's value, 0..1 between its bounds, (p,)."""
    residuals: FloatArray
    """Residuals of all drives, (m,), as `joined` returns them."""

    @cached_property
    def loss(self) -> float:
        """Mean of the drives' losses: 0 if the twin drives exactly as recorded."""
        return float(self.residuals @ self.residuals)


@dataclass(frozen=True)
class Fitter:
    """Fits a model's parameters to recorded drives.

    A *unit value* is the position 0..1 of a parameter's value between its bounds, see
    `frenetic.plugins.twin.model.Parameter.value_at`.
    """

    model: TwinModel
    rules: Rules
    """Rules of the recorded drives, which the twin's drives follow, too."""

    def parts(self, unit_values: FloatArray) -> tuple[Driver, EmbeddedSimulator]:
        """Return the driver and simulator with these unit values of the parameters.

        Raises:
            UnusableValuesError: driver or car refuse the values.
        """
        try:
            return self.model.make(self.model.values(unit_values.tolist()), self.rules)
        except (FreneticError, ValueError) as error:
            raise UnusableValuesError(str(error)) from error

    def drive_all(
        self, unit_values: FloatArray, recorded_drives: Iterable[RecordedDrive]
    ) -> Iterator[tuple[RecordedDrive, Drive]]:
        """Yield each recorded drive with the twin's drive in its conditions.

        Raises:
            UnusableValuesError: driver or car refuse the values.
            CampaignError: the simulator does not start in another process.
        """
        driver, simulator = self.parts(unit_values)
        with driving(RoadTester(simulator, driver), isolate=True) as drive_road:
            for recorded in recorded_drives:
                yield recorded, drive_road(recorded.road, recorded.conditions)

    def residuals_by_drive(
        self, unit_values: FloatArray, recorded_drives: Sequence[RecordedDrive]
    ) -> list[FloatArray]:
        """Return the weighted differences from each drive, whose squares add up to its loss.

        Raises:
            UnusableValuesError: driver or car refuse the values, or the driver broke.
            CampaignError: the simulator does not start in another process.
        """
        residuals = []
        for recorded, twin_drive in self.drive_all(unit_values, recorded_drives):
            if twin_drive.trouble is not None:
                raise UnusableValuesError(f"the driver broke: {twin_drive.trouble.reason}")
            # Only offset and speed are compared, so the oob shares, which take time, are left out.
            assessment = assess(recorded.road, twin_drive, has_all_shares=False)
            states = states_of(twin_drive, assessment)
            residuals.append(residuals_from(recorded, states))
        return residuals

    def try_residuals(
        self, unit_values: FloatArray, recorded_drives: Sequence[RecordedDrive]
    ) -> list[FloatArray] | None:
        """Return the `residuals_by_drive`; None for values that are refused or break the driver.

        Raises:
            CampaignError: the simulator does not start in another process.
        """
        try:
            return self.residuals_by_drive(unit_values, recorded_drives)
        except UnusableValuesError:
            return None

    def fit(
        self, start: FloatArray, recorded_drives: Sequence[RecordedDrive]
    ) -> tuple[float, FloatArray]:
        """Return the loss and the unit values that a fit reaches from unit values at its start.

        The last stage's drives give the loss. It is infinite if the values with which the last
        stage starts are refused by driver or car, or break the driver.
        """
        loss, unit_values = math.inf, start
        for stage in _STAGES:
            compared = thinned(recorded_drives, stage.drive_count)
            cut_drives = [recorded.until(stage.max_offset) for recorded in compared]
            loss, unit_values = self._descend(unit_values, cut_drives, stage)
        return loss, unit_values

    def _descend(
        self, start: FloatArray, recorded_drives: Sequence[RecordedDrive], stage: _FitStage
    ) -> tuple[float, FloatArray]:
        """Return loss and unit values after a stage's steps, none of which raises the loss."""
        point = self._point(start, recorded_drives)
        if point is None:
            return math.inf, start
        damping, width = _FIRST_DAMPING, stage.slope_width
        for _ in range(stage.max_steps):
            slopes = self.slopes(point, recorded_drives, width)
            lower_point, damping_taken = self._lower_point(point, slopes, recorded_drives, damping)
            if lower_point is None:  # narrower differences may lead to one
                width *= _FAILURE_SHRINK
                if width < _MIN_SLOPE_WIDTH:
                    break
                continue
            if lower_point.loss > _SMALL_GAIN * point.loss:
                width = max(_GAIN_SHRINK * width, _MIN_SLOPE_WIDTH)
            point = lower_point
            damping = max(_DAMPING_DECAY * damping_taken, _MIN_DAMPING)
        return point.loss, point.unit_values

    def _lower_point(
        self,
        point: FitPoint,
        slopes: FloatArray,
        recorded_drives: Sequence[RecordedDrive],
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
            trial = self._point(np.clip(moved, 0.0, 1.0), recorded_drives)
            if trial is not None and trial.loss < point.loss:
                return trial, factor * damping
        return None, damping

    def slopes(
        self, point: FitPoint, recorded_drives: Sequence[RecordedDrive], width: float
    ) -> FloatArray:
        """Return the slopes of the residuals by the unit values, (m, p).

        A slope is a finite difference: the unit value moves by ``width`` towards the middle of its
        bounds. The slope is 0 if the moved value is refused or breaks the driver; then a step
        leaves this parameter as it is.
        """
        unit_values = point.unit_values
        slopes = np.zeros((len(point.residuals), len(unit_values)))
        for k in range(len(unit_values)):
            moved = unit_values.copy()
            moved[k] += width if unit_values[k] < 0.5 else -width
            moved_point = self._point(moved, recorded_drives)
            if moved_point is not None:
                change = moved_point.residuals - point.residuals
                slopes[:, k] = change / (moved[k] - unit_values[k])
        return slopes

    def _point(
        self, unit_values: FloatArray, recorded_drives: Sequence[RecordedDrive]
    ) -> FitPoint | None:
        """Return the point at these unit values; None if they are refused or break the driver."""
        residuals = self.try_residuals(unit_values, recorded_drives)
        return None if residuals is None else FitPoint(unit_values, joined(residuals))


def residuals_from(recorded: RecordedDrive, states: FloatArray) -> FloatArray:
    """Return the weighted differences of a twin's states from a recorded drive, (2 n,).

    A scaled difference d counts as L tanh(d / L), with L = `_SATURATION`. At positions that the
    twin did not reach, a difference of offset counts as L with the sign of the twin's last offset,
    and a difference of speed as L.

    Args:
        recorded: the recorded drive, known at n positions.
        states: offset and speed of the twin at its positions, (2, k).
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
