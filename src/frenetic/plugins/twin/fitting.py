"""The fit of a twin to drives: its parameters, and what the drives leave open.

A fit takes Levenberg's and Marquardt's steps towards the least differences of lateral offset and
speed along the roads. A car that slides makes them wild, so it begins with the parts of the drives
that keep to the lane's middle, and slopes are first taken over long ways.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers import driving
from frenetic.drivers.driver import Driver
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Drive, Rules
from frenetic.oracle.verdict import Assessment, assess
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import Fitted
from frenetic.road import Road
from frenetic.simulators.conditions import in_conditions
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.simulator import Simulator

IntArray: TypeAlias = npt.NDArray[np.int64]

GRID: Final = 2.0
"""Distance along the road between two places where drives are compared, in m."""
LEAST: Final = 4
"""Places of a drive that are compared, at least."""

_STAGES: Final = ((0.7, 20, 6, 0.08), (1.2, 20, 6, 0.04), (2.0, 40, 8, 0.02))
"""Of a fit: offset in m up to which drives are compared, number of drives, steps, first distance
of the places between which slopes are taken."""
_LITTLE: Final = 0.8  # of the loss before, above which slopes are taken over shorter ways
_SHORTER: Final = 0.4  # times the way, where no step is downwards
_SHORTEST: Final = 0.004
_DAMPING, _LEAST_DAMPING, _RIDGE = 0.01, 1e-4, 1e-4
_LONGEST: Final = 0.2  # step
_BEFORE: Final = 15  # places before the worst one that count as much as all together
_WORST: Final = 2.0  # difference in a place
_SPREADS: Final = np.array([[1.0], [2.0]])  # [m, m/s] of offset and speed that count as much

_LIMIT: Final = 1.96  # standard errors of a difference in loss up to which values are as good
_WIDE: Final = 0.5  # share of the bounds' distance from which on a parameter is not determined
_ALONE: Final = np.array([0.01, 0.03, 0.1, 0.3])  # steps by which a parameter is tried beside it
_EDGE: Final = 0.02  # least distance from a bound of a value that is not at the bound
_TRIED: Final = 100  # drives on which values are tried beside the best ones, about
_FEW_RUNS: Final = 5  # below which roads, in place of runs, count as independent


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedDrive:
    """A drive that a twin is to follow."""

    road: Road
    states: FloatArray
    """Offsets left of the ego lane's centre in m and speeds in m/s every `GRID`, (2, n)."""
    conditions: Mapping[str, int | float] = field(default_factory=dict)
    failed: bool = False
    run: str = ""
    """Name of the run that drove it, such as one campaign."""

    def until(self, offset: float) -> RecordedDrive:
        """Return the drive up to the first place with a larger offset, in m."""
        out = np.flatnonzero(np.abs(self.states[0]) > offset)
        end = max(int(out[0]) + 1, LEAST) if len(out) else None
        return replace(self, states=self.states[:, :end])

    @cached_property
    def weights(self) -> FloatArray:
        """Weights of the places, (n,): half of all lies on the way to the largest offset."""
        n = self.states.shape[1]
        worst = int(np.argmax(np.abs(self.states[0]))) + 1
        shares = np.full(n, 1.0 / n)
        shares[max(worst - _BEFORE, 0) : worst] += 1.0 / min(worst, _BEFORE)
        weights: FloatArray = np.sqrt(0.25 * shares)
        return weights


def on_grid(distance: FloatArray, offset: FloatArray, speed: FloatArray) -> FloatArray:
    """Return offset and speed every `GRID` m from the road's start, (2, n)."""
    ahead = np.maximum.accumulate(distance)
    keep = np.concatenate(([True], np.diff(ahead) > 0.0))
    places = GRID * np.arange(math.floor(ahead[-1] / GRID) + 1)
    return np.array([np.interp(places, ahead[keep], column[keep]) for column in (offset, speed)])


def states_of(drive: Drive, assessment: Assessment) -> FloatArray:
    """Return offset and speed every `GRID` m of a drive that was assessed, (2, n)."""
    return on_grid(
        assessment.distance,
        assessment.lateral_offset,
        drive.trajectory.speed[: len(assessment.distance)],
    )


