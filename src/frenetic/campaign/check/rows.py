"""The check of candidates and results: each row on its own, their order, budget and verdicts.

Rows are read by the declared columns of `frenetic.campaign.record`, a batch at a time. The rules
about several values of a row are here.
"""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.check.report import Facts, FindingCollector, Severity, Subject, Tables
from frenetic.campaign.record import (
    CANDIDATE_COLUMNS,
    CHECKSUM,
    EARLIER_COLUMNS,
    POSE,
    TEST_COLUMNS,
    RowError,
    Setting,
    TestRecord,
    checksum_fault,
    read_candidate,
    read_values,
    record_of,
)
from frenetic.campaign.trajectory_codec import decode
from frenetic.errors import CampaignError, RoadError
from frenetic.fingerprint import changed_packages
from frenetic.oracle import Result, judge
from frenetic.outcome import Outcome
from frenetic.road import Road, check_validity
from frenetic.simulators.drive import Drive, Rules, Trajectory
from frenetic.spec import Budget, is_number, shown

_BATCH: Final = 500  # rows read at once, so that no reader keeps a writer's log from being emptied
_OLD: Final[Mapping[str, str]] = {"attempts": "1"}
"""Values of columns that databases of older versions lack, unless it is NULL."""
_JUDGED: Final = ("moobd", "moobd_distance", "max_oob_share")
_DEPARTURE: Final = tuple(name for name in TEST_COLUMNS if name.startswith("departure_"))
_NEEDED: Final[Mapping[Outcome, tuple[str, ...]]] = {
    Outcome.PASS: (*POSE, *_JUDGED, "duration", "trajectory"),
    Outcome.FAIL: (*POSE, *_JUDGED, "duration", "trajectory"),
    Outcome.INVALID: (),
    Outcome.ERROR: (),
    Outcome.DROPPED: (),
}
_FORBIDDEN: Final[Mapping[Outcome, tuple[str, ...]]] = {
    Outcome.PASS: _DEPARTURE,
    Outcome.FAIL: (),
    Outcome.INVALID: (*_JUDGED, *_DEPARTURE, "duration", "trajectory"),
    Outcome.ERROR: (*_JUDGED, *_DEPARTURE),
    Outcome.DROPPED: (*POSE, *_JUDGED, *_DEPARTURE, "duration", "trajectory"),
}


def _selected(tables: Tables, table: str, columns: Iterable[str]) -> str:
    """Columns of a table for a SELECT, with its checksum, whatever version it is of."""
    here = tables.columns[table]
    return ", ".join(
        f"{table}.{name}" if name in here else f"{_OLD.get(name, 'NULL')} AS {name}"
        for name in (*columns, CHECKSUM)
    )


class _Checksums:
    """Compares the rows of a table with their checksums.

    Rows of before there were checksums have none; a row without one after one that has it has lost
    it.
    """

    def __init__(self) -> None:
        self._begun = False

    def fault(self, row: Sequence[Any]) -> str:
        """What is wrong with a row that ends with its checksum; empty if nothing is."""
        if row[-1] is None and self._begun:
            return "has lost its checksum"
        self._begun = row[-1] is not None
        return checksum_fault(row)


def _rows(
    connection: sqlite3.Connection, select: str, last: int, counter: int
) -> Iterator[Sequence[Any]]:
    """Rows of a SELECT after a number and up to another, which is in the column ``counter``."""
    done = 0
    while rows := connection.execute(f"{select} LIMIT {_BATCH}", (done, last)).fetchall():
        yield from rows
        done = rows[-1][counter]


# Candidates


