"""Trials of causes: what happens to a failure when one thing is changed, and how sure a cause is.

`frenetic.rerun.cause_trials` drives one failing road of each cause again, with one change a drive.
A cause is *certain* if a change that mends such a mistake lets the drive pass, or if the evidence
shows the mistake itself and no trial contradicts it; the drives with hardly other grip must keep
the cause. A cause is *doubtful* if a trial contradicts it. Otherwise it is *likely*.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Any, Final, TypeAlias

from msgspec import ValidationError, convert

from frenetic._support.json_value import JSONValue
from frenetic.analysis.failure_stability import Grip
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.segments.causes import Kind

CAUSE_TRIALS: Final = "cause_trials"
"""Name of the fact with a campaign's trials, a list of `TriedFailure`."""
_LATER: Final = 5.0
"""Distance by which a car leaves its lane later, or earlier, at least, in m; our choice."""
_FREQUENT: Final = 0.2
"""Least share of the failures that a cause has which no trial needs to confirm; our choice."""


class Trial(StrEnum):
    """A change of a failing drive, in words that follow "passes"."""

    LESS_GRIP = Grip.LESS.value
    MORE_GRIP = Grip.MORE.value
    SLOWER = "when it is 10 % slower"
    MUCH_SLOWER = "when it is 20 % slower"
    EARLIER = "when it sees the road 0.5 s earlier"
    LESS_STEERING = "with 10 % less steering"
    MORE_STEERING = "with 10 % more steering"
    FASTER_STEERING = "with faster steering"
    NO_DELAY = "without the delay"
    NO_NOISE = "without the noise"
    NO_RATE_LIMIT = "without the limit of the steering rate"
    MUCH_MORE_GRIP = "with 10 % more grip"
    NO_PEDALS = "with pedals released while it slides"


REPEATS: Final = (Trial.LESS_GRIP, Trial.MORE_GRIP)
"""Trials that change hardly anything: a cause has to stay the same."""


class Certainty(StrEnum):
    """How sure the cause of a failure is."""

    CERTAIN = "certain"
    LIKELY = "likely"
    DOUBTFUL = "doubtful"


@dataclass(frozen=True)
class TrialDrive:
    """A drive with one change."""

    trial: Trial
    outcome: Outcome
    kind: str
    """Name of the kind of cause, see `Kind`; empty if the drive passed or has no cause."""
    place: float | None
    """Place of the failure along the road, in m; None if the drive passed."""

    @property
    def passes(self) -> bool:
        """Whether the drive passed."""
        return self.outcome is Outcome.PASS


@dataclass(frozen=True)
class TriedFailure:
    """A failure that was driven again with one change at a time."""

    id: int
    """Id of the test."""
    kind: str
    """Name of the kind of its cause, see `Kind`."""
    place: float
    """Place of the failure along the road, in m."""
    is_shown: bool
    """Whether its evidence shows the mistake itself, see `shows_itself`."""
    drives: tuple[TrialDrive, ...]

    def passing(self) -> list[Trial]:
        """Return the changes with which the drive passes, without `REPEATS`."""
        return [drive.trial for drive in self.drives if drive.passes and drive.trial not in REPEATS]

    def failing(self) -> list[Trial]:
        """Return the changes with which the drive still fails, without `REPEATS`."""
        return [
            drive.trial
            for drive in self.drives
            if drive.outcome is Outcome.FAIL and drive.trial not in REPEATS
        ]

    def keeps_kind(self) -> bool:
        """Return whether each drive with hardly other grip that fails has the same cause."""
        repeats = [drive for drive in self.drives if drive.trial in REPEATS]
        return all(drive.kind == self.kind for drive in repeats if not drive.passes)

    def later(self, trial: Trial) -> float:
        """Return by how much later the car leaves with a change, in m; infinity if it passes.

        It is 0 if there is no such drive.
        """
        for drive in self.drives:
            if drive.trial is trial:
                return float("inf") if drive.place is None else drive.place - self.place
        return 0.0

    def certainty(self, share: float) -> Certainty:
        """Return how sure the cause is.

        Args:
            share: share of the campaign's failures that have this cause, 0 to 1.
        """
        rule = _RULES[Kind[self.kind]]
        if rule.contradicts(self):
            return Certainty.DOUBTFUL
        is_confirmed = rule.confirms(self) or (self.is_shown and share >= _FREQUENT)
        if is_confirmed and self.keeps_kind():
            return Certainty.CERTAIN
        return Certainty.LIKELY

    def as_text(self) -> str:
        """Return what the trials showed, such as "passes when it is 10 % slower; not with ..."."""
        passing, failing = self.passing(), self.failing()
        if Trial.SLOWER in passing and Trial.MUCH_SLOWER in passing:
            passing.remove(Trial.MUCH_SLOWER)
        if Trial.SLOWER in failing and Trial.MUCH_SLOWER in failing:
            failing.remove(Trial.SLOWER)
        named = [trial for trial in _RULES[Kind[self.kind]].named if trial in failing]
        if passing:
            text = f"passes {_joined(passing, 'or')}"
            return f"{text}; not {_joined(named, 'or')}" if named else text
        if not failing:
            return ""
        if not named:
            return f"fails in each of {len(self.failing())} trials"
        return f"fails also {_joined(named, 'and')}"

    def as_json(self) -> dict[str, JSONValue]:
        """Return the trials as a JSON object."""
        return {
            "test": self.id,
            "passes": [str(trial) for trial in self.passing()],
            "fails": [str(trial) for trial in self.failing()],
            "keeps_cause": self.keeps_kind(),
            "text": self.as_text(),
        }


