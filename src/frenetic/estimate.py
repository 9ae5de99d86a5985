"""How often a driver leaves its lane in a domain: failures per 1,000 km, with an interval.

Roads and conditions are drawn as the domain distributes them; a search's failures, which are not,
take no part. Where failures are common, plain drives are counted: with n failures in L km the
interval is the exact one of a Poisson rate (Garwood 1936), two-sided also for n = 0.

Where they are rare, conditions are drawn from elsewhere and each drive weighs as much as its
conditions are more probable in the domain (importance sampling): first from a wider distribution,
then around the conditions of the failures so far. All drives count together by the balance
heuristic (Veach and Guibas 1995). The interval is that of a weighted sum of Poisson numbers (Fay
and Feuer 1997); Garwood's is the case of equal weights.

Where the road decides and not the conditions, that gains nothing: then the rest are plain drives.
Every drive counts in the figure. As long as few failures carry it, the upper end allows for one
more failure, in the conditions that were drawn least often. So it falls with the number of drives,
wherever they were drawn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.files import read_bounded
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted
from frenetic.analysis.statistics import weighted_interval
from frenetic.campaign.tester import RoadTester
from frenetic.domain import Domain
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.search.random_search import RANDOM, RandomRoads
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.worlds import check_pair_in
from frenetic.spec import require_count

FILE: Final = "estimate.json"
"""Name of the file in a campaign's folder."""
CONFIDENCE: Final = 0.95
_PILOT: Final = 0.2
"""Share of the drives that are plain ones at first."""
_ENOUGH: Final = 50
"""Failures that all plain drives together should have, as far as these say, to go on so."""
_FEW: Final = 5
"""Failures below which plain drives say little."""
_WIDELY: Final = (0.1, 0.1, 0.1)
"""Shares of the other drives in a wider distribution; the first, others until one has failed."""
_WIDE: Final = 3.0
"""Standard deviation of the first draws from elsewhere, in those of the domain."""
_SCALES: Final = ((1.0, 0.2), (0.75, 0.3), (0.5, 0.3), (0.25, 0.1), (0.0, 0.1))
"""Where draws are made around: so far on the way from the usual to a failure, and how often."""
_CENTRES: Final = 200
_REGION: Final = 2.0
"""Distance of failures that are of one region, in deviations of the domain's distribution."""
_CARRIED: Final = 20.0
"""Failures of equal weight that have to carry an estimate by importance sampling as well."""
_SURE: Final = 100.0
"""Those above which no more is to be expected."""
_AROUND: Final = (0.1, 0.15, 0.2, 0.25, 0.3)
"""Shares of the drives left around failures, at which these are looked at anew."""
_REDRAWS: Final = 1000

Method = Literal["plain", "importance sampling", "none"]


@dataclass(frozen=True)
class Estimate:
    """Failures per 1,000 km in a domain."""

    domain: str
    method: Method
    """None if no failure is known: then there is an upper limit only."""
    rate: float | None
    """Failures per 1,000 km."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end."""
    drives: int
    """All drives."""
    failures: int
    """Failures among the plain drives."""
    plain: int
    """Plain drives."""
    kilometres: float
    """Their length in km."""
    length: float
    """Mean length of a drive in km."""
    seed: int
    note: str = ""
    """What it cannot know."""
    other_failures: int = 0
    """Failures among the other drives, in conditions that are drawn more often than they occur."""

    @classmethod
    def read(cls, folder: Path) -> Estimate | None:
        """The estimate that a campaign's folder keeps; None if there is none.

        Raises:
            CampaignError: it is damaged.
        """
        path = folder / FILE
        if not path.is_file():
            return None
        try:
            return read_json(read_bounded(path), cls)
        except ValueError as error:
            raise CampaignError(
                f"{path} is damaged: {error}; remove it, or run frenetic estimate again"
            ) from None

    def in_words(self) -> str:
        """The estimate for people."""
        if self.rate is None:
            text = f"fewer than {_two(self.high)} failures per 1,000 km"
            text += " (upper end of the two-sided 95 % interval)"
        else:
            text = f"about {_two(self.rate)} failures per 1,000 km"
            text += f" (two-sided 95 % interval {_two(self.low)} to {_two(self.high)})"
        text += f" in {self.domain}, {self.method if self.rate else 'plain drives'},"
        text += f" {counted(self.drives, 'drive')}"
        return f"{text}; {self.note}" if self.note else text

    def as_json(self) -> dict[str, Any]:
        """As JSON."""
        return {**asdict(self), "confidence": CONFIDENCE}


