"""Sweep: single bends over a grid of radii and speed limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, TypeAlias

import numpy as np
from msgspec import Meta

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Count, Index, NotNegative, Positive
from frenetic.conditions.condition import SPEED, START_SPEED
from frenetic.road.classes import RoadClass
from frenetic.road.pieces import sampled_curvatures, single_bend
from frenetic.road.road_values import MAX_SPEED_LIMIT, MIN_SPEED_LIMIT, USUAL_CHANGE
from frenetic.road.validity import MIN_RADIUS
from frenetic.search.operator_names import SWEEP
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy, checked_options

_USUAL_RADII: Final = (15.0, 100.0)  # [m] least and largest, which fit a map of 200 m; our choice
_CLASS_RADII: Final = 4.0  # largest radius in a road class, in least radii; our choice
_TRANSITION: Final = 10.0  # [m] least length of a clothoid; our choice
_CHANGE_LENGTH: Final = 10.0  # [m] over which `USUAL_CHANGE` counts
_RUN_OUT: Final = 20.0  # [m] of straight behind the bend; our choice

_Steps: TypeAlias = Annotated[int, Meta(ge=1, le=100)]
_Speed: TypeAlias = Annotated[float, Meta(ge=MIN_SPEED_LIMIT, le=MAX_SPEED_LIMIT)]
_Turn: TypeAlias = Annotated[float, Meta(gt=0.0, le=300.0)]


@dataclass(frozen=True)
class _SweptBend:
    """A bend and the speed limit at which it is driven."""

    radius: float
    """Radius of the road's centre line, in m."""
    turn: float
    """Angle by which the road turns in degrees, positive to the left."""
    speed: float
    """Speed limit, in km/h."""
    repeat: int
    """Number of this drive among the drives of the bend at the speed limit, from 0."""


class Sweep(Strategy):
    """A `Strategy` that drives single bends over a grid of radii and speed limits.

    Each cell of the grid is a radius and a speed limit. Its roads are a straight, a bend between
    clothoids and a straight; they bend to either side, by several angles. First every cell is
    driven once, in a random order, then every cell once more, until all roads were driven at all
    speed limits. `frenetic.analysis.sweep_map` returns the map of the results.

    Args:
        seed: A whole number of at least 0, from which the order follows.
        least_radius: m; by default 15, or the road class's least radius.
        largest_radius: m; by default 100, or four times the road class's least radius.
        radii: Number of radii, from the least to the largest in equal ratios.
        least_speed: km/h.
        largest_speed: km/h.
        speeds: Number of speed limits, from the least to the largest in equal steps.
        least_turn: Least angle by which a road turns, in degrees.
        largest_turn: Largest angle by which a road turns, in degrees.
        turns: Number of angles, from the least to the largest in equal steps.
        repeats: How often each road is driven at each speed limit; more than once is for drivers
            whose drives differ.
        run_up: m of straight before the bend, on which the car gets its speed.
        rolling: Whether the car starts at the speed limit; otherwise it starts at rest. The
            simulator must have the condition ``start_speed``.
        step: m between two curvature values.
        road_class: Class of the roads, see `Strategy.road_class`.
        simulator: The campaign's simulator, which must be able to start at a speed if `rolling`;
            None if it is not known.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the proposals, which campaigns record; increase it when they change."""

    def __init__(
        self,
        *,
        seed: Index,
        least_radius: Positive | None = None,
        largest_radius: Positive | None = None,
        radii: _Steps = 8,
        least_speed: _Speed = 30.0,
        largest_speed: _Speed = 80.0,
        speeds: _Steps = 6,
        least_turn: _Turn = 60.0,
        largest_turn: _Turn = 90.0,
        turns: _Steps = 2,
        repeats: Count = 1,
        run_up: NotNegative = 70.0,
        rolling: bool = False,
        step: Positive = 2.0,
        road_class: RoadClass | None = None,
        simulator: object = None,
    ) -> None:
        self.options = checked_options(locals(), Sweep.__init__)
        self.road_class = road_class
        if rolling and simulator is not None and not hasattr(simulator, START_SPEED):
            name = type(simulator).__name__
            raise ValueError(f"rolling: in {name} a car cannot start at a speed; leave it out")
        least, largest = _radii_of(road_class, least_radius, largest_radius)
        _require_ascending("radius", least, largest)
        _require_ascending("speed", least_speed, largest_speed)
        _require_ascending("turn", least_turn, largest_turn)
        transition, arc = _least_lengths(road_class, least)
        # On an arc that is shorter than a step, no sample may have the radius.
        sharpest_turn = math.degrees((transition + arc + step) / least)
        if least_turn < sharpest_turn:
            raise ValueError(
                f"least_turn is {least_turn:g}: with its clothoids, a bend of {least:g} m turns by"
                f" at least {sharpest_turn:.3g} degrees"
            )
        self._run_up, self._step, self._rolling = run_up, step, rolling
        self._bends = _bends(
            np.random.default_rng(seed),
            radii=_rounded(np.geomspace(least, largest, radii)),
            speeds=_rounded(np.linspace(least_speed, largest_speed, speeds)),
            turns=_rounded(np.linspace(least_turn, largest_turn, turns)),
            repeats=repeats,
        )
        # Numbers the candidates, and knows which of them still lack a result.
        self._ledger = Ledger()

    def ask(self) -> Candidate:
        """Return the next bend.

        Raises:
            SearchEnded: Every bend was driven at every speed limit.
        """
        bend = next(self._bends, None)
        if bend is None:
            raise SearchEnded("every bend was driven at every speed limit")
        conditions = {SPEED: bend.speed}
        if self._rolling:
            conditions[START_SPEED] = bend.speed
        return self._ledger.issue(
            self._curvatures(bend),
            self._step,
            Origin(SWEEP),
            conditions=conditions,
            repeat=bend.repeat,
        )

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result of a candidate.

        Raises:
            ValueError: The candidate was never asked, or was told already, or a number of the
                evaluation is not finite; see `Ledger.settle`.

        """
        self._ledger.settle(evaluation)

    def _curvatures(self, bend: _SweptBend) -> FloatArray:
        """Return the curvatures of a bend's road, (N,) in 1/m."""
        curvature = math.copysign(1.0 / bend.radius, bend.turn)
        transition, _ = _least_lengths(self.road_class, bend.radius)
        pieces = single_bend(
            curvature,
            run_up=self._run_up,
            transition=transition,
            arc=math.radians(abs(bend.turn)) * bend.radius - transition,
            run_out=_RUN_OUT,
        )
        return sampled_curvatures(pieces, self._step)


