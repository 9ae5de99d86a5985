"""Reading a campaign's database: facts, tests, candidates, trajectories and counts."""

from __future__ import annotations

import operator
import sqlite3
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias, TypeVar

from msgspec import convert

from frenetic._support.json_value import JSONValue
from frenetic._support.notebook import NotebookRepr
from frenetic._support.outside_text import read_json
from frenetic.campaign.columns import read_candidate, read_segment, read_test
from frenetic.campaign.counts import Counts, FirstTests, road_key
from frenetic.campaign.database import (
    DATABASE,
    EARLIER_TESTS,
    TESTS,
    Tables,
    comma_list,
    errors_about,
    select_segments,
)
from frenetic.campaign.record import Test
from frenetic.campaign.trajectory_codec import decode
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.road import LANE_WIDTH, profile
from frenetic.search.records import Candidate
from frenetic.segments.values import SegmentValues
from frenetic.spec.terms import DriveSetting

EARLIER_SETTINGS: Final = "earlier_settings"
"""Name of the fact with the settings of the campaigns from which a search starts, by folder."""
SOURCES: Final = "sources"
"""Name of the fact with the sources of the user's own parts: name of a file -> its text."""
STARTED_IN: Final = "started_in"
"""Name of the fact with the folder from which a campaign was started, where its parts are found."""
SIGNATURE: Final = "signature"
"""Name of the fact with the user's signature of the code, its folder and its sources."""
Order: TypeAlias = Literal["result_number", "moobd"]

_Value = TypeVar("_Value")
_OUTCOMES: Final = {str(outcome): outcome for outcome in Outcome}
_BATCH: Final = 500
"""Number of tests that one SELECT reads (our choice)."""
_UNLISTED_FACTS: Final = (
    "config",
    EARLIER_SETTINGS,
    SOURCES,
    STARTED_IN,
    SIGNATURE,
)
"""Names of facts that `CampaignReader.facts` leaves out: they are large or shown elsewhere."""
_SELECT_ROADS: Final = (
    "SELECT id, outcome, distance, duration, conditions, step, curvatures, points,"  # noqa: S608
    f" {comma_list(profile.NAMES)} FROM test"
    " WHERE result_number IS NOT NULL AND outcome <> 'DROPPED' ORDER BY result_number"
)
_ORDER_CLAUSES: Final[Mapping[Order, str]] = {
    "result_number": "result_number",
    "moobd": "moobd IS NULL, moobd, result_number",
}