@dataclass(frozen=True)
class Point:
    """A drive in a domain."""

    conditions: FloatArray
    """Normal numbers of the conditions, (d,)."""
    failed: bool
    length: float
    """Length of the drive in km."""


class Draws:
    """Random drives in a domain.

    Raises:
        FreneticError: the domain's roads do not fit the map.
    """

    def __init__(self, domain: Domain, tester: RoadTester, rng: np.random.Generator) -> None:
        self.domain, self.rng = domain, rng
        self.drives = self.failures = 0
        self._tester = tester
        self._roads = RandomRoads(map_size=tester.map_size, road_class=tester.road_class)
        self._roads.keep_margin(tester.margin)

    def drive(self, conditions: FloatArray | None = None) -> Point:
        """A drive as the domain distributes them, or in these conditions, (d,) normal numbers.

        Raises:
            FreneticError: the simulator broke.
        """
        for _ in range(_REDRAWS):
            point = conditions
            if point is None:
                point = self.rng.standard_normal(self.domain.dimension)
            candidate = self._candidate(point)
            attempt = self._tester.test(candidate)
            result = attempt.result
            if result.outcome is Outcome.INVALID:
                continue
            self.drives += 1
            if result.outcome not in (Outcome.PASS, Outcome.FAIL):
                raise FreneticError(
                    f"the simulator broke, which says nothing of the driver: {result.reason}"
                )
            failed = result.outcome is Outcome.FAIL
            self.failures += failed
            way = candidate.length
            if failed and result.finding is not None and result.finding.distance is not None:
                way = result.finding.distance
            if result.fault is not None:  # before it, the car may not have moved
                path = attempt.trajectory
                way = 0.0 if path is None else float(np.hypot(*np.diff([path.x, path.y])).sum())
            return Point(point, failed, way / 1000.0)
        raise FreneticError(
            f"none of {_REDRAWS} random roads of {self.domain.name} is valid on a map of"
            f" {self._tester.map_size:g} m"
        )

    def _candidate(self, point: FloatArray) -> Candidate:
        """A random road, which may be invalid, in these conditions."""
        roads = self._roads
        numbers = _uniform(self.rng.standard_normal(roads.numbers))
        rng = np.random.default_rng(int(self.rng.integers(2**62)))
        values = roads.made(rng, numbers)
        conditions = self.domain.at(_uniform(point), (len(values) - 1) * roads.step)
        grade = roads.grade(rng, values)
        origin = Origin(RANDOM)
        return Candidate(1, values, roads.step, origin, conditions=conditions, grade=grade)


