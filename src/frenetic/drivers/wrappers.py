"""Wrappers over any driver: noise on what it sees, delay of what it does, a limited view, haste.

Wrappers compose: ``Delayed(Noisy(Planner(), offset=0.2), seconds=0.1)``. They commute, as noise and
view change what comes in and the delay what goes out. A built-in driver under one wrapper of each
kind stays inside the compiled rollout.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, NotNegative, Positive, check
from frenetic._support.compiled import njit
from frenetic.drivers.builtin import BuiltIn
from frenetic.drivers.driver import (
    AHEAD_POINTS,
    AHEAD_SPACING,
    Controls,
    Driver,
    DriveSetup,
    Observation,
)
from frenetic.drivers.stack import OwnWrapper

HEADING_PER_OFFSET: Final = 0.1
"""Heading error per lateral error, in rad per m, where only the lateral error is given."""

_BLOCK = 256  # errors that are drawn at once


@njit()
def disturb(ahead: FloatArray, rows: int, offset: float, heading: float) -> None:
    """Move the view ahead, in place, as it looks to a car that errs about its place.

    A car that believes itself ``offset`` m further left and turned by ``heading`` rad sees every
    point further right, turned the other way.
    """
    c, s = math.cos(heading), math.sin(heading)
    for i in range(rows):
        x, y = ahead[i, 0], ahead[i, 1] - offset
        ahead[i, 0] = c * x + s * y
        ahead[i, 1] = c * y - s * x


_Error: TypeAlias = Annotated[float, Meta(ge=0.0, le=100.0)]
"""Standard deviation of an error about the place, in m or in rad."""


class Noisy(OwnWrapper):
    """A driver that errs about its place: Gaussian errors that change slowly.

    Both errors are first-order autoregressive with the given standard deviations and correlation
    time. Offset, heading error, place on the map and view ahead err alike, as they would when they
    come from one localisation. Every drive sees the same errors, drawn from ``seed``.

    Args:
        driver: the driver underneath.
        offset: m, standard deviation of the lateral error.
        heading: rad, standard deviation of the heading error.
        correlation_time: s after which an error has faded to 1/e.
        seed: of the errors.
    """

    place = 1

    def __init__(
        self,
        driver: Driver,
        *,
        offset: _Error = 0.1,
        heading: _Error = 0.01,
        correlation_time: Positive = 1.0,
        seed: Index = 0,
    ) -> None:
        check(locals(), Noisy.__init__)
        super().__init__(driver)
        self.offset = float(offset)
        self.heading = float(heading)
        self.correlation_time = float(correlation_time)
        self.seed = int(seed)

    @classmethod
    def over(cls, driver: Driver, amount: float, *, seed: int = 0) -> Noisy:
        """Return a driver whose lateral error has this standard deviation, in m."""
        return cls(driver, offset=amount, heading=HEADING_PER_OFFSET * amount, seed=seed)

    def errors(self, period: float) -> ErrorSequence:
        """Return the errors of one drive with a control period in s."""
        return ErrorSequence(self.offset, self.heading, self.correlation_time, self.seed, period)

    def reset(self, setup: DriveSetup) -> None:
        """Start the errors anew."""
        super().reset(setup)
        self._errors = self.errors(setup.period)
        self._calls = 0

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the disturbed observation."""
        offset, heading = self._errors.upto(self._calls + 1)[self._calls]
        self._calls += 1
        ahead = observation.ahead.copy()
        disturb(ahead, len(ahead), offset, heading)
        along = observation.heading - observation.heading_error
        return self.driver.act(
            replace(
                observation,
                lateral_offset=observation.lateral_offset + offset,
                heading_error=observation.heading_error + heading,
                ahead=ahead,
                x=observation.x - offset * math.sin(along),
                y=observation.y + offset * math.cos(along),
                heading=observation.heading + heading,
            )
        )