def check_candidates(
    connection: sqlite3.Connection, tables: Tables, last: int, told: int, findings: FindingCollector
) -> None:
    """Checks each candidate on its own, and the order of asking.

    Args:
        connection: to the database.
        tables: its tables.
        last: id of the last candidate to check.
        told: number of results.
        findings: takes the findings.
    """
    select = f"""
        SELECT {_selected(tables, "candidate", CANDIDATE_COLUMNS)} FROM candidate
        WHERE id > ? AND id <= ? ORDER BY id
    """  # noqa: S608  # names of columns
    generations: dict[int, int] = {}
    checksums = _Checksums()
    before = asked_after = 0
    for row in _rows(connection, select, last, 0):
        number = row[0]
        name = f"candidate {number}"
        if number != before + 1:
            findings.add(Subject.ORDER, f"{_span(before + 1, number - 1)} missing")
        before = number
        values, faults = read_values(CANDIDATE_COLUMNS, row[:-1])
        for fault in faults:
            findings.add(Subject.CANDIDATE, f"{name}: the {fault.column} {fault.text}")
        if text := checksums.fault(row):
            findings.add(Subject.CANDIDATE, f"{name} {text}")
        if "parents" in values and "generation" in values:
            parents, generation = values["parents"], values["generation"]
            if unknown := [str(parent) for parent in parents if not 1 <= parent < number]:
                text = f"{name} has parents that were not asked before it: {', '.join(unknown)}"
                findings.add(Subject.ORDER, text)
            wanted = max((generations.get(parent, -1) + 1 for parent in parents), default=0)
            if generation != wanted and all(parent in generations for parent in parents):
                text = f"{name} is of generation {generation}, its parents make it {wanted}"
                findings.add(Subject.CANDIDATE, text)
            generations[number] = generation
        if "asked_after" in values:
            place = values["asked_after"]
            if place < asked_after:
                text = f"{name} was asked after {place} results, the one before it after"
                findings.add(Subject.ORDER, f"{text} {asked_after}")
            elif place > told:
                text = f"{name} was asked after {place} results, but there are {told}"
                findings.add(Subject.ORDER, text)
            asked_after = place


def _span(first: int, last: int) -> str:
    return f"candidate {first} is" if first == last else f"candidates {first} to {last} are"


# Results


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
    findings: FindingCollector,
    *,
    quick: bool,
    on_test: Callable[[int], None],
) -> Series:
    """Checks each result with its trajectory, and the order of telling.

    Args:
        connection: to the database.
        tables: its whole tables.
        last: number of telling of the last result to check.
        facts: facts of the database about the campaign.
        findings: takes the findings.
        quick: whether nothing is judged again.
        on_test: called after each result with their number so far.
    """
    # Each with its checksum.
    of_test, of_candidate = len(TEST_COLUMNS) + 1, len(CANDIDATE_COLUMNS) + 1
    select = f"""
        SELECT {_selected(tables, "test", TEST_COLUMNS)},
            {_selected(tables, "candidate", CANDIDATE_COLUMNS)},
            {_selected(tables, "trajectory", ("candidate_id", "data"))}
        FROM test
            LEFT JOIN candidate ON candidate.id = test.candidate_id
            LEFT JOIN trajectory ON trajectory.candidate_id = test.candidate_id
        WHERE told > ? AND told <= ? ORDER BY told
    """  # noqa: S608  # names of columns
    series = Series()
    told, elapsed = 0, 0.0
    asked_after = of_test + list(CANDIDATE_COLUMNS).index("asked_after")
    checksums, of_trajectories = _Checksums(), _Checksums()
    for row in _rows(connection, select, last, list(TEST_COLUMNS).index("told")):
        candidate, data = row[of_test : of_test + of_candidate - 1], row[-2]
        values, faults = read_values(TEST_COLUMNS, row[: of_test - 1])
        number, now = row[:2]
        name = f"test {number}"
        if now != told + 1:
            text = f"results are told as numbers {told} and then {now}, of {name}"
            findings.add(Subject.ORDER, text)
        told = now
        if isinstance(row[asked_after], int) and row[asked_after] >= now:
            text = f"{name} was told as number {now}, before it was asked, after"
            findings.add(Subject.ORDER, f"{text} {row[asked_after]} results")
        if values.get("elapsed") is not None:
            # The clock's rounding may cost a few nanoseconds where a campaign is resumed.
            if values["elapsed"] < elapsed - 1e-6:
                text = f"{name} was told at {values['elapsed']} s, the one before it at {elapsed} s"
                findings.add(Subject.ORDER, text)
            elapsed = values["elapsed"]
        texts = [f"the {fault.column} {fault.text}" for fault in faults]
        texts += _contradictions(values | {"trajectory": data}, facts.setting)
        for text in texts:
            findings.add(Subject.TEST, f"{name}: {text}")
        if text := checksums.fault(row[:of_test]):
            findings.add(Subject.TEST, f"{name} {text}")
        trajectory = _trajectory(number, data, findings)
        if data is not None and (text := of_trajectories.fault(row[-3:])):
            findings.add(Subject.TRAJECTORY, f"the trajectory of {name} {text}")
        if not texts and not quick:
            _judge_again(values, candidate, trajectory, facts, findings)
        series.ids.append(number)
        series.outcomes.append(Outcome(values["outcome"]) if "outcome" in values else None)
        series.spent.append(values.get("budget_spent", math.nan))
        series.elapsed.append(elapsed if values.get("elapsed") is not None else math.nan)
        on_test(len(series.ids))
    return series