class _Weighted:
    """Drives in conditions from several distributions, which count together.

    A distribution is normal numbers around centres. A failure weighs as much as its conditions are
    more probable in the domain than among all draws, by the balance heuristic.
    """

    def __init__(self, draws: Draws, on_drive: Callable[[], object]) -> None:
        self._draws, self._on_drive = draws, on_drive
        self._points: list[Point] = []
        self._sources: list[tuple[int, Callable[[FloatArray], FloatArray]]] = []
        self._least_drawn = 0.0  # draws of the conditions drawn least often, per chance 1 of them
        self.plain: list[Point] = []
        """The plain drives."""

    def plainly(self, count: int) -> None:
        """Draws conditions as the domain distributes them."""
        start = len(self._points)
        self._drive([None] * count, lambda points: np.ones(len(points)), least=1.0)
        self.plain += self._points[start:]

    def widely(self, count: int) -> None:
        """Draws each condition from the domain's distribution or from a wider one."""
        shape = count, self._draws.domain.dimension
        rng = self._draws.rng
        wide = np.where(rng.random(shape) < 0.5, _WIDE, 1.0)

        def often(points: FloatArray) -> FloatArray:
            squares = points**2
            wider = np.exp(0.5 * (squares - squares / _WIDE**2)) / _WIDE
            ratios: FloatArray = np.prod(0.5 + 0.5 * wider, axis=1)
            return ratios

        # Each condition is least often drawn where it is the usual one: half of the time as usual.
        least = (0.5 + 0.5 / _WIDE) ** shape[1]
        self._drive(wide * rng.standard_normal(shape), often, least=least)

    def around_failures(self, count: int) -> None:
        """Draws around the conditions of the failures so far, from the usual ones to them."""
        rng, centres, shares = self._draws.rng, self._failed, self._shares / self._shares.sum()
        if len(shares) > _CENTRES:
            centres = centres[rng.choice(len(shares), _CENTRES, p=shares)]
            shares = np.full(_CENTRES, 1.0 / _CENTRES)
        # The middle of a region that fails, rather than each of its points.
        far = np.sum((centres[:, None] - centres) ** 2, axis=2)
        near = shares * np.exp(-0.5 * far / _REGION**2)
        centres = near @ centres / near.sum(axis=1, keepdims=True)
        scales, often = np.array(_SCALES).T
        around = np.concatenate([scale * centres for scale in scales])
        shares = np.outer(often, shares).ravel()
        which = rng.choice(len(shares), count, p=shares)

        def ratios(points: FloatArray) -> FloatArray:
            squares, total = np.sum(points**2, axis=1), np.zeros(len(points))
            for centre, share in zip(around, shares, strict=True):
                far = np.sum((points - centre) ** 2, axis=1)
                total += share * np.exp(0.5 * (squares - far))
            return total

        least = float(often[scales == 0.0].sum())  # those around the usual ones
        self._drive(around[which] + rng.standard_normal((count, len(around[0]))), ratios, least)

    @property
    def carried(self) -> float:
        """Number of failures of equal weight that would carry the estimate as well."""
        squares = float(np.sum(self._shares**2))
        return float(np.sum(self._shares)) ** 2 / squares if squares else 0.0

    @property
    def failures(self) -> int:
        """Number of failures in all drives."""
        return len(self._shares)

    def interval(self) -> tuple[float, float, float]:
        """Return the chance of a failure, and the ends of its two-sided interval.

        Where few failures carry it, the upper end allows for one more failure, in the conditions
        that were drawn least often.
        """
        rarest = 1.0 / self._least_drawn
        largest = float(np.max(self._shares)) if self.carried >= _CARRIED else rarest
        low, high = weighted_interval(self._shares, min(largest, rarest), CONFIDENCE)
        return float(np.sum(self._shares)), low, high

    def _drive(
        self,
        conditions: Iterable[FloatArray | None],
        often: Callable[[FloatArray], FloatArray],
        least: float,
    ) -> None:
        """Drives in some conditions, and counts the drives.

        Args:
            conditions: (d,) normal numbers of each drive; None for the domain's distribution.
            often: as for `_add`.
            least: how often the conditions are drawn that are drawn least often.
        """
        points = []
        for numbers in conditions:
            points.append(self._draws.drive(numbers))
            self._on_drive()
        self._least_drawn += least * len(points)
        self._add(points, often)

    def _add(self, points: list[Point], often: Callable[[FloatArray], FloatArray]) -> None:
        """Counts drives from a distribution.

        Args:
            points: the drives.
            often: how often it has (n, d) conditions, where once in the domain's distribution.
        """
        self._points += points
        self._sources.append((len(points), often))
        failed = [point.conditions for point in self._points if point.failed]
        self._failed = np.array(failed).reshape(-1, self._draws.domain.dimension)
        drawn = np.zeros(len(failed))
        for count, often in self._sources:
            drawn += count * often(self._failed)
        self._shares = 1.0 / drawn
        """Of each failure in the chance."""


