"""Screening: a twin drives many roads, and the simulator of a campaign those that promise most.

A twin is a driver in a fast simulator that stands in for a slow one.

`frenetic.search.screened` says how they are chosen.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import msgspec
import numpy as np

from frenetic._support.json_value import JSONValue
from frenetic._support.statistics import a12, rank_correlation
from frenetic._support.words import counted
from frenetic.campaign.objective import Objective
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.profile import Profile
from frenetic.search.screened import NOTE, Screened
from frenetic.search.strategy import has_own
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign.store import CampaignStore
    from frenetic.search.strategy import Strategy


from typing import Final

from frenetic.campaign.objective import MOOBD, evaluate
from frenetic.campaign.tester import RoadTester
from frenetic.drive import Drive, Rules
from frenetic.oracle import Result, judge
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation

_LEAST_RANKED = 5  # controls from which on the twin's order is compared


def with_screen(spec: Spec, path: Path) -> Spec:
    """A spec whose roads the twin of a profile screens.

    Raises:
        FreneticError: the profile cannot be read, or is for other rules or another map.
    """
    profile = Profile.read(path)
    _check_terms(profile, spec, source=path)
    return replace(spec, screen={"file": str(path), "profile": msgspec.to_builtins(profile)})


def screened(spec: Spec) -> tuple[Screened, Twin]:
    """The strategy of a spec with a screen, and the twin that screens, not yet entered.

    Raises:
        FreneticError: the strategy cannot learn from roads of the twin, the search starts from
            earlier campaigns, the profile is damaged or for other rules, or a part cannot be made.
    """
    if spec.start_from:
        raise FreneticError("--screen and --from exclude each other: leave one of them out")
    source = spec.screen.get("file", "the campaign's profile")
    profile = Profile.of(spec.screen.get("profile"), source=source)
    _check_terms(profile, spec, source=source)
    strategy = spec.make_strategy()
    if not has_own(strategy, "replace"):
        raise FreneticError(
            "--screen needs a strategy that takes other roads than it asked for, as frenetic and"
            f" random do: {spec.strategy.name} has no method 'replace'"
        )
    seed = int(np.random.SeedSequence([spec.seed, 1]).generate_state(1)[0])
    scout: Strategy = replace(spec, seed=seed).make_strategy()
    of_twin = profile.over(Spec(), has_roads=False)
    twin = Twin.of(replace(of_twin, margin=spec.margin))
    objective = Objective.load(spec.objective)
    return Screened(strategy, scout, partial(twin.evaluation, objective=objective)), twin


def _check_terms(profile: Profile, spec: Spec, *, source: object) -> None:
    """Refuses a twin of other rules, another map or lane.

    Raises:
        FreneticError: it differs.
    """
    theirs = msgspec.structs.asdict(profile.terms)
    ours = {
        "speed_limit": spec.rules.speed_limit,
        "oob_tolerance": spec.rules.oob_tolerance,
        "map_size": spec.map_size,
        "lane_width": spec.lane_width,
    }
    differing = [
        f"{name.replace('_', ' ')} {theirs[name]:g}, not {ours[name]:g}"
        for name in ours
        if theirs[name] != ours[name]
    ]
    if differing:
        raise FreneticError(
            f"{source} is the profile of a twin for other terms ({'; '.join(differing)}): give the"
            " search the same, or calibrate a twin for them"
        )


class Screening(msgspec.Struct, frozen=True):
    """What a twin did on a candidate's road, see `frenetic.search.screened.NOTE`."""

    role: Literal["screened", "control"]
    drawn: int
    outcome: Outcome
    moobd: float | None = None


def _noted(notes: str) -> Screening | None:
    """The screening in a candidate's notes, None without."""
    note = msgspec.json.decode(notes).get(NOTE)
    return None if note is None else msgspec.convert(note, Screening)