def check_redrives(
    connection: sqlite3.Connection, tables: Tables, findings: FindingCollector
) -> None:
    """Compares the rows about roads that were screened or driven again with their checksums."""
    for table, changing, subject, name in (
        ("screening", (), Subject.CANDIDATE, "the screening of candidate {candidate_id}"),
        ("redrive_run", ("id", "ended_at"), Subject.REDRIVE, "run {id}"),
        ("redrive", (), Subject.REDRIVE, "drive {number} of run {run}, of test {test}"),
    ):
        if CHECKSUM not in tables.columns.get(table, ()):
            continue
        cursor = connection.execute(f"SELECT * FROM {table} ORDER BY rowid")  # noqa: S608
        names = [column[0] for column in cursor.description]
        for row in cursor:
            values = dict(zip(names, row, strict=True))
            stored = values.pop(CHECKSUM)
            checked = [value for one, value in values.items() if one not in changing]
            if text := checksum_fault([*checked, stored]):
                findings.add(subject, f"{name.format(**values)} {text}")


def check_earlier(
    connection: sqlite3.Connection, tables: Tables, findings: FindingCollector
) -> None:
    """Checks each test of an earlier campaign that this one started from."""
    if not tables.has("earlier"):
        return
    select = f"SELECT {_selected(tables, 'earlier', EARLIER_COLUMNS)} FROM earlier ORDER BY number"  # noqa: S608  # names of columns
    for row in connection.execute(select):
        name = f"earlier test {row[0]}"
        for fault in read_values(EARLIER_COLUMNS, row[:-1])[1]:
            findings.add(Subject.EARLIER, f"{name}: the {fault.column} {fault.text}")
        if text := checksum_fault(row):
            findings.add(Subject.EARLIER, f"{name} {text}")


def check_objectives(
    connection: sqlite3.Connection, tables: Tables, findings: FindingCollector
) -> None:
    """Checks the objective's value for each test that has one."""
    if not tables.has("objective"):
        return
    for row in connection.execute("SELECT candidate_id, value, checksum FROM objective"):
        if text := checksum_fault(row):
            findings.add(Subject.TEST, f"the objective of test {row[0]} {text}")
        elif not is_number(row[1]):
            findings.add(Subject.TEST, f"the objective of test {row[0]} is no finite number")


def _contradictions(values: Mapping[str, Any], setting: Setting | None) -> Iterator[str]:
    """Findings about values of a result that do not go together, of those that can be read."""
    missing = {name for name, value in values.items() if value is None}
    if 0 < len(missing & set(POSE)) < len(POSE):
        yield "only a part of its pose"
    if "outcome" not in values:
        return
    outcome = Outcome(values["outcome"])
    if outcome is not Outcome.DROPPED and values.get("attempts") == 0:
        yield "the attempts is 0: a whole number of at least 1 is needed"
    for column in _NEEDED[outcome]:
        if column in missing:
            yield f"{outcome} without {column}"
    for column in _FORBIDDEN[outcome]:
        if values.get(column) is not None:
            yield f"{outcome} with {column}"
    if outcome is Outcome.ERROR and ("duration" in missing) != ("trajectory" in missing):
        yield "ERROR with only one of duration and trajectory"
    if outcome is Outcome.FAIL:
        lacking = [column for column in _DEPARTURE if column in missing]
        yield from _departure_faults(lacking, values.get("max_oob_share"), setting)


def _departure_faults(
    lacking: Sequence[str], max_oob_share: float | None, setting: Setting | None
) -> Iterator[str]:
    """Checks that exactly the cars that were out further than tolerated left their lane."""
    if lacking and len(lacking) < len(_DEPARTURE):
        yield f"FAIL with a departure that lacks {', '.join(lacking)}"
    if setting is None or max_oob_share is None:
        return
    left = max_oob_share > setting.rules.oob_tolerance
    share = f"{max_oob_share:.1%} of the car outside its lane"
    if left and lacking:
        yield f"FAIL with {share}, but without {', '.join(lacking)}"
    if not left and not lacking:
        yield f"FAIL with a departure, but with {share} at most"


