"""Estimate how often a driver leaves its lane in a domain: failures per 1,000 km, with an interval.

The road and the conditions of a plain drive are drawn as the domain distributes them. The failures
of a search do not count, because the search chose them. Where failures are common, all drives are
plain: with n failures in L km the interval is the exact interval of a Poisson rate (Garwood 1936),
two-sided also for n = 0. Where failures are rare, `frenetic.rerun.importance_sampling` draws their
conditions more often and weights the drives. All drives count.

The drives are a campaign, whose strategy `Draws` proposes them stage by stage::

    domain = Domain.of("town.toml")
    terms = Terms.of_class(domain.road_class, domain=domain)
    tester = RoadTester(EmbeddedSimulator(), MyDriver(), terms)
    print(estimate(tester, drives=1000, workers=4, out="town-estimate").as_text())
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Mapping
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
from frenetic.campaign import MAX_IN_FLIGHT, Campaign, CampaignStore, Event, new_folder
from frenetic.campaign.database import DATABASE
from frenetic.campaign.record import Test
from frenetic.campaign.replay import replay
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.campaigns import DrivingOptions, DrivingPlan, drive_missing, driving_campaign
from frenetic.rerun.importance_sampling import (
    CONFIDENCE,
    DriveResult,
    Stage,
    WeightedDrives,
    standard_normal_shares,
)
from frenetic.search.operator_names import RANDOM
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy
from frenetic.spec import Budget
from frenetic.spec.part_record import describe

FILE: Final = "estimate.json"
"""Name of the file with the estimate in a campaign's folder."""
_MIN_FAILURES: Final = 5
"""Effective number of failures below which an estimate says little; our choice."""
_SURE_FAILURES: Final = 100.0
"""Effective number of failures from which on the estimated rate hardly grows with more drives; our
choice."""
_MIN_DRIVES: Final = 100
"""Fewest drives of an estimate; our choice."""
_MAX_REDRAWS: Final = 1000
"""Largest number of roads that are drawn in a row until one is valid; our choice."""
_WRITE_REMEDY: Final = "make room, or let it be written"

Method = Literal["plain", "importance sampling", "none"]


