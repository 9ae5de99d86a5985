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

The drives are a campaign, whose strategy `Draws` proposes them stage by stage::

    domain = Domain.of("town.toml")
    terms = Terms.of_class(domain.road_class, domain=domain)
    tester = RoadTester(EmbeddedSimulator(), MyDriver(), terms)
    print(estimate(tester, drives=1000, workers=4, out="town-estimate").in_words())
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, NamedTuple, Unpack

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import require_count
from frenetic._support.files import check_writable, read_bounded, write_file
from frenetic._support.outside_text import read_json
from frenetic._support.words import counted
from frenetic.analysis.statistics import weighted_interval
from frenetic.campaign import LOOKAHEAD, Campaign, CampaignStore, Event, new_folder
from frenetic.campaign.database import DATABASE
from frenetic.campaign.guarded_strategy import replay
from frenetic.campaign.record import Test
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.campaigns import How, campaign_again, complete
from frenetic.search.random_search import RANDOM, RandomRoads
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy
from frenetic.spec import Budget
from frenetic.spec.part_record import describe

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
"""Roads in a row that are drawn at most until one is valid."""
_REMEDY: Final = "make room, or let it be written"

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
class _Point:
    """Conditions of a drive in a domain, and how it ended."""

    conditions: FloatArray
    """Normal numbers of the conditions, (d,)."""
    failed: bool


@dataclass(frozen=True)
class _Stage:
    """Drives in conditions that are drawn from one distribution: normal numbers around centres."""

    conditions: Sequence[FloatArray | None]
    """(d,) normal numbers of each drive; None for some that are drawn as the domain distributes
    them, for each road anew."""
    often: Callable[[FloatArray], FloatArray]
    """Says how often it draws (n, d) conditions, where the domain's distribution does once."""
    least: float
    """How often it draws the conditions that it draws least often."""
    is_plain: bool = False
    """Whether it is the domain's distribution."""

    def __len__(self) -> int:
        """Return the number of drives."""
        return len(self.conditions)


class _Weighted:
    """Drives in conditions from several distributions, which count together.

    A failure weighs as much as its conditions are more probable in the domain than among all draws,
    by the balance heuristic.

    Args:
        dimension: number of the normal numbers of conditions.
        rng: draws.
    """

    def __init__(self, dimension: int, rng: np.random.Generator) -> None:
        self._dimension, self._rng = dimension, rng
        self._points: list[_Point] = []
        self._stages: list[_Stage] = []
        self._least_drawn = 0.0  # draws of the conditions drawn least often, per chance 1 of them
        self.plain: list[_Point] = []
        """The plain drives."""

    def stages(self, drives: int) -> Iterator[_Stage]:
        """Yield the drives, stage by stage; `add` has to take each before the next is wanted.

        Plain drives come first. Others follow as long as these carry the estimate better.
        """
        yield self._plainly(round(_PILOT * drives))
        failures, pilot = self.failures, self.drives
        is_common = failures / pilot * drives >= _ENOUGH
        remaining, gains = drives - pilot, not is_common and self._dimension > 0
        for share in _WIDELY:
            if gains and self.carried <= failures:  # none but plain ones
                yield self._widely(round(share * remaining))
        first, remaining, spent = self.drives, drives - self.drives, 0.0
        for number, share in enumerate(_AROUND):
            spent += share
            # Else as many plain drives would carry the estimate better, or nothing has failed.
            plainly = failures / pilot * self.drives if number > 1 else 0.0
            gains = gains and self.carried > plainly
            if gains:
                yield self._around_failures(first + round(spent * remaining) - self.drives)
        if self.drives < drives:
            yield self._plainly(drives - self.drives)

    def _plainly(self, count: int) -> _Stage:
        """Return drives in conditions as the domain distributes them."""
        return _Stage([None] * count, lambda points: np.ones(len(points)), 1.0, is_plain=True)

    def _widely(self, count: int) -> _Stage:
        """Draw each condition from the domain's distribution or from a wider one."""
        shape = count, self._dimension
        wide = np.where(self._rng.random(shape) < 0.5, _WIDE, 1.0)

        def often(points: FloatArray) -> FloatArray:
            squares = points**2
            wider = np.exp(0.5 * (squares - squares / _WIDE**2)) / _WIDE
            ratios: FloatArray = np.prod(0.5 + 0.5 * wider, axis=1)
            return ratios

        # Each condition is least often drawn where it is the usual one: half of the time as usual.
        least = (0.5 + 0.5 / _WIDE) ** shape[1]
        return _Stage([*(wide * self._rng.standard_normal(shape))], often, least)

    def _around_failures(self, count: int) -> _Stage:
        """Draw around the conditions of the failures so far, from the usual ones to them."""
        rng, centres, shares = self._rng, self._failed, self._shares / self._shares.sum()
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
        conditions = around[which] + rng.standard_normal((count, len(around[0])))
        return _Stage([*conditions], ratios, least)

    @property
    def drives(self) -> int:
        """Number of drives."""
        return len(self._points)

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

    def add(self, stage: _Stage, points: Sequence[_Point]) -> None:
        """Count the drives of a stage, in its order."""
        self._points += points
        self._stages.append(stage)
        self._least_drawn += stage.least * len(stage)
        if stage.is_plain:
            self.plain += points
        failed = [point.conditions for point in self._points if point.failed]
        self._failed = np.array(failed).reshape(len(failed), self._dimension)
        drawn = np.zeros(len(failed))
        for earlier in self._stages:
            drawn += len(earlier) * earlier.often(self._failed)
        self._shares = 1.0 / drawn
        """Of each failure in the chance."""