def _trajectory(number: int, data: object, findings: FindingCollector) -> Trajectory | None:
    """The trajectory; None if it is missing or unreadable."""
    if data is None:
        return None
    name = f"the trajectory of test {number}"
    if not isinstance(data, bytes):
        findings.add(Subject.TRAJECTORY, f"{name} is {shown(data)}: bytes are needed")
        return None
    try:
        trajectory = decode(data)
    except CampaignError as error:
        findings.add(Subject.TRAJECTORY, f"{name}: {error}")
        return None
    if len(trajectory) == 0:
        findings.add(Subject.TRAJECTORY, f"{name} has no records")
    elif (np.diff(trajectory.time) < 0.0).any():
        findings.add(Subject.TRAJECTORY, f"{name} goes back in time")
    return trajectory


def _judge_again(
    values: Mapping[str, Any],
    candidate_row: Sequence[Any],
    trajectory: Trajectory | None,
    facts: Facts,
    findings: FindingCollector,
) -> None:
    """Compares a result with the oracle's verdict on its drive, or the validity of its road."""
    try:
        candidate, _ = read_candidate(candidate_row)
        record = record_of(values, candidate, trajectory, facts.setting)
    except RowError:
        return  # found already, with the candidate
    setting = record.setting
    difference = ""
    if setting is not None and record.outcome.is_driven and trajectory is not None:
        difference = judged_otherwise(record, trajectory, setting)
    elif setting is not None and record.outcome is Outcome.INVALID:
        difference = refused_otherwise(record, setting)
    if not difference:
        return
    changed = changed_packages(facts.versions)
    text = f"test {record.id}: {difference}"
    if changed:
        text += f" (versions differ: {', '.join(changed)})"
    severity = Severity.WARNING if changed else Severity.ERROR
    findings.add(Subject.VERDICT, text, severity)


# Shares of the budget
#
# Each share follows from the results told by then, the campaign's time and the budget. A resumed
# campaign may have had several budgets, of which only the first and the last are known. So every
# share must be that of the first budget up to some result, and that of the last budget from some
# result on. Between these, where a campaign was extended and killed more than once, nothing is
# known.

_SAME: Final = 1e-9


def check_budget(series: Series, facts: Facts, ended: bool, findings: FindingCollector) -> None:
    """Checks the spent share of the budget in each result.

    Args:
        series: the results.
        facts: the campaign's budgets.
        ended: whether the campaign ended by itself with its last budget.
        findings: collects the findings.
    """
    first = facts.first_budget
    last = facts.last_budget or first
    if first is None or last is None or not series.ids:
        return
    spent = np.array(series.spent)
    by_first, by_last = _shares(first, series), _shares(last, series)
    is_first, is_last = _agrees(spent, by_first), _agrees(spent, by_last)
    count = len(spent)
    # A share of 1 fits every spent budget, so it does not tell which one it was.
    until = _last_true(is_first & (by_first < 1.0)) + 1
    after = np.flatnonzero(is_last & (by_last < 1.0) & (np.arange(count) >= until))
    if ended:
        start = int(after[0]) if len(after) else until
        end = count
    else:
        start, end = (int(after[0]), int(after[-1]) + 1) if len(after) else (count, count)
    for k in range(count):
        agrees = is_first[k] or (k >= until and is_last[k])
        known = k < until or start <= k < end
        if known and not agrees and not math.isnan(spent[k]):
            share = by_first[k] if k < until else by_last[k]
            findings.add(
                Subject.BUDGET,
                f"test {series.ids[k]}: budget_spent is {spent[k]:.6g},"
                f" but {share:.6g} of the budget was spent by then",
            )


def _shares(budget: Budget, series: Series) -> FloatArray:
    """Spent share of a budget at each result, (n,); NaN where the time is unknown."""
    free = (Outcome.INVALID, Outcome.DROPPED)
    simulations = np.cumsum([outcome not in free for outcome in series.outcomes])
    failures = np.cumsum([outcome is Outcome.FAIL for outcome in series.outcomes])
    shares = np.zeros(len(series.ids))
    for done, limit in (
        (simulations, budget.simulations),
        (np.array(series.elapsed), budget.time),
        (failures, budget.failures),
    ):
        if limit is not None:
            shares = np.maximum(shares, done / limit)
    return np.minimum(shares, 1.0)