class ErrorSequence:
    """The errors (lateral, heading) of a `Noisy` driver, drawn as far as they are needed."""

    def __init__(
        self, offset: float, heading: float, correlation_time: float, seed: int, period: float
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._scale = np.array([offset, heading])
        self._keep = math.exp(-period / correlation_time)
        self._rows = np.empty((0, 2))

    def upto(self, n: int) -> FloatArray:
        """Return errors, (m, 2) in m and rad, m >= n; the same rows in every call."""
        while len(self._rows) < n:
            fresh = self._rng.standard_normal((_BLOCK, 2))
            last = self._rows[-1] if len(self._rows) else self._rng.standard_normal(2)
            self._rows = np.concatenate([self._rows, _autoregress(fresh, last, self._keep)])
        scaled: FloatArray = self._rows * self._scale
        return scaled


@njit()
def _autoregress(fresh: FloatArray, last: FloatArray, keep: float) -> FloatArray:
    """Return standard normal rows that depend on the row before, with a variance of 1."""
    out = np.empty_like(fresh)
    gain = math.sqrt(1.0 - keep * keep)
    a, b = last[0], last[1]
    for i in range(len(fresh)):
        a = keep * a + gain * fresh[i, 0]
        b = keep * b + gain * fresh[i, 1]
        out[i, 0] = a
        out[i, 1] = b
    return out


class Delayed(OwnWrapper):
    """A driver whose controls arrive late.

    Until the first ones arrive, the car rolls with straight wheels and no pedal.

    Args:
        driver: the driver underneath.
        seconds: the delay, rounded to whole control periods.
    """

    place = 0

    def __init__(
        self, driver: Driver, *, seconds: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.1
    ) -> None:
        check(locals(), Delayed.__init__)
        super().__init__(driver)
        self.seconds = float(seconds)

    @classmethod
    def over(cls, driver: Driver, amount: float) -> Delayed:
        """Return a driver whose controls arrive this many s late."""
        return cls(driver, seconds=amount)

    def periods(self, period: float) -> int:
        """Return the delay in control periods of ``period`` s."""
        return round(self.seconds / period)

    def reset(self, setup: DriveSetup) -> None:
        """Forget the controls that are on their way."""
        super().reset(setup)
        self._waiting = deque([Controls(0.0)] * self.periods(setup.period))

    def act(self, observation: Observation) -> Controls:
        """Return the controls that the driver chose some time ago."""
        self._waiting.append(self.driver.act(observation))
        return self._waiting.popleft()


class LimitedView(OwnWrapper):
    """A driver that sees only the next metres of road.

    Args:
        driver: the driver underneath.
        distance: m of road; the view is cut to whole points 2 m apart, at least two.
            `Observation.lane` ends there, too, also if it is longer than the view.
    """

    place = 2

    def __init__(self, driver: Driver, *, distance: Positive = 30.0) -> None:
        check(locals(), LimitedView.__init__)
        super().__init__(driver)
        self.distance = float(distance)

    @classmethod
    def over(cls, driver: Driver, amount: float) -> LimitedView:
        """Return a driver that sees this many m ahead."""
        return cls(driver, distance=amount)

    @property
    def rows(self) -> int:
        """Number of points that remain of a full view."""
        return min(max(int(self.distance / AHEAD_SPACING) + 1, 2), AHEAD_POINTS)

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the road in view."""
        return self.driver.act(
            replace(
                observation,
                ahead=observation.ahead[: self.rows],
                curvature_ahead=observation.curvature_ahead[: self.rows],
                speed_limit_ahead=observation.speed_limit_ahead[: self.rows],
                view=min(observation.view, max(self.distance, AHEAD_SPACING)),
            )
        )


class Hasty(OwnWrapper):
    """A driver that takes each speed limit for a higher one.

    Args:
        driver: the driver underneath.
        excess: km/h above the limit.
    """

    place = 3

    def __init__(self, driver: Driver, *, excess: NotNegative = 10.0) -> None:
        check(locals(), Hasty.__init__)
        super().__init__(driver)
        self.excess = float(excess)

    @classmethod
    def over(cls, driver: Driver, amount: float) -> Hasty:
        """Return a driver that drives so many km/h over the limit."""
        return cls(driver, excess=amount)

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        super().reset(replace(setup, speed_limit=setup.speed_limit + self.excess / 3.6))

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for higher limits."""
        excess = self.excess / 3.6
        return self.driver.act(
            replace(
                observation,
                speed_limit=observation.speed_limit + excess,
                speed_limit_ahead=observation.speed_limit_ahead + excess,
            )
        )


@dataclass(frozen=True)
class Compiled:
    """A built-in driver and its wrappers, flattened for the compiled rollout."""

    law: int
    parameters: FloatArray
    rows: int
    """Number of points of the view."""
    delay: int
    """Delay, in control periods."""
    errors: ErrorSequence | None
    excess: float
    """Excess over the speed limit, in m/s."""


def compiled_form(driver: Driver, period: float) -> Compiled | None:
    """Return the driver for the compiled rollout, or None if it has to be called from Python.

    Only the built-in classes themselves qualify, under at most one wrapper of each kind: a subclass
    may do anything in `act`.
    """
    rows, delay, errors, excess = AHEAD_POINTS, 0, None, 0.0
    kinds = set()
    while isinstance(driver, OwnWrapper) and type(driver) in (Noisy, Delayed, LimitedView, Hasty):
        if type(driver) in kinds:
            return None
        kinds.add(type(driver))
        if isinstance(driver, Noisy):
            errors = driver.errors(period)
        elif isinstance(driver, Delayed):
            delay = driver.periods(period)
        elif isinstance(driver, LimitedView):
            rows = driver.rows
        elif isinstance(driver, Hasty):
            excess = driver.excess
        driver = driver.driver
    if not (isinstance(driver, BuiltIn) and type(driver).__module__ == BuiltIn.__module__):
        return None
    if hasattr(driver, "period"):  # the rollout has a fixed period
        return None
    return Compiled(driver.law, driver.parameters(), rows, delay, errors, excess / 3.6)