def _radii_of(
    road_class: RoadClass | None, least_radius: float | None, largest_radius: float | None
) -> tuple[float, float]:
    """Return the least and the largest radius of a sweep, in m.

    Args:
        road_class: class of the roads; None for the competition's rules.
        least_radius: the user's least radius, in m; None for the default.
        largest_radius: the user's largest radius, in m; None for the default.

    Raises:
        ValueError: no road bends as sharply as the least radius.
    """
    limit = MIN_RADIUS if road_class is None else road_class.min_radius
    least, largest = _USUAL_RADII if road_class is None else (limit, _CLASS_RADII * limit)
    if least_radius is not None and least_radius < limit:
        raise ValueError(
            f"least_radius is {least_radius:g}: the bends of these roads have at least {limit:.3g}"
            " m"
        )
    least = least if least_radius is None else least_radius
    return least, max(largest, least) if largest_radius is None else largest_radius


def _least_lengths(road_class: RoadClass | None, radius: float) -> tuple[float, float]:
    """Return the lengths of a bend's clothoids and the least length of its arc, in m.

    Args:
        road_class: class of the road; None for the competition's rules.
        radius: radius of the bend, in m.
    """
    if road_class is None:
        return max(_TRANSITION, _CHANGE_LENGTH / (USUAL_CHANGE * radius)), 0.0
    return max(_TRANSITION, road_class.min_clothoid**2 / radius), road_class.min_arc


def _bends(
    rng: np.random.Generator,
    *,
    radii: Sequence[float],
    speeds: Sequence[float],
    turns: Sequence[float],
    repeats: int,
) -> Iterator[_SweptBend]:
    """Yield all bends at all speed limits: every cell once, then every cell once more, and so on.

    Args:
        rng: generator of the orders.
        radii: radii, in m.
        speeds: speed limits, in km/h.
        turns: angles by which roads turn to either side, in degrees.
        repeats: number of drives of each road at each speed limit.
    """
    cells = [(radius, speed) for radius in radii for speed in speeds]
    angles = [angle for turn in turns for angle in (turn, -turn)]
    for repeat in range(repeats):
        orders = [rng.permutation(len(angles)) for _ in cells]
        for number in range(len(angles)):
            for i in rng.permutation(len(cells)).tolist():
                radius, speed = cells[i]
                yield _SweptBend(radius, angles[orders[i][number]], speed, repeat)


def _rounded(values: FloatArray) -> list[float]:
    """Return numbers with three significant digits, each once."""
    return list(dict.fromkeys(float(f"{value:.3g}") for value in values))


def _require_ascending(name: str, least: float, largest: float) -> None:
    """Refuse a range whose end lies below its beginning.

    Raises:
        ValueError: the least value exceeds the largest.
    """
    if least > largest:
        raise ValueError(
            f"least_{name} is {least:g} and largest_{name} {largest:g}: the largest has to be at"
            " least as much"
        )
