"""A search in a twin that decides which roads a slow simulator gets."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, ClassVar, Final, Literal, Self, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.statistics import a12, rank_correlation
from frenetic.outcome import Outcome
from frenetic.search.approach import approaches, is_near
from frenetic.search.archive import FAR, Archive, Place, places_of
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import (
    SearchEnded,
    Strategy,
)

Drive: TypeAlias = Callable[[Candidate, float], Evaluation]
"""Drives a candidate in the twin; told the spent share of the budget."""

SCREENED: Final = "screened"
"""The operator that a screened road's origin names."""
NOTE: Final = "screening"
"""Name of the note about a candidate: ``role``, whether the twin chose it or it is a control,
``drawn``, the roads that the twin drove to choose it, and ``outcome`` and ``moobd`` there."""
DRAWN: Final = 20
"""Roads that the twin drives for each that is handed on."""

_LEAST_RANKED = 5  # controls from which on the twin's order is compared
_CONTROLS = 0.1  # share of unscreened roads
_MORE_CONTROLS = 0.5  # while they bring more than screened ones
_KEPT = 400  # prospects
_SPACING = 5.0  # [m] between places of a road that are compared with known failures
_SAME = 1.6  # [m] of difference within which a road fails as one before did
_NOTHING_NEW, _NEW = 1.0, 2.5  # [m] of difference from the failures before
_KNOWN = 0.1  # worth of a road that passes a known failure on its way
_REACH = 3.0  # [m] of difference over which a kept or broken promise tells of others
_PRIOR = 2.0  # drives that a promise counts as, before any was tried
_CHANCES = {True: 0.5, False: 0.1}  # of a failure where the twin fails or passes, at first
_DISTINCT = 2.0  # [m] of difference of a new failure
_LEAST_CONTROLS, _LEAST_SCREENED = 6, 10
_LEAST_KEPT = 0.25  # share of promises below which the twin is in doubt
_SURE = 1.64  # standard errors by which controls must bring more
_ROUNDS = 5  # without a drive, after which the twin is given up


@dataclass(eq=False)
class _Prospect:
    """A road that the twin has driven."""

    candidate: Candidate
    """Of the scout."""
    evaluation: Evaluation
    place: Place
    """Where the twin failed or came nearest to it."""
    approaches: FloatArray
    """To places every 5 m up to that one, (n, 64) in m."""
    novelty: float = FAR
    """Difference from the failures before, m."""
    meets_known: bool = False
    """Whether a known failure lies on its way."""


_Driven: TypeAlias = tuple[str, float | None, float | None, bool]
"""Role of a road that the simulator drove, its MOOBD in m in the twin and there, whether it failed
there."""


def _in_words(driven: Sequence[_Driven]) -> dict[str, Any]:
    """What screening came to: names in words -> numbers.

    How far the twin is right is said of controls alone.
    """
    handed_on = [failed for role, *_, failed in driven if role == "screened"]
    controls = [(twin, slow, failed) for role, twin, slow, failed in driven if role == "control"]
    found: dict[str, Any] = {
        "handed on": len(handed_on),
        "failed as promised": sum(handed_on),
        "controls": len(controls),
        "failed controls": sum(failed for *_, failed in controls),
    }
    pairs = [(twin, slow, f) for twin, slow, f in controls if twin is not None and slow is not None]
    if len(pairs) >= _LEAST_RANKED:
        twin, slow, _ = zip(*pairs, strict=True)
        found["twin's rank correlation"] = rank_correlation(twin, slow)
        passed, failed = ([t for t, _, fails in pairs if fails is kind] for kind in (False, True))
        if passed and failed:
            found["twin's AUC"] = a12(passed, failed)
    return found


