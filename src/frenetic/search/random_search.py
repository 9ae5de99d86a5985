"""Random roads: the first phase of Frenetic, and the baseline that a search has to beat."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road import MAP_SIZE, MARGIN, Road
from frenetic.search.operators import CURVATURE_BOUND, MAX_CHANGE, MIN_VALUES, random_curvatures
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, Strategy, options_of, require, require_whole

if TYPE_CHECKING:
    from typing import TypeAlias

STEP = 10.0  # m
LENGTH_JITTER = 5
MOST_JITTER = 1000  # that may be asked for
MAX_LENGTH = 30
MAX_REDRAWS = 10
_MOST_REFUSED = 1000  # roads in a row

RANDOM = "random"
"""The operator that a random road's origin names."""
EARLIER = "earlier"
"""The operator of a road that an earlier campaign drove."""

RoadCheck: TypeAlias = Callable[[FloatArray, float], bool]
"""Says whether a road is valid, from its curvatures, (N,) 1/m, and its step, m.

It must depend on nothing else, or a campaign cannot be replayed.
"""

_Draw = TypeVar("_Draw", "FloatArray", "FloatArray | None")


class MapCheck:
    """A `RoadCheck` whether a road fits the map in some pose and is valid there by the rules.

    Args:
        map_size: m, side of the square map.
        is_valid: A check of the user's own, which takes the place of all this.

    Raises:
        ValueError: `is_valid` is no function.

    """

    def __init__(self, map_size: float, is_valid: RoadCheck | None) -> None:
        function = is_valid is None or callable(is_valid)
        require(function, "is_valid", is_valid, "a function, which only Python can give")
        self._map_size = map_size
        self._is_valid = is_valid
        self._margin = MARGIN

    def keep_margin(self, margin: float) -> None:
        """Have centre lines keep so many m from the map's edge."""
        self._margin = margin

    def __call__(self, curvatures: FloatArray, step: float) -> bool:
        """Return whether a road is valid, see `RoadCheck`."""
        if self._is_valid is not None:
            return self._is_valid(curvatures, step)
        try:
            _, verdict = Road(curvatures, step).placed(self._map_size, self._margin)
        except RoadError:
            return False
        return verdict.valid