def _joined(trials: Sequence[Trial], word: str) -> str:
    """Return changes in words, with a word before the last one."""
    *first, last = map(str, trials)
    return f"{', '.join(first)} {word} {last}" if first else last


def tried_failures(facts: Mapping[str, Any]) -> dict[int, TriedFailure]:
    """Return the tried failures among a campaign's facts, by the ids of their tests.

    Raises:
        CampaignError: the fact is damaged.
    """
    try:
        tried = convert(facts.get(CAUSE_TRIALS) or [], list[TriedFailure])
        return {failure.id: failure for failure in tried if failure.kind in Kind.__members__}
    except ValidationError as error:
        raise CampaignError(
            f"the fact {CAUSE_TRIALS} is damaged: {error}; repeat 'frenetic rerun --trials'"
        ) from None


_Test: TypeAlias = Callable[[TriedFailure], bool]


@dataclass(frozen=True)
class _Rule:
    """What trials say of a kind of cause."""

    confirms: _Test
    """Whether they confirm it."""
    contradicts: _Test
    """Whether they contradict it."""
    named: tuple[Trial, ...]
    """Changes that a text names also if the drive fails with them."""


def _any_passes(*trials: Trial) -> _Test:
    def test(failure: TriedFailure) -> bool:
        return any(trial in trials for trial in failure.passing())

    return test


def _none_passes(*trials: Trial) -> _Test:
    """Return a test whether drives with these changes were made, and all failed."""

    def test(failure: TriedFailure) -> bool:
        tried = [drive for drive in failure.drives if drive.trial in trials]
        return bool(tried) and not any(drive.passes for drive in tried)

    return test


def _more_steering_helps(failure: TriedFailure) -> bool:
    """Return whether the car leaves later with more steering, or earlier with less."""
    less, more = failure.later(Trial.LESS_STEERING), failure.later(Trial.MORE_STEERING)
    return more > less and (more >= _LATER or less <= -_LATER)


def _less_steering_helps(failure: TriedFailure) -> bool:
    less, more = failure.later(Trial.LESS_STEERING), failure.later(Trial.MORE_STEERING)
    return less >= _LATER and less > more


_SLOWER: Final = (Trial.SLOWER, Trial.MUCH_SLOWER)
_LATE_STEERING: Final = (
    *_SLOWER,
    Trial.EARLIER,
    Trial.FASTER_STEERING,
    Trial.NO_DELAY,
    Trial.NO_NOISE,
    Trial.NO_RATE_LIMIT,
    Trial.LESS_STEERING,
)
_OWN_LINE: Final = _Rule(
    _any_passes(),
    _any_passes(*_SLOWER, Trial.NO_PEDALS, Trial.MUCH_MORE_GRIP),
    (Trial.MUCH_SLOWER, Trial.MUCH_MORE_GRIP),
)
"""The driver steers where it should not, at any speed."""
_SHOWN: Final = _Rule(_any_passes(), _any_passes(), ())
"""The evidence alone decides."""
_RULES: Final[Mapping[Kind, _Rule]] = MappingProxyType(
    {
        Kind.STANDS: _SHOWN,
        Kind.SLOW: _SHOWN,
        Kind.BRAKES_LATE: _Rule(
            _any_passes(Trial.EARLIER, Trial.NO_PEDALS),
            _none_passes(Trial.EARLIER, Trial.NO_PEDALS),
            (Trial.EARLIER, Trial.NO_PEDALS),
        ),
        Kind.ACCELERATES: _Rule(
            _any_passes(Trial.NO_PEDALS), _none_passes(Trial.NO_PEDALS), (Trial.NO_PEDALS,)
        ),
        Kind.TOO_FAST: _Rule(_any_passes(*_SLOWER), _none_passes(*_SLOWER), _SLOWER),
        Kind.WRONG_WAY: _OWN_LINE,
        Kind.OSCILLATES: _Rule(
            _any_passes(*_LATE_STEERING),
            _any_passes(Trial.MORE_STEERING),
            (Trial.MUCH_SLOWER, Trial.FASTER_STEERING, Trial.LESS_STEERING),
        ),
        Kind.CUTS: _OWN_LINE,
        Kind.ASTRAY: _OWN_LINE,
        Kind.HELD: _Rule(_more_steering_helps, _less_steering_helps, _SLOWER),
        Kind.TOO_LITTLE: _Rule(_more_steering_helps, _less_steering_helps, (Trial.MORE_STEERING,)),
        Kind.SLOW_STEERING: _Rule(_any_passes(*_LATE_STEERING), _any_passes(), _SLOWER),
        Kind.BEYOND: _SHOWN,
        Kind.BOTH_PEDALS: _SHOWN,
        Kind.EXCEEDS: _SHOWN,
    }
)
"""Kind of cause -> its rule."""

SHOWN_KINDS: Final = frozenset(
    kind
    for kind in Kind
    if kind
    not in (Kind.OSCILLATES, Kind.BRAKES_LATE, Kind.TOO_FAST, Kind.ACCELERATES, Kind.TOO_LITTLE)
)
"""Kinds of cause whose evidence shows the mistake itself, so that no trial needs to confirm it."""


def shows_itself(kind: Kind, swings: Iterable[float]) -> bool:
    """Return whether the evidence of a cause shows the mistake itself.

    Of a driver that oscillates, the swings do if the last three are ever larger.

    Args:
        kind: kind of the cause.
        swings: swings about the lane's middle, in m, see `frenetic.segments.evidence.swings_of`.
    """
    if kind is not Kind.OSCILLATES:
        return kind in SHOWN_KINDS
    last = [abs(swing) for swing in swings][-3:]
    return len(last) == 3 and last[0] < last[1] < last[2]
