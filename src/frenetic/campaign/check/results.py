"""The check of the results, each on its own and in their order."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, get_args

import numpy as np

from frenetic.campaign.check.database import Facts, Setting, Tables, is_moment
from frenetic.campaign.check.findings import Findings, Severity, Subject
from frenetic.campaign.check.rows import ResultRow, result_rows
from frenetic.campaign.check.verdicts import judged_otherwise, refused_otherwise
from frenetic.campaign.trajectory_codec import decode
from frenetic.campaign.versions import package_versions
from frenetic.errors import CampaignError
from frenetic.oracle import Side
from frenetic.outcome import Outcome
from frenetic.simulators.drive import Trajectory
from frenetic.spec import is_number, shown

_POSE: Final = ("x", "y", "heading")
_JUDGED: Final = ("moobd", "moobd_distance", "max_oob_share")
_DEPARTURE: Final = (
    "departure_time",
    "departure_distance",
    "departure_x",
    "departure_y",
    "departure_side",
)
_REALS: Final = (*_POSE, *_JUDGED, *_DEPARTURE[:4], "duration", "elapsed")
_NEEDED_REALS: Final = ("budget_spent", "seconds")
_NOT_NEGATIVE: Final = (
    "max_oob_share",
    "departure_time",
    "duration",
    "elapsed",
    "budget_spent",
    "seconds",
)
_SHARES: Final = ("max_oob_share", "budget_spent")

_NEEDED: Final[Mapping[Outcome, tuple[str, ...]]] = {
    Outcome.PASS: (*_POSE, *_JUDGED, "duration", "trajectory"),
    Outcome.FAIL: (*_POSE, *_JUDGED, "duration", "trajectory"),
    Outcome.INVALID: (),
    Outcome.ERROR: (),
    Outcome.DROPPED: (),
}
_FORBIDDEN: Final[Mapping[Outcome, tuple[str, ...]]] = {
    Outcome.PASS: _DEPARTURE,
    Outcome.FAIL: (),
    Outcome.INVALID: (*_JUDGED, *_DEPARTURE, "duration", "trajectory"),
    Outcome.ERROR: (*_JUDGED, *_DEPARTURE),
    Outcome.DROPPED: (*_POSE, *_JUDGED, *_DEPARTURE, "duration", "trajectory"),
}


@dataclass
class Series:
    """Values of all results that are checked together, in the order of telling."""

    ids: list[int] = field(default_factory=list)
    """Ids of the candidates."""
    outcomes: list[Outcome | None] = field(default_factory=list)
    """Outcomes, None for an unknown one."""
    spent: list[float] = field(default_factory=list)
    """Shares of the budget; NaN where it is no number, as for the next."""
    elapsed: list[float] = field(default_factory=list)
    """Campaign time, in s."""


def check_results(
    connection: sqlite3.Connection,
    tables: Tables,
    last: int,
    facts: Facts,
    findings: Findings,
    *,
    quick: bool,
    on_test: Callable[[int], None],
) -> Series:
    """Checks each result with its trajectory, and the order of telling.

    Args:
        connection: to the database.
        tables: its complete tables.
        last: last number of telling to check.
        facts: of the database about the campaign.
        findings: collects the findings.
        quick: whether to skip judging again.
        on_test: called after each result with their number so far.
    """
    series = Series()
    told, elapsed = 0, 0.0
    for row in result_rows(connection, tables, last):
        name = f"test {row.candidate_id}"
        if row.told != told + 1:
            text = f"results are told as numbers {told} and then {row.told}, of {name}"
            findings.add(Subject.ORDER, text)
        told = row.told
        if isinstance(row.asked_after, int) and row.asked_after >= row.told:
            text = f"{name} was told as number {row.told}, before it was asked, after"
            findings.add(Subject.ORDER, f"{text} {row.asked_after} results")
        if is_number(row.elapsed):
            # The clock's rounding may cost a few nanoseconds where a campaign is resumed.
            if row.elapsed < elapsed - 1e-6:
                text = f"{name} was told at {row.elapsed} s, the one before it at {elapsed} s"
                findings.add(Subject.ORDER, text)
            elapsed = row.elapsed
        outcome = _outcome(row.outcome)
        faults = list(_faults(row, outcome, facts.setting))
        for fault in faults:
            findings.add(Subject.TEST, f"{name}: {fault}")
        trajectory = _trajectory(row, findings)
        if outcome is not None and not faults and not quick and facts.setting is not None:
            _judge_again(row, outcome, trajectory, facts, facts.setting, findings)
        series.ids.append(row.candidate_id)
        series.outcomes.append(outcome)
        series.spent.append(row.budget_spent if is_number(row.budget_spent) else math.nan)
        series.elapsed.append(row.elapsed if is_number(row.elapsed) else math.nan)
        on_test(len(series.ids))
    return series


def _outcome(value: object) -> Outcome | None:
    return next((outcome for outcome in Outcome if outcome == value), None)


def _faults(row: ResultRow, outcome: Outcome | None, setting: Setting | None) -> Iterator[str]:
    """Findings about a result on its own."""
    if outcome is None:
        yield f"the outcome is {shown(row.outcome)}: one of {', '.join(Outcome)} is needed"
    if not isinstance(row.reason, str):
        yield f"the reason is {shown(row.reason)}: a text is needed"
    if not is_moment(row.finished_at):
        yield f"finished_at is {shown(row.finished_at)}: a date and time is needed"
    if not isinstance(row.worker, str | None):
        yield f"the worker is {shown(row.worker)}: a text is needed"
    if row.departure_side not in (None, *get_args(Side)):
        yield f"departure_side is {shown(row.departure_side)}: left or right is needed"
    least = 0 if outcome in (None, Outcome.DROPPED) else 1
    if not isinstance(row.attempts, int) or row.attempts < least:
        yield f"attempts is {shown(row.attempts)}: a whole number of at least {least} is needed"
    yield from _number_faults(row)
    if outcome is None:
        return
    for column in _NEEDED[outcome]:
        if getattr(row, column) is None:
            yield f"{outcome} without {column}"
    for column in _FORBIDDEN[outcome]:
        if getattr(row, column) is not None:
            yield f"{outcome} with {column}"
    if outcome is Outcome.ERROR and (row.duration is None) != (row.trajectory is None):
        yield "ERROR with only one of duration and trajectory"
    if outcome is Outcome.FAIL:
        yield from _departure_faults(row, setting)


def _number_faults(row: ResultRow) -> Iterator[str]:
    for column in (*_REALS, *_NEEDED_REALS):
        value = getattr(row, column)
        if value is None and column not in _NEEDED_REALS:
            continue
        if not is_number(value):
            yield f"{column} is {shown(value)}: a finite number is needed"
        elif value < 0.0 and column in _NOT_NEGATIVE:
            yield f"{column} is {value}: a number of at least 0 is needed"
        elif value > 1.0 and column in _SHARES:
            yield f"{column} is {value}: a share of at most 1 is needed"
    if len({getattr(row, column) is None for column in _POSE}) > 1:
        yield "only a part of its pose"


def _departure_faults(row: ResultRow, setting: Setting | None) -> Iterator[str]:
    """Checks that exactly the cars that were out further than tolerated left their lane."""
    missing = [column for column in _DEPARTURE if getattr(row, column) is None]
    if missing and len(missing) < len(_DEPARTURE):
        yield f"FAIL with a departure that lacks {', '.join(missing)}"
    if setting is None or not is_number(row.max_oob_share):
        return
    left = row.max_oob_share > setting.rules.oob_tolerance
    share = f"{row.max_oob_share:.1%} of the car outside its lane"
    if left and missing:
        yield f"FAIL with {share}, but without {', '.join(missing)}"
    if not left and not missing:
        yield f"FAIL with a departure, but with {share} at most"


def _trajectory(row: ResultRow, findings: Findings) -> Trajectory | None:
    """The trajectory; None if it is missing or unreadable."""
    if row.trajectory is None:
        return None
    name = f"the trajectory of test {row.candidate_id}"
    if not isinstance(row.trajectory, bytes):
        findings.add(Subject.TRAJECTORY, f"{name} is {shown(row.trajectory)}: bytes are needed")
        return None
    try:
        trajectory = decode(row.trajectory)
    except CampaignError as error:
        findings.add(Subject.TRAJECTORY, f"{name}: {error}")
        return None
    if len(trajectory) == 0:
        findings.add(Subject.TRAJECTORY, f"{name} has no records")
    elif (np.diff(trajectory.time) < 0.0).any():
        findings.add(Subject.TRAJECTORY, f"{name} goes back in time")
    return trajectory


def _judge_again(
    row: ResultRow,
    outcome: Outcome,
    trajectory: Trajectory | None,
    facts: Facts,
    setting: Setting,
    findings: Findings,
) -> None:
    """Compares a result with the oracle's verdict on its drive, or the validity of its road."""
    if not is_number(row.step) or not isinstance(row.curvatures, bytes) or len(row.curvatures) % 8:
        return  # found already
    if row.points is not None and (not isinstance(row.points, bytes) or len(row.points) % 16):
        return  # this, too
    difference = ""
    if outcome.is_driven and trajectory is not None:
        difference = judged_otherwise(row, outcome, trajectory, setting)
    elif outcome is Outcome.INVALID:
        difference = refused_otherwise(row, setting)
    if not difference:
        return
    theirs, ours = facts.versions, package_versions()
    changed = [f"{k} {v}, now {ours.get(k)}" for k, v in theirs.items() if ours.get(k) != v]
    text = f"test {row.candidate_id}: {difference}"
    if changed:
        text += f" (versions differ: {', '.join(changed)})"
    severity = Severity.WARNING if changed else Severity.ERROR
    findings.add(Subject.VERDICT, text, severity)