class RandomRoads:
    """Draws roads as the random phase of Listing 1 does.

    A road has min(map_size // step, max_length) + U{-length_jitter .. length_jitter} values, at
    least 2, each drawn as `operators.next_curvature` says.

    The paper sends every road to the simulator and so wastes more than a quarter of its tests on
    invalid ones. Our deviation, which ``max_redraws=0`` turns off: a road that `is_valid` refuses
    is drawn again, up to `max_redraws` times; the last draw is always returned.

    Args:
        map_size: m, side of the square map.
        step: m between two curvature values.
        length_jitter: Largest deviation from the usual number of values.
        max_length: Largest usual number of values, before the jitter.
        curvature_bound: 1/m, largest absolute value.
        max_change: 1/m, largest difference of neighbouring values.
        is_valid: Refuses roads that are not worth a test; by default those that do not fit the map
            or that the competition calls invalid.
        max_redraws: How often a refused road is drawn again; 0 is the paper's behaviour.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    def __init__(
        self,
        *,
        map_size: float = MAP_SIZE,
        step: float = STEP,
        length_jitter: int = LENGTH_JITTER,
        max_length: int = MAX_LENGTH,
        curvature_bound: float = CURVATURE_BOUND,
        max_change: float = MAX_CHANGE,
        is_valid: RoadCheck | None = None,
        max_redraws: int = MAX_REDRAWS,
    ) -> None:
        require(0 < map_size < math.inf, "map_size", map_size, "positive (m)")
        require(0 < step < math.inf, "step", step, "positive (m)")
        require(
            0 < curvature_bound < math.inf, "curvature_bound", curvature_bound, "positive (1/m)"
        )
        require(0 < max_change < math.inf, "max_change", max_change, "positive (1/m)")
        self.step = float(step)
        self._map_size = map_size
        self._length_jitter = require_whole("length_jitter", length_jitter, 0, MOST_JITTER)
        self._usual_length = min(
            int(map_size // step), require_whole("max_length", max_length, MIN_VALUES)
        )
        self._curvature_bound = curvature_bound
        self._max_change = max_change
        self._is_valid = MapCheck(map_size, is_valid)
        self._max_redraws = require_whole("max_redraws", max_redraws, 0)

    def keep_margin(self, margin: float) -> None:
        """Check roads with a margin of so many m, unless an `is_valid` was given."""
        self._is_valid.keep_margin(margin)

    def draw(self, rng: np.random.Generator) -> FloatArray:
        """Return the curvatures of a random road, (N,) 1/m."""
        return self.redrawn(lambda: self._draw_once(rng))

    def valid(self, rng: np.random.Generator) -> Iterator[Road]:
        """Draw roads, fit them into the map, and yield those that are valid there.

        Raises:
            ValueError: None of 1000 in a row fits.

        """
        refused = 0
        while refused < _MOST_REFUSED:
            road, verdict = Road(self.draw(rng), self.step).placed(self._map_size)
            if road is not None and verdict.valid:
                refused = 0
                yield road
            else:
                refused += 1
        raise ValueError(
            f"map_size is {self._map_size:g} m: none of {refused} random roads fits into it"
        )

    def redrawn(self, draw: Callable[[], _Draw]) -> _Draw:
        """Return the road that `draw` returns, drawn again while it is invalid and draws are left.

        None, from an operator that does not apply, is returned at once.
        """
        drawn = draw()
        for _ in range(self._max_redraws):
            if drawn is None or self.accepts(drawn):
                break
            drawn = draw()
        return drawn

    def accepts(self, curvatures: FloatArray) -> bool:
        """Return whether a road of these curvatures, (N,) 1/m, is worth a test."""
        return self._max_redraws == 0 or self._is_valid(curvatures, self.step)

    def _draw_once(self, rng: np.random.Generator) -> FloatArray:
        jitter = int(rng.integers(-self._length_jitter, self._length_jitter, endpoint=True))
        return random_curvatures(
            rng,
            max(MIN_VALUES, self._usual_length + jitter),
            bound=self._curvature_bound,
            max_change=self._max_change,
        )


class RandomSearch(Strategy):
    """A `Strategy` that proposes random roads and learns nothing.

    With the same seed and options, its roads are those of Frenetic's random phase.

    Args:
        seed: A whole number of at least 0.
        map_size: m, side of the square map.
        step: m between two curvature values.
        max_length: Largest usual number of values; a road has up to five more or fewer.
        is_valid: Refuses roads that are not worth a test, see `RandomRoads`.
        max_redraws: How often a refused road is drawn again; 0 is the paper's behaviour.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.

    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its proposals change; campaigns record it."""

    def __init__(
        self,
        *,
        seed: int,
        map_size: float = MAP_SIZE,
        step: float = STEP,
        max_length: int = MAX_LENGTH,
        is_valid: RoadCheck | None = None,
        max_redraws: int = MAX_REDRAWS,
    ) -> None:
        self.options = options_of(locals())
        self._rng = np.random.default_rng(require_whole("seed", seed, 0))
        self._roads = RandomRoads(
            map_size=map_size,
            step=step,
            max_length=max_length,
            is_valid=is_valid,
            max_redraws=max_redraws,
        )
        self._ledger = Ledger()

    def keep_margin(self, margin: float) -> None:
        """Take only roads for valid that keep so many m from the map's edge.

        An `is_valid` of your own stays as it is.
        """
        self._roads.keep_margin(margin)

    def ask(self) -> Candidate:
        """Return a random road."""
        return self._ledger.issue(self._roads.draw(self._rng), self._roads.step, Origin(RANDOM))

    def replace(self, candidate: Candidate) -> None:
        """Take another road instead, see `Strategy.replace`."""
        self._ledger.replace(candidate)

    def tell(self, evaluation: Evaluation) -> None:
        """Strike the candidate off; nothing is learnt.

        Raises:
            ValueError: See `Ledger.settle`.

        """
        self._ledger.settle(evaluation)