def _uniform(normal: FloatArray) -> FloatArray:
    from scipy.special import ndtr  # takes its time

    shares: FloatArray = np.clip(ndtr(normal), 1e-12, 1.0 - 1e-12)
    return shares


class _Draw(NamedTuple):
    """A road and conditions that were drawn."""

    number: int
    """Place in its stage, from 0."""
    conditions: FloatArray
    """(d,) normal numbers."""
    candidate: Candidate


class Draws(Strategy):
    """Proposes random drives in a domain, and conditions in which they fail more often.

    The drives of a stage follow from the results of the stages before alone. So at the end of a
    stage nothing is proposed until its last result is told. A drive in which the simulator broke is
    proposed again.

    Args:
        tester: says which roads are drawn, and which of them are valid.
        drives: number of drives in all, at least 100.
        seed: of the draws.
    """

    BEHAVIOUR: Final = 1
    expects_failures: ClassVar[bool] = True

    def __init__(self, tester: RoadTester, drives: int, seed: int) -> None:
        domain = tester.terms.domain
        if domain is None:
            raise ValueError("the terms of the tester have no domain: give them one")
        self.domain = self._domain = domain
        self.road_class = tester.terms.road_class
        self.options: Mapping[str, Any] = {"drives": drives, "seed": seed}
        self._tester = tester
        self._rng = np.random.default_rng(seed)
        self._roads = RandomRoads(
            map_size=tester.terms.map_size, road_class=tester.terms.road_class
        )
        self._ledger = Ledger()
        self._first: _Draw | None = None
        self._waiting: dict[int, _Draw] = {}  # candidate's id -> its draw, until it is told
        self._broken: deque[_Draw] = deque()  # to be proposed again
        self._weighted = _Weighted(domain.dimension, self._rng)  # drives of the stages before
        self.plain: set[int] = set()
        """Ids of the plain drives."""
        self._stages = self._weighted.stages(drives)
        self._begin_stage()

    def _begin_stage(self) -> None:
        self._stage = next(self._stages, None)
        self._drawn = 0  # drives of the stage that were drawn
        self._points: dict[int, _Point] = {}  # number of a drive in the stage -> its result

    @property
    def is_begun(self) -> bool:
        """Whether it has proposed a drive."""
        return self._ledger.issued > 0

    @property
    def is_complete(self) -> bool:
        """Whether all drives were told."""
        return self._stage is None

    def require_valid_roads(self) -> None:
        """Refuse a domain of which no road is valid.

        Raises:
            ValueError: None of 1000 random roads is valid on the map.
        """
        assert self._stage is not None
        self._first = self._draw(self._stage)

    def ask(self) -> Candidate | None:
        """Return the next drive; None at the end of a stage, until its last result is told."""
        if self._stage is None:
            raise SearchEnded("all drives were made")
        if self._broken:
            draw = self._broken.popleft()
        elif self._drawn < len(self._stage):
            draw = self._first or self._draw(self._stage)
            self._first = None
            self._drawn += 1
        else:
            return None
        road = draw.candidate
        candidate = self._ledger.issue(
            road.curvatures,
            road.step,
            road.origin,
            conditions=road.conditions,
            grade=road.grade,
            repeat=road.repeat,
        )
        self._waiting[candidate.id] = draw
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result of a drive; the last one of a stage begins the next stage.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        candidate = self._ledger.settle(evaluation)
        draw, stage = self._waiting.pop(candidate.id), self._stage
        assert stage is not None
        if evaluation.outcome not in (Outcome.PASS, Outcome.FAIL):
            again = replace(candidate, repeat=candidate.repeat + 1)
            self._broken.append(draw._replace(candidate=again))
            return
        self._points[draw.number] = _Point(draw.conditions, evaluation.outcome is Outcome.FAIL)
        if stage.is_plain:
            self.plain.add(candidate.id)
        if len(self._points) == len(stage):
            self._weighted.add(stage, [self._points[i] for i in range(len(stage))])
            self._begin_stage()

    def _draw(self, stage: _Stage) -> _Draw:
        """Draw the stage's next drive, again until its road is valid.

        Raises:
            ValueError: none of 1000 roads is.
        """
        for _ in range(_REDRAWS):
            conditions = stage.conditions[self._drawn]
            if conditions is None:
                conditions = self._rng.standard_normal(self._domain.dimension)
            candidate = self._candidate(conditions)
            road, verdict = self._tester.laid(candidate)
            if road is not None and verdict.valid:
                return _Draw(self._drawn, conditions, candidate)
        raise ValueError(
            f"none of {_REDRAWS} random roads of {self._domain.name} is valid on a map of"
            f" {self._tester.terms.map_size:g} m"
        )

    def _candidate(self, conditions: FloatArray) -> Candidate:
        """Return a random road, which may be invalid, in these conditions."""
        roads = self._roads
        numbers = _uniform(self._rng.standard_normal(roads.numbers))
        rng = np.random.default_rng(int(self._rng.integers(2**62)))
        values = roads.draw_once(rng, numbers)
        amounts = self._domain.at(_uniform(conditions), (len(values) - 1) * roads.step)
        grade = roads.grade(rng, values)
        return Candidate(1, values, roads.step, Origin(RANDOM), conditions=amounts, grade=grade)

    def estimate(self, kilometres: float) -> Estimate:
        """Return the estimate from all drives.

        Args:
            kilometres: length of the plain drives, in km.

        Raises:
            FreneticError: the plain drives have no length.
        """
        weighted, drives = self._weighted, self._weighted.drives
        plain = len(weighted.plain)
        if not kilometres:
            raise FreneticError(
                f"the driver broke in each of {plain} drives before the car moved, so there is no"
                " distance to count failures over: 'frenetic run' says how it breaks"
            )
        length = kilometres / plain
        rate, low, high = (chance * 1000.0 / length for chance in weighted.interval())
        failures = sum(point.failed for point in weighted.plain)
        method: Method = "plain" if plain == drives else "importance sampling"
        return Estimate(
            domain=self._domain.name,
            method=method if weighted.failures else "none",
            rate=rate if weighted.failures else None,
            low=low,
            high=high,
            drives=drives,
            failures=failures,
            plain=plain,
            kilometres=kilometres,
            length=length,
            seed=self.options["seed"],
            note=_note(method, weighted.carried),
            other_failures=weighted.failures - failures,
        )