@dataclass(frozen=True)
class FailureRate:
    """Estimate of a driver's failures per 1,000 km in a domain."""

    domain: str
    """Name of the domain."""
    method: Method
    """Method of the estimate; ``none`` if no drive failed, so that only `high` says something."""
    rate: float | None
    """Failures per 1,000 km; None if no drive failed."""
    low: float
    """Lower end of the interval, in failures per 1,000 km."""
    high: float
    """Upper end of the interval, in failures per 1,000 km."""
    drives: int
    """Number of all drives."""
    failures: int
    """Number of failures among the plain drives."""
    plain: int
    """Number of plain drives."""
    kilometres: float
    """Length of the plain drives, in km."""
    length: float
    """Mean length of a plain drive, in km."""
    seed: int
    """Seed of the draws."""
    note: str = ""
    """Caution about the estimate, in words; empty if there are enough failures."""
    other_failures: int = 0
    """Number of failures among the drives that are not plain."""

    @classmethod
    def read(cls, folder: Path) -> FailureRate | None:
        """Return the estimate in a campaign's folder; None if there is none.

        Raises:
            CampaignError: the file is damaged.
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

    def as_text(self) -> str:
        """Return the estimate in words."""
        if self.rate is None:
            text = f"fewer than {_two_digits(self.high)} failures per 1,000 km"
            text += " (upper end of the two-sided 95 % interval)"
        else:
            text = f"about {_two_digits(self.rate)} failures per 1,000 km"
            text += (
                f" (two-sided 95 % interval {_two_digits(self.low)} to {_two_digits(self.high)})"
            )
        text += f" in {self.domain}, {self.method if self.rate else 'plain drives'},"
        text += f" {counted(self.drives, 'drive')}"
        return f"{text}; {self.note}" if self.note else text

    def as_json(self) -> dict[str, Any]:
        """Return the estimate as a JSON object."""
        return {**asdict(self), "confidence": CONFIDENCE}


class _Draw(NamedTuple):
    """A drive of a stage whose road and conditions were drawn."""

    number: int
    """Number of the drive in its stage, from 0."""
    conditions: FloatArray
    """Standard normal numbers that stand for the conditions, (d,)."""
    candidate: Candidate
    """Road and conditions, with the preliminary id 1."""


class Draws(Strategy):
    """Strategy that proposes random drives in a domain, and more drives in failing conditions.

    The drives of a stage depend only on the results of earlier stages. So after the last drive of a
    stage the strategy proposes nothing until it has all results of the stage. A drive in which the
    simulator broke is proposed again.

    Args:
        tester: tester whose terms say which roads are drawn and which of them are valid.
        drives: number of all drives, at least 100.
        seed: seed of the draws.

    Raises:
        ValueError: the terms have no domain.
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
        self._first: _Draw | None = None  # drawn by `require_valid_roads`, not yet proposed
        self._in_flight: dict[int, _Draw] = {}  # id of a candidate without result -> its draw
        self._to_repeat: deque[_Draw] = deque()  # draws in which the simulator broke
        self._weighted = WeightedDrives(domain.dimension, self._rng)  # drives of complete stages
        self.plain: set[int] = set()
        """Ids of the plain drives."""
        self._stages = self._weighted.stages(drives)
        self._begin_stage()

    def _begin_stage(self) -> None:
        """Take the next stage; after the last one there is None."""
        self._stage = next(self._stages, None)
        self._drawn = 0  # number of drives of the stage that were drawn
        self._results: dict[int, DriveResult] = {}  # number of a drive in the stage -> its result

    @property
    def is_begun(self) -> bool:
        """Whether a drive was proposed."""
        return self._ledger.issued > 0

    @property
    def is_complete(self) -> bool:
        """Whether the strategy has the results of all drives."""
        return self._stage is None

    def require_valid_roads(self) -> None:
        """Draw the first road, to refuse a domain without valid roads before anything is driven.

        Raises:
            ValueError: none of `_MAX_REDRAWS` random roads is valid on the map.
        """
        assert self._stage is not None
        self._first = self._draw(self._stage)

    def ask(self) -> Candidate | None:
        """Return the next drive; None at the end of a stage, until all its results are known."""
        if self._stage is None:
            raise SearchEnded("all drives were made")
        if self._to_repeat:
            draw = self._to_repeat.popleft()
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
        self._in_flight[candidate.id] = draw
        return candidate

    def tell(self, evaluation: Evaluation) -> None:
        """Take the result of a drive; the last one of a stage begins the next stage.

        Raises:
            ValueError: see `Ledger.settle`.
        """
        candidate = self._ledger.settle(evaluation)
        draw, stage = self._in_flight.pop(candidate.id), self._stage
        assert stage is not None
        if evaluation.outcome not in (Outcome.PASS, Outcome.FAIL):
            repeated = replace(candidate, repeat=candidate.repeat + 1)
            self._to_repeat.append(draw._replace(candidate=repeated))
            return
        is_failure = evaluation.outcome is Outcome.FAIL
        self._results[draw.number] = DriveResult(draw.conditions, is_failure)
        if stage.is_plain:
            self.plain.add(candidate.id)
        if len(self._results) == len(stage):
            self._weighted.add(stage, [self._results[i] for i in range(len(stage))])
            self._begin_stage()

    def _draw(self, stage: Stage) -> _Draw:
        """Draw the next drive of a stage, repeatedly until its road is valid.

        Raises:
            ValueError: none of `_MAX_REDRAWS` roads is valid.
        """
        for _ in range(_MAX_REDRAWS):
            conditions = stage.drawn[self._drawn]
            if conditions is None:
                conditions = self._rng.standard_normal(self._domain.dimension)
            candidate = self._candidate(conditions)
            road, verdict = self._tester.fit_road(candidate)
            if road is not None and verdict.valid:
                return _Draw(self._drawn, conditions, candidate)
        raise ValueError(
            f"none of {_MAX_REDRAWS} random roads of {self._domain.name} is valid on a map of"
            f" {self._tester.terms.map_size:g} m"
        )

    def _candidate(self, conditions: FloatArray) -> Candidate:
        """Return a random road, possibly invalid, in the conditions that the numbers stand for."""
        roads = self._roads
        numbers = standard_normal_shares(self._rng.standard_normal(roads.max_uniforms))
        rng = np.random.default_rng(int(self._rng.integers(2**62)))
        values = roads.draw_once(rng, numbers)
        amounts = self._domain.at(
            standard_normal_shares(conditions), (len(values) - 1) * roads.step
        )
        grade = roads.grade(rng, values)
        return Candidate(1, values, roads.step, Origin(RANDOM), conditions=amounts, grade=grade)

    def estimate(self, kilometres: float) -> FailureRate:
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
        failures = sum(drive.is_failure for drive in weighted.plain)
        method: Method = "plain" if plain == drives else "importance sampling"
        return FailureRate(
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
            note=_note(method, weighted.effective_failures),
            other_failures=weighted.failures - failures,
        )