def drive_twin(
    simulator: Simulator, driver: Driver, road: Road, conditions: Mapping[str, int | float]
) -> Drive:
    """Return the twin's drive in conditions."""
    with in_conditions(conditions, simulator, driver) as changed:
        return simulator.drive(road, changed)


@dataclass(frozen=True)
class Fit:
    """The fit of a model by some rules; places of its parameters are 0..1 between their bounds."""

    model: TwinModel
    rules: Rules

    def parts(self, places: FloatArray) -> tuple[Driver, EmbeddedSimulator]:
        """Return driver and simulator at places.

        Raises:
            FreneticError: there is no such driver.
            ValueError: there is no such car.
        """
        return self.model.make(self.model.values(places.tolist()), self.rules)

    def drives(
        self, places: FloatArray, drives: Iterable[RecordedDrive]
    ) -> Iterator[tuple[RecordedDrive, Drive]]:
        """Yield each drive with the twin's, in its conditions; raises as `parts` does."""
        driver, simulator = self.parts(places)
        with driving(RoadTester(simulator, driver), isolate=True) as drive:
            for recorded in drives:
                yield recorded, drive(recorded.road, recorded.conditions)

    def differences(self, places: FloatArray, drives: Sequence[RecordedDrive]) -> list[FloatArray]:
        """Return the weighted differences from each drive, whose squares add up to its loss.

        Raises:
            FreneticError: there is no such driver, or it broke.
            ValueError: there is no such car.
        """
        differences = []
        for recorded, drive in self.drives(places, drives):
            if drive.trouble is not None:
                raise FreneticError(f"the driver broke: {drive.trouble.reason}")
            states = states_of(drive, assess(recorded.road, drive, has_shares=False))
            m = recorded.states.shape[1]
            k = min(m, states.shape[1])
            away = np.full((2, m), _WORST)  # where the twin did not come
            away[0] *= np.sign(states[0, k - 1])
            apart = (states[:, :k] - recorded.states[:, :k]) / _SPREADS
            away[:, :k] = _WORST * np.tanh(apart / _WORST)
            differences.append((away * recorded.weights).ravel())
        return differences

    def fitted(
        self, places: FloatArray, drives: Sequence[RecordedDrive]
    ) -> tuple[float, FloatArray]:
        """Return loss and places after a fit that begins at these places."""
        loss = math.inf
        for offset, count, steps, apart in _STAGES:
            some = [drive.until(offset) for drive in drives[:: max(len(drives) // count, 1)]]
            loss, places = self._descended(places, some, steps, apart)
        return loss, places

    def _descended(
        self, x: FloatArray, drives: Sequence[RecordedDrive], steps: int, apart: float
    ) -> tuple[float, FloatArray]:
        """Return loss and places after some steps; the first slopes span a distance ``apart``."""
        residuals = self._residuals(x, drives)
        if residuals is None:
            return math.inf, x
        loss, damping = float(residuals @ residuals), _DAMPING
        for _ in range(steps):
            slopes = self._slopes(x, residuals, drives, apart)
            normal = slopes.T @ slopes + _RIDGE * np.eye(len(x))
            for more in (1.0, 10.0, 100.0):
                damped = normal + more * damping * np.diag(np.diag(normal))
                step = np.linalg.solve(damped, -slopes.T @ residuals)
                tried = np.clip(x + np.clip(step, -_LONGEST, _LONGEST), 0.0, 1.0)
                other = self._residuals(tried, drives)
                if other is not None and (lower := float(other @ other)) < loss:
                    break
            else:
                apart *= _SHORTER
                if apart < _SHORTEST:
                    break
                continue
            if lower > _LITTLE * loss:
                apart = max(0.5 * apart, _SHORTEST)
            x, residuals, loss = tried, other, lower
            damping = max(0.25 * more * damping, _LEAST_DAMPING)
        return loss, x

    def _slopes(
        self, x: FloatArray, residuals: FloatArray, drives: Sequence[RecordedDrive], apart: float
    ) -> FloatArray:
        slopes = np.zeros((len(residuals), len(x)))
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += apart if x[k] < 0.5 else -apart
            other = self._residuals(moved, drives)
            if other is not None:
                slopes[:, k] = (other - residuals) / (moved[k] - x[k])
        return slopes

    def _residuals(self, places: FloatArray, drives: Sequence[RecordedDrive]) -> FloatArray | None:
        """Return the residuals of all drives, (m,), whose square is the loss, or None."""
        differences = self._tried(places, drives)
        return None if differences is None else _residuals(differences)

    def _tried(
        self, places: FloatArray, drives: Sequence[RecordedDrive]
    ) -> list[FloatArray] | None:
        """Return the `differences`, or None without a twin."""
        try:
            return self.differences(places, drives)
        except (FreneticError, ValueError):
            return None

    def intervals(
        self, best: FloatArray, drives: Sequence[RecordedDrive], others: Sequence[FloatArray]
    ) -> list[Fitted]:
        """Return what the drives say about each parameter.

        A value explains them as well as the best one if the loss with it is larger by no more than
        `_LIMIT` standard errors of that difference, over runs (over roads where there are few):
        alone, or with the other parameters where their slopes say that they make up for it. Values
        as good, and the values of other fits, are the interval, widened to the next one that was
        worse: what lies between was not driven. A parameter is determined if the interval is less
        than half as wide as its bounds and ends at neither of them: beyond a bound, values may be
        as good.

        Args:
            best: places that were fitted to the drives.
            drives: the recorded drives.
            others: places that were fitted to parts of the drives.
        """
        some = drives[:: max(len(drives) // _TRIED, 1)]
        labels = group_labels(some)
        differences = self.differences(best, some)
        least = _losses(differences)
        slopes = self._slopes(best, _residuals(differences), some, _EDGE)
        normal = slopes.T @ slopes + _RIDGE * np.eye(len(best))

        def is_as_good(places: FloatArray) -> bool:
            tried = self._tried(places, some)
            if tried is None:
                return False
            mean, error = difference(_losses(tried), least, labels)
            return mean <= _LIMIT * error

        fitted = []
        for k, parameter in enumerate(self.model.parameters):
            fitted_place = float(best[k])
            good = [fitted_place, *(float(other[k]) for other in others)]
            worse: list[float] = []
            rest = np.arange(len(best)) != k
            along = np.zeros(len(best))
            along[k] = 1.0
            along[rest] = -np.linalg.solve(normal[np.ix_(rest, rest)], normal[rest, k])
            for place in np.clip(
                [0.0, 1.0, *(fitted_place - _ALONE), *(fitted_place + _ALONE)], 0.0, 1.0
            ).tolist():
                alone, made_up = (
                    best.copy(),
                    np.clip(best + (place - fitted_place) * along, 0.0, 1.0),
                )
                alone[k] = made_up[k] = place
                (good if is_as_good(alone) or is_as_good(made_up) else worse).append(place)
            low, high = min(good), max(good)
            low = max((place for place in worse if place < low), default=low)
            high = min((place for place in worse if place > high), default=high)
            at_bound = (low < _EDGE) != (1.0 - high < _EDGE)
            fitted.append(
                Fitted(
                    name=str(parameter),
                    value=parameter.at(fitted_place),
                    low=parameter.low,
                    high=parameter.high,
                    from_=parameter.at(low),
                    to=parameter.at(high),
                    is_determined=high - low < _WIDE and not at_bound,
                    at_bound=at_bound,
                )
            )
        return fitted


def _losses(differences: Sequence[FloatArray]) -> FloatArray:
    """Return the loss of each drive, (n,)."""
    return np.array([float(difference @ difference) for difference in differences])


def _residuals(differences: Sequence[FloatArray]) -> FloatArray:
    """Return the residuals of all drives, (m,), whose square is the loss."""
    residuals: FloatArray = np.concatenate(differences) / math.sqrt(len(differences))
    return residuals


def difference(
    losses: FloatArray, other_losses: FloatArray, labels: IntArray
) -> tuple[float, float]:
    """Return the difference of two mean losses, (n,) each, and its standard error over groups."""
    d = losses - other_losses
    mean = float(d.mean())
    groups = np.bincount(labels, weights=d - mean)
    factor = len(groups) / max(len(groups) - 1, 1)
    return mean, float(np.sqrt(factor * (groups**2).sum()) / len(d))


def group_labels(drives: Sequence[RecordedDrive]) -> IntArray:
    """Return each drive's independent group, (n,): its run, or the drive itself if runs are few."""
    runs, labels = np.unique([drive.run for drive in drives], return_inverse=True)
    return labels.astype(np.int64) if len(runs) >= _FEW_RUNS else np.arange(len(drives))