class Screened(Strategy):
    """A `Strategy` that searches in a twin and hands on what promises new failures.

    A *scout*, a search of its own, proposes roads that only the twin drives. After each `drawn` of
    them the most promising of all goes to the slow simulator: the largest product of

    - the *chance* that it fails there, learnt from the roads that were handed on: from the share of
      promises that were kept, and more from the promises like it;
    - its *novelty*: how far its approach, the twin's, is from those of the failures before and of
      the roads handed on; little if the slow simulator failed before on a road that begins alike.

    One road in ten is a *control*: the strategy's own proposal, as without a twin. The strategy
    learns from all results. While controls bring more new failures than screened roads, or fewer
    than a quarter of the promises are kept, every other road is one. When the controls lead by
    1.64 standard errors, screening stops for good, and the strategy goes on alone.

    Args:
        strategy: Learns from the slow simulator, and proposes controls.
        scout: Searches in the twin; a fresh strategy with another seed.
        drive: Drives a road in the twin.
        drawn: Roads that the twin drives for each that is handed on.
        twin: Entered while a campaign runs.
        name: The twin in words.
        options: What it was made with, for a campaign's record.

    """

    BEHAVIOUR: ClassVar = 1

    def __init__(
        self,
        strategy: Strategy,
        scout: Strategy,
        drive: Drive,
        *,
        drawn: int = DRAWN,
        twin: AbstractContextManager[object] | None = None,
        name: str = "",
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.strategy = strategy
        self.scout = scout
        self.options = dict(options or {})
        self._twin = nullcontext() if twin is None else twin
        self._name = name
        self._told: list[_Driven] = []
        self._screened = 0  # roads that only the twin drove, and those handed on; no tests
        self._unscreened = 0  # candidates after screening had stopped
        self.stopped: str | None = None
        """Why screening stopped, None while it goes on."""
        self._drive = drive
        self._count = drawn
        self._prospects: list[_Prospect] = []
        self._trials: dict[int, Candidate] = {}  # outstanding
        self._promised: list[tuple[Place, bool | None]] = []  # handed on, and whether it failed
        self._row_of: dict[int, int] = {}  # of a candidate in `_promised`
        self._failures = Archive()  # of the slow simulator
        self._driven: Counter[str] = Counter()  # by role
        self._new: Counter[str] = Counter()  # that brought a new failure
        self._budget_spent = 0.0
        self._credit = 0.0  # for controls
        self._idle_rounds = 0
        self._drawn = 0  # since the last road was handed on

    def keep_margin(self, margin: float) -> None:
        """Take only roads for valid that keep so many m from the map's edge."""
        for one in (self.strategy, self.scout):
            one.keep_margin(margin)

    def __enter__(self) -> Self:
        """Start the twin."""
        self._twin.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the twin."""
        self._twin.__exit__(kind, error, trace)

    def facts(self) -> Mapping[str, Any]:
        """Return what screening came to."""
        after = {"not screened after it stopped": self._unscreened} if self._unscreened else {}
        drawn = {"screened by": self._name, "roads screened": self._screened}
        return {**drawn, **_in_words(self._told), **after}

    @property
    def notice(self) -> str | None:
        """Why screening stopped, or what the strategy has to say."""
        return self.stopped or self.strategy.notice

    def ask(self) -> Candidate | None:
        """Return the next road for the slow simulator."""
        if self.stopped is not None:
            self._unscreened += 1
            return self.strategy.ask()
        is_doubtful = self._lead() > 0.0 or self._breaks_promises
        self._credit += _MORE_CONTROLS if is_doubtful else _CONTROLS
        if self._credit < 1.0 - 1e-9:  # ten tenths
            prospect = self._choose()
            if prospect is not None:
                return self._hand_on(prospect)
        self._credit = max(self._credit - 1.0, 0.0)
        candidate = _asked(self.strategy)
        seen = self._drive(candidate, self._budget_spent)
        self._trials[candidate.id] = _noted(candidate, "control", 0, seen)
        return self._trials[candidate.id]

    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: See `Ledger.settle`.

        """
        self.strategy.tell(evaluation)
        self._budget_spent = max(self._budget_spent, evaluation.budget_spent)
        trial = self._trials.pop(evaluation.candidate.id, None)
        if trial is None or not evaluation.outcome.is_driven:
            return
        role, has_failed = trial.notes[NOTE]["role"], evaluation.outcome is Outcome.FAIL
        self._told.append((role, trial.notes[NOTE]["moobd"], evaluation.moobd, has_failed))
        if self.stopped is not None:
            return
        self._driven[role] += 1
        row = self._row_of.pop(trial.id, None)
        if row is not None:
            self._promised[row] = self._promised[row][0], has_failed
        severity = evaluation.severity
        if has_failed and severity is not None:
            place = places_of(evaluation, trial, severity)[0]
            self._new[role] += self._failures.add(trial, place) >= _DISTINCT
            for prospect in self._prospects:
                self._meet(prospect, place)
        lead = self._lead()
        controls, screened = self._driven["control"], self._driven["screened"]
        if controls >= _LEAST_CONTROLS and screened >= _LEAST_SCREENED and lead > _SURE:
            self._stop(
                f"screening stopped after {screened + controls} drives, since the twin misleads:"
                f" {self._new['screened']} of {screened} screened roads brought a new failure,"
                f" {self._new['control']} of {controls} others"
            )

    def _stop(self, reason: str) -> None:
        self.stopped = reason
        self._prospects.clear()

    def _lead(self) -> float:
        """Standard errors by which controls bring more new failures than screened roads."""
        shares, squares = [], 0.0
        for role in ("control", "screened"):
            n = self._driven[role] + 1.0
            share = (self._new[role] + 0.5) / n
            shares.append(share)
            squares += share * (1.0 - share) / n
        return (shares[0] - shares[1]) / math.sqrt(squares)

    @property
    def _breaks_promises(self) -> bool:
        """Whether too few of the roads that were handed on fail."""
        told = [kept for _, kept in self._promised if kept is not None]
        return len(told) >= _LEAST_SCREENED and sum(told) < _LEAST_KEPT * len(told)

    def _choose(self) -> _Prospect | None:
        """The most promising road, after the scout's next ones; None if there is none."""
        passing: tuple[float, Candidate, Evaluation] | None = None
        has_driven = False
        for _ in range(self._count):
            try:
                candidate = _asked(self.scout)
            except SearchEnded:
                break
            seen = self._drive(candidate, self._budget_spent)
            self.scout.tell(seen)
            self._drawn += 1
            if not seen.outcome.is_driven or seen.severity is None or seen.trace is None:
                continue
            has_driven = True
            if seen.outcome is Outcome.FAIL:
                self._consider(candidate, seen)
            elif passing is None or seen.severity < passing[0]:
                passing = seen.severity, candidate, seen
        if passing is not None:
            self._consider(*passing[1:])
        self._idle_rounds = 0 if has_driven else self._idle_rounds + 1
        if self._idle_rounds == _ROUNDS:
            self._stop("screening stopped, since the twin drove none of the roads to any end")
        if not self._prospects:
            return None
        worth = self._worth()
        chosen = self._prospects[int(np.argmax(worth))]
        kept = np.sort(np.argsort(-worth, kind="stable")[: _KEPT + 1])
        self._prospects = [p for k in kept if (p := self._prospects[k]) is not chosen]
        return chosen

    def _consider(self, candidate: Candidate, seen: Evaluation) -> None:
        """Take a road that the twin has driven among the prospects."""
        assert seen.severity is not None
        assert seen.trace is not None
        place = places_of(seen, candidate, seen.severity)[0]
        ways = np.arange(_SPACING, max(place.distance, _SPACING) + 0.1, _SPACING)
        prospect = _Prospect(
            candidate,
            seen,
            place,
            approaches(candidate.curvatures, candidate.step, seen.trace, ways),
        )
        for row in range(len(self._failures)):
            distance, side, severity, has_failed, _ = self._failures.places[row].tolist()
            vector = self._failures.vectors[row]
            self._meet(prospect, Place(distance, side, severity, has_failed, vector))
        for promised, _ in self._promised:
            self._compare(prospect, promised)
        self._prospects.append(prospect)

    def _meet(self, prospect: _Prospect, failure: Place) -> None:
        """Note what a failure in the slow simulator means for a prospect."""
        self._compare(prospect, failure)
        if not prospect.meets_known:
            prospect.meets_known = is_near(prospect.approaches, failure.vector, _SAME * _SAME)

    @staticmethod
    def _compare(prospect: _Prospect, other: Place) -> None:
        if prospect.place.side == other.side:
            difference = float(np.linalg.norm(prospect.place.vector - other.vector))
            prospect.novelty = min(prospect.novelty, difference)

    def _worth(self) -> FloatArray:
        """Worth of handing on each prospect, (n,)."""
        vectors = np.array([one.place.vector for one in self._prospects])
        sides = np.array([one.place.side for one in self._prospects])
        failed = np.array([one.place.has_failed for one in self._prospects])
        told = [(place, y) for place, y in self._promised if y is not None]
        chance = np.empty(len(vectors))
        for outcome, usual in _CHANCES.items():
            kept = [y for place, y in told if place.has_failed == outcome]
            chance[failed == outcome] = (_PRIOR * usual + sum(kept)) / (_PRIOR + len(kept))
        kept_alike, alike = _PRIOR * chance, np.full(len(vectors), _PRIOR)
        for place, y in told:
            squares = ((vectors - place.vector) ** 2).sum(axis=1)
            weight = np.exp(-0.5 * squares / _REACH**2) * (sides == place.side)
            kept_alike += weight * y
            alike += weight
        novelty = np.array([one.novelty for one in self._prospects])
        new = np.clip((novelty - _NOTHING_NEW) / (_NEW - _NOTHING_NEW), 0.0, 1.0)
        new *= np.where([one.meets_known for one in self._prospects], _KNOWN, 1.0)
        worth: FloatArray = kept_alike / alike * (new + 1e-3)
        return worth

    def _hand_on(self, prospect: _Prospect) -> Candidate:
        scouted, seen = prospect.candidate, prospect.evaluation
        number = _asked(self.strategy).id
        for other in self._prospects:
            self._compare(other, prospect.place)
        self._row_of[number] = len(self._promised)
        self._promised.append((prospect.place, None))
        made = Candidate(number, scouted.curvatures, scouted.step, Origin(SCREENED))
        candidate = _noted(made, "screened", self._drawn, seen)
        self._screened += self._drawn
        self._drawn = 0
        self.strategy.replace(candidate)
        self._trials[number] = candidate
        return candidate


def _asked(strategy: Strategy) -> Candidate:
    candidate = strategy.ask()
    if candidate is None:
        raise ValueError("a strategy that waits for results cannot be screened")
    return candidate


def _noted(
    candidate: Candidate, role: Literal["screened", "control"], drawn: int, seen: Evaluation
) -> Candidate:
    """The same candidate with a note of what a twin did on its road."""
    note = {"role": role, "drawn": drawn, "outcome": str(seen.outcome), "moobd": seen.moobd}
    return replace(candidate, notes={**candidate.notes, NOTE: note})