def estimate(
    tester: RoadTester,
    *,
    drives: int = 10_000,
    seed: int = 0,
    campaign: Path | str | None = None,
    **options: Unpack[DrivingOptions],
) -> FailureRate:
    """Estimate how often the driver leaves its lane in the domain of a tester.

    The drives are a campaign. The same call continues an interrupted one and reads a complete one,
    if it has the same ``campaign`` or ``out``; without both, each call makes a new folder.

    Args:
        tester: drives on its terms, which have a domain; its simulator is not yet entered.
        drives: number of drives; refused roads cost none.
        seed: seed of the draws.
        campaign: folder of a campaign with this driver and domain, which keeps the drives and, in
            `FILE`, the estimate. By default a new folder under ``campaigns/`` keeps both.
        options: see `DrivingOptions`.

    Raises:
        KeyboardInterrupt: Ctrl-C came before the last drive.
        FreneticError: no road of the domain is valid, the simulator broke, or simulator or driver
            cannot have the domain's conditions.
        CampaignError: see `frenetic.rerun.campaigns.driving_campaign`.
        ValueError: a number is out of range.
    """
    drives = require_count("drives", drives, least=_MIN_DRIVES)
    draws = Draws(tester, drives, seed)
    if campaign is None:
        options["out"] = options.get("out") or new_folder()
    else:
        check_writable(Path(campaign) / FILE, remedy=_WRITE_REMEDY)
    plan = DrivingPlan(
        draws,
        Budget(simulations=drives),
        identity=[describe(draws), tester.terms],
        purpose={"estimate": True},
        max_in_flight=MAX_IN_FLIGHT,  # a constant: draws must not depend on the workers
    )
    driving = driving_campaign(campaign, plan, tester, options)
    # Drives of earlier calls in which the simulator broke are made again: they cost extra budget.
    old_errors = _error_count(driving.folder)
    budget = driving.budget = Budget(simulations=drives + old_errors)
    on_event = options.get("on_event")

    def stop_at_error(event: Event) -> None:
        if event.summary.errors > old_errors and event.test is not None:
            raise FreneticError(
                f"the simulator broke, which says nothing of the driver: {event.test.reason}; the"
                f" drives so far are kept in {driving.folder}"
            )
        if on_event is not None:
            on_event(event)

    drive_missing(driving, stop_at_error)
    result = _result(driving, draws, budget)
    document = json.dumps(result.as_json()) + "\n"
    for folder in {driving.folder, Path(campaign or driving.folder)}:
        write_file(folder / FILE, document, remedy=_WRITE_REMEDY)
    return result


def _result(driving: Campaign, draws: Draws, budget: Budget) -> FailureRate:
    """Return the estimate from the drives of a campaign.

    Args:
        driving: campaign with the drives.
        draws: strategy of the campaign, which proposed the drives unless they were there before.
        budget: budget of the campaign.

    Raises:
        KeyboardInterrupt: drives are missing.
        FreneticError: see `Draws.estimate`.
    """
    if not draws.is_begun:  # the campaign was complete
        with suppress(CampaignError):  # a damaged file is written anew by the caller
            if (result := FailureRate.read(driving.folder)) is not None:
                return result
    with CampaignStore.open(driving.folder) as store:
        if not draws.is_begun:
            replay(store, draws, budget, driving.objective)
        if not draws.is_complete:
            raise KeyboardInterrupt
        tests = [test for test in store.tests() if test.id in draws.plain]
        return draws.estimate(math.fsum(_metres(test, store) / 1000.0 for test in tests))


def _error_count(folder: Path) -> int:
    """Return the number of drives in which the simulator broke; 0 without a campaign."""
    if not (folder / DATABASE).is_file():
        return 0
    with CampaignStore.open(folder) as store:
        return store.counts().errors


def _metres(test: Test, store: CampaignStore) -> float:
    """Return the distance that the car drove, in m: until it failed, or the whole road."""
    result = test.result
    if result.fault is not None:  # the driver may have broken before the car moved
        path = store.trajectory(test.id)
        return 0.0 if path is None else float(np.hypot(*np.diff([path.x, path.y])).sum())
    if result.outcome is Outcome.FAIL and result.finding is not None:
        distance = result.finding.distance
        return test.candidate.length if distance is None else distance
    return test.candidate.length


def _note(method: Method, effective_failures: float) -> str:
    """Return a caution about an estimate in words; empty if there are enough failures."""
    if effective_failures < _MIN_FAILURES:
        return "too few failures for an estimate: raise --drives"
    if method == "importance sampling" and effective_failures < _SURE_FAILURES:
        return (
            f"few failures carry the estimate, as {effective_failures:.0f} plain ones would, so the"
            " rate may be higher: raise --drives"
        )
    return ""


def _two_digits(value: float) -> str:
    """Return a number with two significant digits."""
    return f"{float(f'{value:.2g}'):g}"
