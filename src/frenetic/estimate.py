"""How often a driver leaves its lane in a domain: departures per 1,000 km, with an interval.

Roads and conditions are drawn as the domain distributes them; a search's failures, which are not,
take no part. Where failures are common, plain drives are counted: with n departures in L km the
interval is the exact one of a Poisson rate (Garwood 1936), also for n = 0. Where they are rare,
subset simulation (Au and Beck 2001) goes there by levels: of many drives the worst fifth are kept,
by how far the car was from its lane's edge; each is changed a little at random, in a way that keeps
the domain's distribution among drives as bad as these; and so on until many fail. The chance of a
failure is the product of the levels' shares. It is done several times independently; such
products are about lognormal, and the interval is Cox's for the mean of a lognormal distribution.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from msgspec import convert
from msgspec.json import decode as json_decode

from frenetic._support.arrays import FloatArray
from frenetic._support.files import read_bounded
from frenetic._support.words import counted
from frenetic.campaign.tester import RoadTester
from frenetic.domain import Domain
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.search.random_search import RandomRoads
from frenetic.search.records import Candidate, Origin
from frenetic.simulators.worlds import check_pair_in
from frenetic.spec import require_count

FILE: Final = "estimate.json"
"""Name of the file in a campaign's folder."""
CONFIDENCE: Final = 0.95
REPEATS: Final = 6
"""Independent subset simulations."""
_PILOT: Final = 0.2
"""Share of the drives that are plain ones at first."""
_ENOUGH: Final = 50
"""Failures that all plain drives together should have, as far as these say, to go on so."""
_KEPT: Final = 0.2
_LEVELS: Final = 5
"""Levels for which there are enough drives."""
_MOST_LEVELS: Final = 9
_STEP: Final = 0.5
"""Share of a point's normal numbers that a change draws anew, as the root of the squares."""
_REDRAWS: Final = 1000

Method = Literal["plain", "subset simulation", "none"]


@dataclass(frozen=True)
class Estimate:
    """Departures per 1,000 km in a domain."""

    domain: str
    method: Method
    """None if subset simulation reached no failure: then there is an upper limit only."""
    rate: float | None
    """Departures per 1,000 km."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end."""
    drives: int
    """All drives."""
    failures: int
    """Failures among the plain ones."""
    plain: int
    """Plain drives."""
    kilometres: float
    """Their length in km."""
    length: float
    """Mean length of a drive in km."""
    seed: int
    note: str = ""
    """What it cannot know."""

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
            return convert(json_decode(read_bounded(path)), cls)
        except (ValueError, RecursionError) as error:
            raise CampaignError(
                f"{path} is damaged: {error}; remove it, or run frenetic estimate again"
            ) from None

    def in_words(self) -> str:
        """The estimate for people."""
        if self.rate is None:
            text = f"fewer than {_two(self.high)} departures per 1,000 km"
        else:
            text = f"about {_two(self.rate)} departures per 1,000 km"
            text += f" ({_two(self.low)} to {_two(self.high)})"
        text += f" in {self.domain}, {self.method if self.rate else 'plain drives'},"
        text += f" {counted(self.drives, 'drive')}"
        return f"{text}; {self.note}" if self.note else text

    def as_json(self) -> dict[str, Any]:
        """As JSON."""
        return {**asdict(self), "confidence": CONFIDENCE}


def rate_interval(failures: int, exposure: float) -> tuple[float, float]:
    """The exact 95 % interval of a rate with so many events in an exposure (Garwood 1936)."""
    from scipy.stats import chi2  # takes its time

    tail = 0.5 * (1.0 - CONFIDENCE)
    low = float(chi2.ppf(tail, 2 * failures)) / 2.0 if failures else 0.0
    # Without any event there is no lower end: the whole 5 % lie above.
    top = 1.0 - (tail if failures else 2.0 * tail)
    return low / exposure, float(chi2.ppf(top, 2 * failures + 2)) / 2.0 / exposure


@dataclass(frozen=True)
class _Point:
    """A drive in the domain."""

    conditions: FloatArray
    """Normal numbers of the conditions, (d,)."""
    road: FloatArray
    """Normal numbers of a class's road, (k,); of the competition's, none."""
    seed: int
    """Of all else of the road."""
    severity: float = math.inf
    """Distance of the car from its lane's edge in m, less is worse; -inf if it failed."""
    length: float = 0.0
    """Length of the drive in km."""


