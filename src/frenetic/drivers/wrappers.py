"""Wrappers over any driver: errors about its position, late controls, a limited view, haste.

Wrappers can be combined, as in ``Delayed(Noisy(Planner(), offset=0.2), seconds=0.1)``, and their
order does not matter: each changes other parts of the observation, or the controls. A built-in
driver with at most one wrapper of each class still drives in the compiled rollout.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import Annotated, Final, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, NotNegative, Positive, check
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import cosine, sine
from frenetic.drivers.driver import (
    AHEAD_POINTS,
    AHEAD_SPACING,
    Controls,
    Driver,
    DriveSetup,
    Observation,
    changed_observation,
)
from frenetic.drivers.stack import OwnWrapper

HEADING_PER_OFFSET: Final = 0.1
"""Heading error per lateral error, in rad per m, if a user sets only the lateral error; our choice.
"""

_BLOCK: Final = 256  # number of errors that are drawn at once; part of the behaviour


@njit(interpret_first=0.1)
def disturb(ahead: FloatArray, first: int, stop: int, offset: float, heading: float) -> None:
    """Move the view ahead, in place, to where a car with a wrong position sees it.

    A car that believes itself ``offset`` m further left and turned by ``heading`` rad sees every
    point further right, and turned the other way.

    Args:
        ahead: points of the view, (n, 2) in m, see `Observation.ahead`.
        first, stop: points that are moved: from number ``first`` up to, but without, ``stop``.
        offset: error of the lateral offset, in m.
        heading: error of the heading, in rad.
    """
    c, s = cosine(heading), sine(heading)
    for i in range(first, stop):
        x, y = ahead[i, 0], ahead[i, 1] - offset
        ahead[i, 0] = c * x + s * y
        ahead[i, 1] = c * y - s * x


def displaced_pose(observation: Observation, offset: float, heading: float) -> dict[str, float]:
    """Return x, y and heading on the map where a car with a wrong position believes itself.

    Args:
        observation: observation from the car's true position.
        offset: error of the lateral offset, in m.
        heading: error of the heading, in rad.
    """
    lane_heading = observation.heading - observation.heading_error
    return {
        "x": observation.x - offset * math.sin(lane_heading),
        "y": observation.y + offset * math.cos(lane_heading),
        "heading": observation.heading + heading,
    }


_Error: TypeAlias = Annotated[float, Meta(ge=0.0, le=100.0)]
"""Standard deviation of an error, in m or in rad."""


class Noisy(OwnWrapper):
    """A driver with errors about its lateral position and its heading, which change slowly.

    Both errors are Gaussian and first-order autoregressive. They shift the lateral offset, the
    heading error, the position on the map and the view ahead together, as the errors of one
    localisation do. Every drive has the same errors, drawn from ``seed``.

    Args:
        driver: the driver underneath.
        offset: standard deviation of the lateral error, in m.
        heading: standard deviation of the heading error, in rad.
        correlation_time: time after which an error has faded to 1/e, in s.
        seed: seed of the errors.
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
        """Return the errors in a drive whose control period is ``period`` s."""
        return ErrorSequence(self.offset, self.heading, self.correlation_time, self.seed, period)

    def reset(self, setup: DriveSetup) -> None:
        """Start the errors anew."""
        super().reset(setup)
        self._errors = self.errors(setup.period)
        self._calls = 0

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for the disturbed observation."""
        offset, heading = self._errors.upto(self._calls + 1)[self._calls].tolist()
        self._calls += 1
        ahead = observation.ahead.copy()
        disturb(ahead, 0, len(ahead), offset, heading)
        return self.driver.act(
            changed_observation(
                observation,
                lateral_offset=observation.lateral_offset + offset,
                heading_error=observation.heading_error + heading,
                ahead=ahead,
                **displaced_pose(observation, offset, heading),
            )
        )


class ErrorSequence:
    """The lateral and heading errors of a `Noisy` driver in a drive, drawn when they are needed."""

    def __init__(
        self, offset: float, heading: float, correlation_time: float, seed: int, period: float
    ) -> None:
        self._rng = np.random.default_rng(seed)
        self._deviations = np.array([offset, heading])
        self._correlation = math.exp(-period / correlation_time)  # of successive errors
        self._unscaled = np.empty((0, 2))  # the errors, divided by their standard deviations
        self._errors = self._unscaled

    def upto(self, n: int) -> FloatArray:
        """Return at least the first n errors, (m, 2) in m and rad with m >= n.

        An error is the same in every call.
        """
        while len(self._unscaled) < n:
            fresh = self._rng.standard_normal((_BLOCK, 2))
            last = self._unscaled[-1] if len(self._unscaled) else self._rng.standard_normal(2)
            correlated = _autoregress(fresh, last, self._correlation)
            self._unscaled = np.concatenate([self._unscaled, correlated])
            self._errors = self._unscaled * self._deviations
        return self._errors


@njit(interpret_first=0.1)
def _autoregress(fresh: FloatArray, last: FloatArray, correlation: float) -> FloatArray:
    """Return rows (n, 2) of which each depends on the row before; each value has variance 1.

    Args:
        fresh: independent standard normal values, (n, 2).
        last: row before the first, (2,).
        correlation: correlation between a row and the next.
    """
    out = np.empty_like(fresh)
    gain = math.sqrt(1.0 - correlation * correlation)
    a, b = last[0], last[1]
    for i in range(len(fresh)):
        a = correlation * a + gain * fresh[i, 0]
        b = correlation * b + gain * fresh[i, 1]
        out[i, 0] = a
        out[i, 1] = b
    return out


class Delayed(OwnWrapper):
    """A driver whose controls arrive late.

    Until the first controls arrive, the car rolls with straight wheels and no pedal.

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
        """Replace the waiting controls by controls without steering and pedals."""
        super().reset(setup)
        self._waiting = deque([Controls(0.0)] * self.periods(setup.period))

    def act(self, observation: Observation) -> Controls:
        """Return the controls that the driver chose a delay ago."""
        self._waiting.append(self.driver.act(observation))
        return self._waiting.popleft()


class LimitedView(OwnWrapper):
    """A driver that sees only the next metres of road.

    Args:
        driver: the driver underneath.
        distance: length of road in view, in m. Of the points of `Observation.ahead`, which are 2 m
            apart, those within this distance remain, at least two. `Observation.lane` ends at this
            distance, too.
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
            changed_observation(
                observation,
                ahead=observation.ahead[: self.rows],
                curvature_ahead=observation.curvature_ahead[: self.rows],
                speed_limit_ahead=observation.speed_limit_ahead[: self.rows],
                view=min(observation.view, max(self.distance, AHEAD_SPACING)),
            )
        )


class Hasty(OwnWrapper):
    """A driver that takes each speed limit for a higher limit.

    Args:
        driver: the driver underneath.
        excess: speed above the limit, in km/h.
    """

    place = 3

    def __init__(self, driver: Driver, *, excess: NotNegative = 10.0) -> None:
        check(locals(), Hasty.__init__)
        super().__init__(driver)
        self.excess = float(excess)

    @classmethod
    def over(cls, driver: Driver, amount: float) -> Hasty:
        """Return a driver whose speed limits are ``amount`` km/h too high."""
        return cls(driver, excess=amount)

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive, with a higher limit at the start."""
        super().reset(replace(setup, speed_limit=setup.speed_limit + self.excess / 3.6))

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for higher limits."""
        excess = self.excess / 3.6
        return self.driver.act(
            changed_observation(
                observation,
                speed_limit=observation.speed_limit + excess,
                speed_limit_ahead=observation.speed_limit_ahead + excess,
            )
        )