def _agrees(spent: FloatArray, shares: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether shares are equal, or one of them is unknown."""
    return ~(np.abs(spent - shares) > _SAME)


def _last_true(flags: npt.NDArray[np.bool_]) -> int:
    """Index of the last True, -1 without one."""
    places = np.flatnonzero(flags)
    return int(places[-1]) if len(places) else -1


# Verdicts
#
# A stored trajectory is rounded, see `frenetic.campaign.trajectory_codec`, so its numbers differ a
# little from those of the drive. Rarely, this moves a record across the limit of a rule, and the
# drive ends a record earlier or later, or not at all. So a differing verdict is given again with
# every limit a little tighter and a little looser; the stored one must be among these.

MOOBD_TOLERANCE: Final = 1e-4
"""Largest difference of MOOBD, in m.

x and y are stored to within 0.05 mm each, which moves a car by at most 0.071 mm.
"""
SHARE_TOLERANCE: Final = 2e-4
"""Largest difference of oob shares: a point of the car's box moves by less than 0.1 mm."""
TIME_TOLERANCE: Final = 1e-4
"""Largest difference of times, in s; they are stored to within 0.05 ms."""
DISTANCE_TOLERANCE: Final = 1e-3
"""Largest difference along the road, in m: inside a bend a place moves further than the car."""


def judged_otherwise(record: TestRecord, trajectory: Trajectory, setting: Setting) -> str:
    """Difference of the verdict on a PASS or FAIL drive from the stored one.

    Empty if there is none beyond rounding.
    """
    try:
        road = record.road
    except RoadError as error:
        return f"it was driven, but its road is none: {error}"
    first = ""
    for rules in _rules(setting.rules):
        verdict = judge(road, Drive(trajectory, setting.car, rules))
        difference = _difference(record, verdict)
        if not difference:
            return ""
        first = first or difference
    return first


def _rules(rules: Rules) -> Iterator[Rules]:
    """The rules, then with every limit a little tighter, then a little looser."""
    yield rules
    for sign in (-1.0, 1.0):
        yield replace(
            rules,
            oob_tolerance=min(rules.oob_tolerance + sign * SHARE_TOLERANCE, 1.0),
            goal_distance=rules.goal_distance - sign * MOOBD_TOLERANCE,
            # Both ends of the car's movement are rounded.
            stuck_distance=rules.stuck_distance - 2.0 * sign * MOOBD_TOLERANCE,
            stuck_time=rules.stuck_time + sign * TIME_TOLERANCE,
            timeout_base=rules.timeout_base + sign * TIME_TOLERANCE,
        )


def _difference(record: TestRecord, verdict: Result) -> str:
    if verdict.outcome is not record.outcome:
        again = f"judged again it is {verdict.outcome}: {verdict.reason}"
        return f"it is stored as {record.outcome}, {again}"
    place = verdict.departure
    now: tuple[tuple[str, Any, float, str], ...] = (
        ("moobd", verdict.moobd, MOOBD_TOLERANCE, " m"),
        ("max_oob_share", verdict.max_oob_share, SHARE_TOLERANCE, ""),
        ("duration", verdict.duration, TIME_TOLERANCE, " s"),
        ("departure_time", place and place.time, TIME_TOLERANCE, " s"),
        ("departure_distance", place and place.distance, DISTANCE_TOLERANCE, " m"),
        ("departure_x", place and place.x, MOOBD_TOLERANCE, " m"),
        ("departure_y", place and place.y, MOOBD_TOLERANCE, " m"),
    )
    for column, value, tolerance, unit in now:
        stored = getattr(record, column)
        if stored is None and value is None:
            continue
        if stored is None or value is None or not abs(stored - value) <= tolerance:
            old, new = (_number(number, unit) for number in (stored, value))
            return f"{column} is stored as {old}, judged again it is {new}"
    if place is not None and place.side != record.departure_side:
        return f"it left to the {record.departure_side}, judged again to the {place.side}"
    return ""


def _number(value: float | None, unit: str) -> str:
    return "nothing" if value is None else f"{value:.6g}{unit}"


def refused_otherwise(record: TestRecord, setting: Setting) -> str:
    """Finding if a refused road is valid; otherwise empty."""
    try:
        if record.candidate.points is not None:
            verdict = check_validity(record.candidate.points, setting.map_size)
        else:
            candidate = record.candidate
            road = Road(candidate.curvatures, candidate.step, lane_width=setting.lane_width)
            _, verdict = road.placed(setting.map_size, setting.margin)
    except RoadError:
        return ""
    return "it is stored as INVALID, but its road is valid" if verdict.valid else ""