class CampaignReader(NotebookRepr):
    """The part of a `CampaignStore` that reads.

    Each read first calls `write`, so it sees the rows that waited to be written.

    Args:
        folder: folder of the campaign.
        connection: connection to the campaign's database.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self.folder = folder
        """The campaign's folder."""
        self._path = folder / DATABASE
        self._connection = connection
        # What was computed from all tests, by name, and the version of the database then.
        self._computed: dict[str, Any] = {}
        self._computed_version: tuple[int, int] | None = None
        config = self.fact("config")
        if not isinstance(config, dict):
            raise self._damaged("the config is no JSON object")
        self.config: Mapping[str, JSONValue] = MappingProxyType(config)
        """The campaign's configuration."""
        try:
            self._setting: DriveSetting | str = DriveSetting.of(config)
        except ValueError as error:  # raised when the setting is read
            self._setting = str(error)

    def write(self) -> None:
        """Store the rows that wait; a store that was opened for reading has none."""

    def at_a_glance(self) -> str:
        """Return the folder and the results: ``campaigns/night: 70 PASS, 12 FAIL``."""
        counts = [f"{number} {outcome}" for outcome, number in self.by_outcome().items() if number]
        return f"{self.folder}: {', '.join(counts) or 'no results'}"

    # Facts

    @property
    def setting(self) -> DriveSetting:
        """The setting of the campaign's drives.

        Raises:
            CampaignError: the configuration lacks the setting.
        """
        if isinstance(self._setting, str):
            raise self._damaged(f"its configuration: {self._setting}")
        return self._setting

    @property
    def _known_setting(self) -> DriveSetting | None:
        """The setting of the campaign's drives; None where the configuration lacks it."""
        return None if isinstance(self._setting, str) else self._setting

    @property
    def lane_width(self) -> float:
        """Width of each lane, in m; `LANE_WIDTH` where the configuration lacks the setting."""
        return LANE_WIDTH if isinstance(self._setting, str) else self._setting.lane_width

    @property
    def facts(self) -> Mapping[str, JSONValue]:
        """Facts beside the configuration: ``created_at`` and the facts that `finish` added."""
        names = [name for (name,) in self._select("SELECT name FROM fact ORDER BY name")]
        return MappingProxyType(
            {name: self.fact(name) for name in names if name not in _UNLISTED_FACTS}
        )

    def fact(self, name: str) -> JSONValue:
        """Return a fact by its name; None if there is no such fact.

        Raises:
            CampaignError: the fact is damaged.
        """
        for (text,) in self._select("SELECT value FROM fact WHERE name = ?", (name,)):
            try:
                value: JSONValue = read_json(text)
            except ValueError as error:
                raise self._damaged(f"the fact {name} is not JSON: {error}") from None
            return value
        return None

    # Tests and candidates

    def tests(
        self,
        outcome: Outcome | None = None,
        order_by: Order = "result_number",
        limit: int | None = None,
        with_trajectory: bool | Container[int] = False,
        *,
        with_repeats: bool = True,
        with_segments: bool | Container[int] = False,
    ) -> Iterator[Test]:
        """Yield the tests that are stored at this moment; later tests do not show up.

        Args:
            outcome: outcome of the tests to yield; None for all.
            order_by: ``result_number`` for the order of results, or ``moobd``: lowest first,
                tests without a MOOBD last.
            limit: most tests.
            with_trajectory: whether to read the tests' trajectories; or the ids of the tests whose
                trajectories to read.
            with_repeats: whether to yield tests that repeat an earlier test, too, see `repeats`;
                measures leave them out.
            with_segments: whether to read the values of the tests' segments; or the ids of the
                tests whose values to read. Of a test whose values are not stored, the trajectory
                is read, from which they follow.

        Raises:
            CampaignError: a test is damaged or missing.
        """
        condition = "" if outcome is None else f"AND outcome = '{Outcome(outcome)}'"
        self.write()
        # A stored test never changes, so the ids alone are a snapshot: no transaction has to stay
        # open between two tests.
        repeats = frozenset[int]() if with_repeats else self.repeats()
        most = -1 if limit is None else limit + len(repeats)  # SQLite takes -1 as no limit
        ids = self._ids(
            f"SELECT id FROM test WHERE result_number IS NOT NULL {condition}"  # noqa: S608
            f" ORDER BY {_ORDER_CLAUSES[order_by]} LIMIT {most:d}"
        )
        ids = [number for number in ids if number not in repeats][:limit]
        return (
            test
            for start in range(0, len(ids), _BATCH)
            for test in self._read(
                ids[start : start + _BATCH], with_trajectory, with_segments=with_segments
            )
        )

    def _ids(self, select: str) -> list[int]:
        return [number for (number,) in self._select(select)]

    def test(self, id: int, with_trajectory: bool = True) -> Test:  # noqa: A002
        """Return the test of the candidate with this id.

        Raises:
            CampaignError: no test has this id (the message names the existing ids), or the test is
                damaged.
        """
        number = self._existing_id(id, "test of candidate", "result_number IS NOT NULL")
        return self._read([number], with_trajectory)[0]

    def trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """Return the trajectory of the candidate with this id; None if nothing was driven.

        Raises:
            CampaignError: the trajectory is damaged.
        """
        self.write()
        return self._trajectory(operator.index(id), TESTS)

    def _trajectory(self, number: int, tables: Tables) -> Trajectory | None:
        select = f"SELECT records, trajectory FROM {tables.test} WHERE id = ?"  # noqa: S608
        for records, packed in self._select(select, (number,)):
            if packed is not None:
                with self._reading(f"the trajectory of {tables.label} {number}"):
                    return decode(packed)
            if records is not None:
                raise self._damaged(f"the trajectory of {tables.label} {number} is gone")
        return None

    def tests_with_ids(self, ids: Sequence[int], *, with_trajectory: bool = False) -> list[Test]:
        """Return the tests with these ids, at most some hundreds, with the values of segments.

        Raises:
            CampaignError: a test is damaged or missing.
        """
        self.write()
        return self._read(ids, with_trajectory, with_segments=True)

    def earlier(self) -> list[Test]:
        """Return the tests of other campaigns, and the real roads, from which the search starts.

        The tests are numbered from 1 and lack trajectories. Each has the setting of the campaign
        that drove it.

        Raises:
            CampaignError: a test is damaged or missing.
        """
        with self._reading("the settings of the campaigns that it started from"):
            settings = convert(self.fact(EARLIER_SETTINGS) or {}, dict[str, DriveSetting])
        ids = self._ids(f"SELECT id FROM {EARLIER_TESTS.test} ORDER BY id")  # noqa: S608
        return [
            replace(test, setting=settings.get(test.candidate.source.campaign))
            if test.candidate.source is not None
            else test
            for start in range(0, len(ids), _BATCH)
            for test in self._read(ids[start : start + _BATCH], tables=EARLIER_TESTS)
        ]

    def earlier_trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """Return the trajectory of an `earlier` test; None for a real road.

        Raises:
            CampaignError: the trajectory is damaged.
        """
        return self._trajectory(id, EARLIER_TESTS)

    def candidate(self, id: int) -> Candidate:  # noqa: A002
        """Return the candidate with this id, whether it has a result or not.

        Raises:
            CampaignError: no candidate has this id (the message names the existing ids), or the
                candidate is damaged.
        """
        return self._read_candidates([self._existing_id(id, "candidate", "true")])[0]

    def candidates(self) -> Iterator[tuple[Candidate, int]]:
        """Yield all candidates in the order of asking, each with the number of results before it.

        Raises:
            CampaignError: a candidate is damaged or missing.
        """
        self.write()
        results_before = dict(self._select("SELECT id, asked_after FROM test ORDER BY id"))
        ids = list(results_before)
        return (
            (candidate, results_before[candidate.id])
            for start in range(0, len(ids), _BATCH)
            for candidate in self._read_candidates(ids[start : start + _BATCH])
        )

    def _read(
        self,
        ids: Sequence[int],
        with_trajectory: bool | Container[int] = False,
        tables: Tables = TESTS,
        *,
        with_segments: bool | Container[int] = False,
    ) -> list[Test]:
        """Return the tests with these ids, in the order of the ids."""
        with_path = ids if with_trajectory is True else with_trajectory or ()
        with_values = ids if with_segments is True else with_segments or ()
        segments = self._segments([number for number in ids if number in with_values])
        setting = self._known_setting
        findings: dict[int, list[Sequence[Any]]] = {}
        for number, *values in self._select(tables.select_findings(len(ids)), ids):
            findings.setdefault(number, []).append(values)
        tests = []
        for row in self._rows(ids, tables):
            stored_values = segments.get(row[0])
            needs_path = row[0] in with_path or (row[0] in with_values and stored_values is None)
            path = self._trajectory(row[0], tables) if needs_path else None
            with self._reading(f"{tables.label} {row[0]}"):
                tests.append(read_test(row, findings.get(row[0], ()), path, setting, stored_values))
        return tests

    def _segments(self, ids: Sequence[int]) -> dict[int, SegmentValues]:
        """Return the stored values of the segments of these tests, by id."""
        segments: dict[int, SegmentValues] = {}
        rows = self._select(select_segments(len(ids)), ids) if ids else []
        for number, *row in rows:
            with self._reading(f"test {number}"):
                segments[number] = read_segment(row)
        return segments

    def _read_candidates(self, ids: Sequence[int]) -> list[Candidate]:
        candidates = []
        for row in self._rows(ids):
            with self._reading(f"candidate {row[0]}"):
                candidates.append(read_candidate(row))
        return candidates

    def _rows(self, ids: Sequence[int], tables: Tables = TESTS) -> list[tuple[Any, ...]]:
        """Return the rows of the candidates with these ids, in the order of the ids.

        Raises:
            CampaignError: a row is missing.
        """
        rows = {row[0]: row for row in self._select(tables.select(len(ids)), ids)}
        for number in ids:
            if number not in rows:
                raise self._damaged(f"candidate {number} is missing")
        return [rows[number] for number in ids]

    def by_outcome(self) -> dict[Outcome, int]:
        """Return the number of results per outcome; every outcome is present."""
        return dict(self._count_by_outcome()[0])

    def counts(self) -> Counts:
        """Return the numbers of tests per outcome and of different roads, and the lowest MOOBD.

        It reads the roads of all tests: where the numbers per outcome are enough, `by_outcome` is
        faster.

        Raises:
            CampaignError: a test is damaged.
        """
        return replace(self._counts_and_repeats()[0])

    def repeats(self) -> frozenset[int]:
        """Return the ids of the tests that repeat an earlier test.

        `frenetic.campaign.counts.FirstTests` says what a repeat is. The roads of all tests are
        read, and read again only after further results.

        Raises:
            CampaignError: a test is damaged.
        """
        return self._counts_and_repeats()[1]

    def _counts_and_repeats(self) -> tuple[Counts, frozenset[int]]:
        """Return the counts of all tests, and the ids of the tests that repeat an earlier one."""
        return self._once("counts", self._read_counts_and_repeats)

    def _read_counts_and_repeats(self) -> tuple[Counts, frozenset[int]]:
        counts = Counts.of(*self._count_by_outcome())
        roads, first_tests, repeats = set(), FirstTests(), []
        number = None
        try:
            for number, outcome, *values in self.rows(_SELECT_ROADS):
                distance, duration, conditions, step, curvatures, points, *profiles = values
                road, result = road_key(step, curvatures, points), _OUTCOMES[outcome]
                counts.add_drive(distance, duration)
                amounts = {} if conditions == "{}" else dict(read_json(conditions))
                roads.add(road)
                if not first_tests.add_key(result, road, amounts, profiles):
                    repeats.append(number)
                    counts.add_repeat(result)
        except (KeyError, TypeError, ValueError) as error:
            raise self._damaged(f"test {number}: {error}") from None
        counts.roads = len(roads)
        return counts, frozenset(repeats)

    def _count_by_outcome(self) -> tuple[dict[Outcome, int], float | None]:
        """Return the number of results per outcome, and the lowest MOOBD in m."""
        return self._once("by_outcome", self._read_count_by_outcome)

    def _read_count_by_outcome(self) -> tuple[dict[Outcome, int], float | None]:
        rows = self._select(
            "SELECT outcome, count(*), min(moobd) FROM test WHERE result_number IS NOT NULL"
            " GROUP BY outcome"
        )
        by_outcome = dict.fromkeys(Outcome, 0)
        with self._reading("the outcome of a test"):
            by_outcome |= {Outcome(outcome): count for outcome, count, _ in rows}
        return by_outcome, min((moobd for *_, moobd in rows if moobd is not None), default=None)

    def _once(self, name: str, compute: Callable[[], _Value]) -> _Value:
        """Return a value that is computed from all tests, anew only after the database changed."""
        self.write()
        # The first number changes when another connection writes, the second when this one does.
        ((others,),) = self._select("PRAGMA data_version")
        version = int(others), self._connection.total_changes
        if version != self._computed_version:
            self._computed, self._computed_version = {}, version
        if name not in self._computed:
            self._computed[name] = compute()
        value: _Value = self._computed[name]
        return value

    def stored(self) -> int:
        """Return the number of results on disk, without those that wait; 0 if it is unreadable."""
        with suppress(CampaignError):
            ((number,),) = self._select("SELECT count(result_number) FROM test")
            return int(number)
        return 0

    def elapsed(self) -> float:
        """Return the time of the campaign at its last result, in s."""
        self.write()
        ((seconds,),) = self._select("SELECT coalesce(max(elapsed), 0.0) FROM test")
        return float(seconds)

    def rows(self, select: str, parameters: Sequence[object] = ()) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a SELECT, for reading many tests at once.

        The rows are not checked, and may include results that were stored after the call.
        """
        self.write()
        with errors_about(self._path):
            yield from self._connection.execute(select, tuple(parameters))

    def _select(self, select: str, parameters: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        with errors_about(self._path):
            return self._connection.execute(select, tuple(parameters)).fetchall()

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        """Turn the faults of a value into a `CampaignError` that names it."""
        try:
            yield
        except (TypeError, ValueError, CampaignError) as error:
            raise self._damaged(f"{name}: {error}") from None

    def _existing_id(self, id: int, kind: str, where: str) -> int:  # noqa: A002
        """Return an id as a whole number of Python's, if the database holds it.

        Args:
            id: id to look up.
            kind: word for the row in messages.
            where: SQL's condition that the row has to meet.

        Raises:
            CampaignError: the database holds no such id.
        """
        self.write()
        number = operator.index(id)  # also of a whole number of numpy's
        select = f"SELECT count(*) FROM test WHERE {where} AND id = ?"  # noqa: S608
        if 0 < number < 2**63 and self._select(select, (number,)) == [(1,)]:
            return number
        ids = f"SELECT min(id), max(id) FROM test WHERE {where}"  # noqa: S608
        ((lowest, highest),) = self._select(ids)
        existing = f"ids run from {lowest} to {highest}" if lowest else "there are none so far"
        raise CampaignError(f"{self.folder} holds no {kind} {number}: {existing}")

    def _damaged(self, problem: str) -> CampaignError:
        return CampaignError(
            f"{self._path} is damaged: {problem}; restore it from a copy, or run the campaign again"
        )