def _uniform(normal: FloatArray) -> FloatArray:
    from scipy.special import ndtr  # takes its time

    shares: FloatArray = np.clip(ndtr(normal), 1e-12, 1.0 - 1e-12)
    return shares


def estimate(
    domain: Domain,
    tester: RoadTester,
    *,
    drives: int = 10_000,
    seed: int = 0,
    on_drive: Callable[[int, int], object] = lambda _, __: None,
) -> Estimate:
    """How often the driver leaves its lane in a domain.

    Args:
        domain: the domain, whose roads the tester drives.
        tester: drives on its terms.
        drives: number of drives; refused roads cost none.
        seed: of the draws.
        on_drive: called after each drive, with the drives and failures so far.

    Raises:
        FreneticError: its roads do not fit, the simulator broke, or simulator or driver cannot have
            its conditions.
        ValueError: a number is out of range.
    """
    drives = require_count("drives", drives, least=100)
    check_pair_in(domain.all_at_once(), tester.simulator, tester.driver)
    draws = Draws(domain, tester, np.random.default_rng(seed))
    weighted = _Weighted(draws, lambda: on_drive(draws.drives, draws.failures))
    _draw_all(weighted, draws, drives)
    plain = weighted.plain
    way = math.fsum(point.length for point in plain)
    if not way:
        raise FreneticError(
            f"the driver broke in each of {len(plain)} drives before the car moved, so there is no"
            " distance to count failures over: 'frenetic run' says how it breaks"
        )
    length = way / len(plain)
    rate, low, high = (chance * 1000.0 / length for chance in weighted.interval())
    failures = sum(point.failed for point in plain)
    method: Method = "plain" if len(plain) == drives else "importance sampling"
    return Estimate(
        domain=domain.name,
        method=method if weighted.failures else "none",
        rate=rate if weighted.failures else None,
        low=low,
        high=high,
        drives=draws.drives,
        failures=failures,
        plain=len(plain),
        kilometres=way,
        length=length,
        seed=seed,
        note=_note(method, weighted.carried),
        other_failures=weighted.failures - failures,
    )


def _draw_all(weighted: _Weighted, draws: Draws, drives: int) -> None:
    """Draws plain drives, and others as long as these carry the estimate better."""
    weighted.plainly(round(_PILOT * drives))
    failures = weighted.failures
    pilot = draws.drives
    is_common = failures / pilot * drives >= _ENOUGH
    remaining, gains = drives - pilot, not is_common and draws.domain.dimension > 0
    for share in _WIDELY:
        if gains and weighted.carried <= failures:  # none but plain ones
            weighted.widely(round(share * remaining))
    first, remaining, spent = draws.drives, drives - draws.drives, 0.0
    for stage, share in enumerate(_AROUND):
        spent += share
        # Else as many plain drives would carry the estimate better, or nothing has failed.
        plainly = failures / pilot * draws.drives if stage > 1 else 0.0
        gains = gains and weighted.carried > plainly
        if gains:
            weighted.around_failures(first + round(spent * remaining) - draws.drives)
    if draws.drives < drives:
        weighted.plainly(drives - draws.drives)


def _note(method: Method, carried: float) -> str:
    """What an estimate cannot know; empty if enough failures carry it."""
    if carried < _FEW:
        return "too few failed to say more: give it more --drives"
    if method == "importance sampling" and carried < _SURE:
        return (
            f"few failures carry it, as {carried:.0f} plain ones would, so it may be more: give it"
            " more --drives"
        )
    return ""


def _two(value: float) -> str:
    """A number with two significant digits."""
    return f"{float(f'{value:.2g}'):g}"