class _Draws:
    """Draws, changes and drives points of a domain.

    Raises:
        FreneticError: the domain's roads do not fit the map.
    """

    def __init__(self, domain: Domain, tester: RoadTester, rng: np.random.Generator) -> None:
        self.domain, self.tester, self.rng = domain, tester, rng
        self.roads = RandomRoads(map_size=tester.map_size, road_class=domain.road_class)
        self.roads.keep_margin(tester.margin)
        self.drives = 0

    def candidate(self, point: _Point) -> Candidate | None:
        """The candidate of a point; None if its road is not valid."""
        rng = np.random.default_rng(point.seed)
        values = self.roads.made(rng, _shares(point.road))
        if not self.roads.accepts(values):
            return None
        length = (len(values) - 1) * self.roads.step
        conditions = self.domain.at(_shares(point.conditions), length)
        grade = self.roads.grade(rng, values)
        return Candidate(
            1, values, self.roads.step, Origin("random"), conditions=conditions, grade=grade
        )

    def fresh(self) -> _Point:
        """A point from the domain's distribution, driven."""
        for _ in range(_REDRAWS):
            point = _Point(
                self.rng.standard_normal(self.domain.dimension),
                self.rng.standard_normal(self.roads.numbers),
                int(self.rng.integers(2**62)),
            )
            if (driven := self.driven(point)) is not None:
                return driven
        raise FreneticError(
            f"none of {_REDRAWS} random roads of {self.domain.name} is valid on a map of"
            f" {self.tester.map_size:g} m"
        )

    def driven(self, point: _Point) -> _Point | None:
        """The point with its drive; None if its road is not valid.

        Raises:
            FreneticError: the drive broke.
        """
        candidate = self.candidate(point)
        if candidate is None:
            return None
        attempt = self.tester.test(candidate)
        result = attempt.result
        if result.outcome is Outcome.INVALID:
            return None
        self.drives += 1
        if result.outcome not in (Outcome.PASS, Outcome.FAIL):
            raise FreneticError(f"a drive broke, which says nothing of the driver: {result.reason}")
        severity = -math.inf
        if result.outcome is Outcome.PASS:
            severity = math.inf if result.moobd is None else result.moobd
        place = None if result.finding is None else result.finding.distance
        way = candidate.length if result.outcome is Outcome.PASS or place is None else place
        return replace(point, severity=severity, length=way / 1000.0)

    def changed(self, point: _Point, level: float) -> _Point:
        """A step of a Markov chain that keeps the distribution among points as bad as a level."""
        rng, way = self.rng, self.rng.random()
        new = point
        if way < 0.6 and len(point.conditions):
            keep = math.sqrt(1.0 - _STEP * _STEP)
            noise = rng.standard_normal(len(point.conditions))
            moved = keep * point.conditions + _STEP * noise
            which = rng.random(len(moved)) < 0.7
            new = replace(point, conditions=np.where(which, moved, point.conditions))
        elif way < 0.95 and self.roads.numbers:
            size = int(rng.integers(1, max(self.roads.numbers // 2, 2)))
            first = int(rng.integers(0, self.roads.numbers - size + 1))
            road = point.road.copy()
            road[first : first + size] = rng.standard_normal(size)
            new = replace(point, road=road)
        else:
            new = replace(point, seed=int(rng.integers(2**62)))
        driven = self.driven(new)
        return driven if driven is not None and driven.severity <= level else point


def _shares(normal: FloatArray) -> FloatArray:
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
        drives: most drives, about.
        seed: of the draws.
        on_drive: called after each plain drive and each level, with the drives and failures so far.

    Raises:
        FreneticError: its roads do not fit, a drive broke, or simulator or driver cannot have its
            conditions.
        ValueError: a number is out of range.
    """
    drives = require_count("drives", drives, least=100)
    check_pair_in(domain.all_at_once(), tester.simulator, tester.driver)
    draws = _Draws(domain, tester, np.random.default_rng(seed))
    found: list[_Point] = []

    failures = 0

    def plain(count: int) -> None:
        nonlocal failures
        for _ in range(count):
            found.append(draws.fresh())
            failures += found[-1].severity == -math.inf
            on_drive(draws.drives, failures)

    plain(round(_PILOT * drives))
    is_common = failures / len(found) * drives >= _ENOUGH
    if is_common:
        plain(drives - len(found))
    way = math.fsum(one.length for one in found)
    mean = way / len(found)
    low, high = rate_interval(failures, way / 1000.0)
    found_plainly = Estimate(
        domain=domain.name,
        method="plain" if failures else "none",
        rate=failures / way * 1000.0 if failures else None,
        low=low,
        high=high,
        drives=draws.drives,
        failures=failures,
        plain=len(found),
        kilometres=way,
        length=mean,
        seed=seed,
    )
    if is_common:
        return found_plainly
    each = int((drives - len(found)) / REPEATS / (1.0 + _LEVELS * (1.0 - _KEPT)))
    chances = []
    for _ in range(REPEATS):
        chances.append(_chance(draws, max(each, 10)))
        on_drive(draws.drives, failures)
    if missed := sum(chance == 0.0 for chance in chances):
        note = (
            f"{missed} of {REPEATS} subset simulations reached no failure, so no more than that is"
            " known: give it more --drives, or the failures of this driver do not announce"
            " themselves"
        )
        return replace(found_plainly, drives=draws.drives, note=note)
    logs = np.log(chances)
    variance = float(np.var(logs, ddof=1))
    error = math.sqrt(variance / REPEATS + variance**2 / (2.0 * (REPEATS - 1)))
    factor = math.exp(_student(REPEATS - 1) * error)
    rate = float(np.mean(chances)) * 1000.0 / mean
    return replace(
        found_plainly,
        method="subset simulation",
        rate=rate,
        low=rate / factor,
        high=rate * factor,
        drives=draws.drives,
    )


def _student(freedom: int) -> float:
    from scipy.stats import t  # takes its time

    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, freedom))


def _chance(draws: _Draws, count: int) -> float:
    """The chance that a drive fails, by one subset simulation of so many drives a level."""
    points, chance = [draws.fresh() for _ in range(count)], 1.0
    kept = max(round(_KEPT * count), 2)
    for _ in range(_MOST_LEVELS):
        points.sort(key=lambda point: point.severity)
        failed = sum(point.severity == -math.inf for point in points)
        if failed >= kept:
            return chance * failed / count
        level = points[kept - 1].severity
        parents = [point for point in points if point.severity <= level]
        if level == math.inf or len(parents) == len(points):
            break  # nothing is worse than anything
        chance *= len(parents) / count
        chains = list(parents)
        points = list(parents)
        while len(points) < count:
            for i in range(len(chains)):
                if len(points) < count:
                    chains[i] = draws.changed(chains[i], level)
                    points.append(chains[i])
    failed = sum(point.severity == -math.inf for point in points)
    return chance * failed / count


def _two(value: float) -> str:
    """A number with two significant digits."""
    return f"{float(f'{value:.2g}'):g}"