@dataclass(frozen=True)
class ScreeningSummary:
    """What screening came to in a campaign."""

    screened: int = 0
    """Number of roads that only the twin drove, and of those handed on. They are no tests."""
    handed_on: int = 0
    """Number of them that were tested."""
    kept: int = 0
    """Number of these that failed."""
    controls: int = 0
    """Number of tests of roads that were not chosen by the twin."""
    controls_failed: int = 0
    auc: float | None = None
    """Chance that the twin's MOOBD tells a control that failed from one that passed; None if it
    cannot be said."""
    rank_correlation: float | None = None
    """Spearman's, of the twin's and the simulator's MOOBD on controls."""
    unscreened: int = 0
    """Number of candidates after screening had stopped."""

    @classmethod
    def of(cls, rows: Iterable[tuple[Screening | None, Outcome | None, float | None]]) -> Self:
        """The summary of candidates: screening, and outcome and MOOBD (m) if it was told."""
        drawn = unscreened = 0
        counts = {"screened": [0, 0], "control": [0, 0]}
        pairs: list[tuple[float, float, bool]] = []
        for screening, outcome, moobd in rows:
            if screening is None:
                unscreened += 1
                continue
            drawn += screening.drawn
            if outcome is None or not outcome.is_driven:
                continue
            count = counts[screening.role]
            has_failed = outcome is Outcome.FAIL
            count[0] += 1
            count[1] += has_failed
            is_control = screening.role == "control"
            if is_control and moobd is not None and screening.moobd is not None:
                pairs.append((screening.moobd, moobd, has_failed))
        auc, correlation = _trust(pairs)
        (handed_on, kept), (controls, controls_failed) = counts.values()
        return cls(
            drawn,
            handed_on,
            kept,
            controls,
            controls_failed,
            auc=auc,
            rank_correlation=correlation,
            unscreened=unscreened,
        )

    @classmethod
    def of_store(cls, store: CampaignStore) -> Self | None:
        """The summary of a campaign; None if it does not screen.

        Raises:
            CampaignError: the campaign is damaged.
        """
        if not store.config.get("screen"):
            return None
        rows = store.rows("SELECT notes, outcome, moobd FROM test ORDER BY id")
        try:
            return cls.of(
                (_noted(notes), None if outcome is None else Outcome(outcome), moobd)
                for notes, outcome, moobd in rows
            )
        except ValueError as error:
            raise CampaignError(f"{store.folder} is damaged: a screening: {error}") from None

    def as_json(self) -> dict[str, JSONValue]:
        """The summary as a JSON object."""
        return asdict(self) | {"stopped": bool(self.stopped)}

    def in_words(self) -> str:
        """The summary in a line."""
        text = (
            f"{counted(self.screened, 'road')} screened, {self.handed_on} handed on, {self.kept}"
            f" failed as promised; {self.controls_failed} of {counted(self.controls, 'control')}"
            " failed"
        )
        if self.rank_correlation is not None:
            text += f", where the twin's rank correlation is {self.rank_correlation:.2f}"
        if self.auc is not None:
            text += f" and its AUC {self.auc:.2f}"
        return f"{text}; stopped" if self.stopped else text

    @property
    def stopped(self) -> str:
        """Why screening is over, in a sentence; empty while it is not."""
        if not self.unscreened:
            return ""
        return (
            "Screening was stopped, since the twin misleads here:"
            f" {counted(self.unscreened, 'road')} came without it."
        )


def _trust(pairs: list[tuple[float, float, bool]]) -> tuple[float | None, float | None]:
    """AUC and rank correlation of (twin's MOOBD, MOOBD, failed); None where it says nothing."""
    if len(pairs) < _LEAST_RANKED:
        return None, None
    correlation = rank_correlation([pair[0] for pair in pairs], [pair[1] for pair in pairs])
    passed, failed = ([pair[0] for pair in pairs if pair[2] is one] for one in (False, True))
    return a12(passed, failed) if passed and failed else None, correlation


def screen_text(config: Mapping[str, Any]) -> str:
    """The twin that screens, in a few words; empty without."""
    screen = config.get("screen")
    if not isinstance(screen, Mapping) or not isinstance(screen.get("profile"), Mapping):
        return ""
    profile: Mapping[str, Any] = screen["profile"]
    return f"twin {profile.get('name')}, {profile.get('driver')}, from {screen.get('file')}"


_WHOLE: Final = 0.999
"""Oob tolerance with which a drive ends when the whole car has left its lane."""


@dataclass(frozen=True)
class Twin:
    """A driver in a fast simulator, which drives on where the rules end a drive.

    A context manager: within it, its simulator is there.
    """

    tester: RoadTester
    rules: Rules
    """The rules by which its drives are judged."""

    @classmethod
    def of(cls, spec: Spec) -> Self:
        """The twin of a spec.

        Raises:
            FreneticError: driver or simulator cannot be made.
        """
        tolerance = max(_WHOLE, spec.rules.oob_tolerance)
        to_the_end = replace(spec, rules=replace(spec.rules, oob_tolerance=tolerance))
        driver, simulator = to_the_end.make_parts(isolate=True)
        tester = RoadTester(simulator, driver, spec.map_size, spec.margin, spec.lane_width)
        return cls(tester, spec.rules)

    def __enter__(self) -> Self:
        """Starts the simulator."""
        self.tester.simulator.__enter__()
        return self

    def __exit__(self, *raised: Any) -> None:
        """Ends the simulator."""
        self.tester.simulator.__exit__(*raised)

    def placed(self, road: Road) -> tuple[Road | None, str]:
        """A road in its place on the map; None and the reason if it is INVALID."""
        fitted, verdict = road.placed(self.tester.map_size, self.tester.margin)
        if fitted is None or not verdict.valid:
            return None, verdict.message
        return fitted, ""

    def drive(self, road: Road) -> tuple[Drive, Result]:
        """The whole drive along a road in its place, and the verdict by the rules."""
        drive = self.tester.drive(road)
        return drive, judge(road, replace(drive, rules=self.rules))

    def evaluation(
        self, candidate: Candidate, budget_spent: float, objective: str | Objective = MOOBD
    ) -> Evaluation:
        """The evaluation of a candidate, as a strategy is told it."""
        road, verdict = self.tester.fitted(candidate)
        if road is None or not verdict.valid:
            return Evaluation(candidate, Outcome.INVALID, None, budget_spent)
        drive = replace(self.tester.drive(road), rules=self.rules)
        return evaluate(candidate, road, drive, budget_spent=budget_spent, objective=objective)