def estimate(
    tester: RoadTester,
    *,
    drives: int = 10_000,
    seed: int = 0,
    campaign: Path | str | None = None,
    **how: Unpack[How],
) -> Estimate:
    """Estimate how often the driver leaves its lane in the domain of a tester.

    The drives are a campaign; the same call goes on with an interrupted one and reads a complete
    one. Where no campaign is given, that is so with ``out`` alone.

    Args:
        tester: drives on its terms, which have a domain; its simulator is not yet entered.
        drives: number of drives; refused roads cost none.
        seed: of the draws.
        campaign: folder of the campaign whose driver and domain they are; it keeps the drives and,
            in `FILE`, the estimate. By default a campaign of its own keeps both, in a new folder
            under ``campaigns/``.
        how: see `How`.

    Raises:
        KeyboardInterrupt: Ctrl-C came before the last drive.
        FreneticError: no road of the domain is valid, the simulator broke, or simulator or driver
            cannot have the domain's conditions.
        CampaignError: as for `frenetic.rerun.campaigns.campaign_again`.
        ValueError: a number is out of range.
    """
    drives = require_count("drives", drives, least=100)
    draws = Draws(tester, drives, seed)
    if campaign is None:
        how["out"] = how.get("out") or new_folder()
    else:
        check_writable(Path(campaign) / FILE, remedy=_REMEDY)
    driving = campaign_again(
        campaign,
        draws,
        tester,
        Budget(simulations=drives),
        what=[describe(draws), tester.terms],
        terms={"estimate": True},
        how=how,
        lookahead=LOOKAHEAD,  # whatever is out, the same is drawn
    )
    errors = _errors(driving.folder)
    budget = driving.budget = Budget(simulations=drives + errors)  # those are driven again
    on_event = how.get("on_event")

    def watch(event: Event) -> None:
        if event.summary.errors > errors and event.test is not None:
            raise FreneticError(
                f"the simulator broke, which says nothing of the driver: {event.test.reason}; the"
                f" drives so far are kept in {driving.folder}"
            )
        if on_event is not None:
            on_event(event)

    complete(driving, {**how, "on_event": watch})
    result = _result(driving, draws, budget)
    document = json.dumps(result.as_json()) + "\n"
    for folder in {driving.folder, Path(campaign or driving.folder)}:
        write_file(folder / FILE, document, remedy=_REMEDY)
    return result


def _result(driving: Campaign, draws: Draws, budget: Budget) -> Estimate:
    """Return the estimate from the drives of a campaign.

    Raises:
        KeyboardInterrupt: drives are missing.
        FreneticError: see `Draws.estimate`.
    """
    if not draws.is_begun:  # nothing was left to be driven
        with suppress(CampaignError):  # a damaged file is written anew
            if (result := Estimate.read(driving.folder)) is not None:
                return result
    with CampaignStore.open(driving.folder) as store:
        if not draws.is_begun:
            replay(store, draws, budget, driving.objective)
        if not draws.is_complete:
            raise KeyboardInterrupt
        tests = [test for test in store.tests() if test.id in draws.plain]
        return draws.estimate(math.fsum(_metres(test, store) / 1000.0 for test in tests))


def _errors(folder: Path) -> int:
    """Return in how many drives of a campaign the simulator broke; 0 without a campaign."""
    if not (folder / DATABASE).is_file():
        return 0
    with CampaignStore.open(folder) as store:
        return store.counts().errors


def _metres(test: Test, store: CampaignStore) -> float:
    """Return how far the car came in a drive until it failed, in m."""
    result = test.result
    if result.fault is not None:  # before it, the car may not have moved
        path = store.trajectory(test.id)
        return 0.0 if path is None else float(np.hypot(*np.diff([path.x, path.y])).sum())
    if result.outcome is Outcome.FAIL and result.finding is not None:
        distance = result.finding.distance
        return test.candidate.length if distance is None else distance
    return test.candidate.length


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
