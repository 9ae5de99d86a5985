"""Reading a campaign's database, while it is written and long afterwards."""

from __future__ import annotations

import json
import operator
import sqlite3
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal, TypeAlias

from frenetic._support.json_value import JSONValue
from frenetic._support.notebook import Shown
from frenetic.campaign.counts import Counts, road_key
from frenetic.campaign.database import DATABASE, checksum, translated
from frenetic.campaign.record import FINDING, FINISHED, Setting, Test, read_candidate, read_test
from frenetic.campaign.trajectory_codec import decode
from frenetic.drive import Trajectory
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search.records import Candidate
from frenetic.spec import require_count

Order: TypeAlias = Literal["told", "moobd"]
_Row: TypeAlias = tuple[Any, ...]

_AT_ONCE: Final = 500  # tests read by one SELECT
_NAMES: Final = [column.name for column in FINISHED]
_VALUES: Final = ", ".join(_NAMES)
_FINDING: Final = ", ".join(f'"{column.name}"' for column in FINDING)
_SELECT: Final = f"SELECT {_VALUES}, asked_after, checksum FROM test WHERE id IN "  # noqa: S608
_SELECT_FINDINGS: Final = f"SELECT test, number, {_FINDING} FROM finding WHERE test IN "  # noqa: S608
_UNLISTED: Final = ("config", "earlier", "sources", "started_in")  # large, or shown elsewhere


class CampaignReader(Shown):
    """What a campaign's database holds; every row is checked as it is read.

    Args:
        folder: of the campaign.
        connection: to its database.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection) -> None:
        self._folder = folder
        self._path = folder / DATABASE
        self._connection = connection
        config = self.fact("config")
        if not isinstance(config, dict):
            raise self._damaged("the config is no JSON object")
        self._config: Mapping[str, JSONValue] = MappingProxyType(config)
        try:
            self._setting: Setting | str = Setting.of(config)
        except ValueError as error:
            self._setting = str(error)

    def write(self) -> None:
        """Stores what a writer holds, so that all is read."""

    def at_a_glance(self) -> str:
        """The campaign's folder and results: ``campaigns/night: 70 PASS, 12 FAIL``."""
        counts = [f"{number} {outcome}" for outcome, number in self.by_outcome().items() if number]
        return f"{self._folder}: {', '.join(counts) or 'no results'}"

    def __repr__(self) -> str:
        """The campaign at a glance; of a closed one, its folder."""
        try:
            return f"<CampaignStore {self.at_a_glance()}>"
        except CampaignError:
            return f"<CampaignStore {self._folder}>"

    @property
    def folder(self) -> Path:
        """The campaign's folder."""
        return self._folder

    @property
    def config(self) -> Mapping[str, JSONValue]:
        """The campaign's configuration."""
        return self._config

    @property
    def setting(self) -> Setting:
        """The setting of the campaign's drives.

        Raises:
            CampaignError: the configuration lacks it.
        """
        if isinstance(self._setting, str):
            raise self._damaged(f"its configuration: {self._setting}")
        return self._setting

    # Facts

    @property
    def facts(self) -> Mapping[str, JSONValue]:
        """The other facts of the campaign: ``created_at`` and those that `finish` added."""
        names = self._select("SELECT name FROM fact ORDER BY name")
        wanted = [name for (name,) in names if name not in _UNLISTED]
        return MappingProxyType({name: self.fact(name) for name in wanted})

    def fact(self, name: str) -> JSONValue:
        """A fact by its name, None if there is no such fact.

        Raises:
            CampaignError: it is damaged.
        """
        rows = self._select("SELECT name, value, checksum FROM fact WHERE name = ?", (name,))
        for *row, stored in rows:
            if checksum(row) != stored:
                raise self._damaged(f"the fact {name} does not match its checksum")
            try:
                value: JSONValue = json.loads(row[1])
            except (ValueError, RecursionError):
                raise self._damaged(f"the fact {name} is not JSON") from None
            return value
        return None

    # Reading

    def tests(
        self,
        outcome: Outcome | None = None,
        order_by: Order = "told",
        limit: int | None = None,
        with_trajectory: bool | Container[int] = False,
    ) -> Iterator[Test]:
        """The tests that are stored at this moment; later ones do not show up.

        Args:
            outcome: only of tests with it.
            order_by: the order of telling, or ``moobd``: lowest first, those without one last.
            limit: most tests.
            with_trajectory: whether they come with their trajectories, or the ids of those that do.

        Raises:
            ValueError: an unknown outcome or order, or a number that is no whole one from 0.
            CampaignError: a test is damaged or missing.
        """
        if order_by not in ("told", "moobd"):
            raise ValueError(f"order_by is {order_by!r}: 'told' or 'moobd' is needed")
        if limit is not None:
            limit = require_count("limit", limit, 0)
        only = None if outcome is None else Outcome(outcome)
        self.write()
        # A stored test never changes, so the ids are a snapshot, and no transaction stays open
        # between two tests.
        rows = [row for row in self._index() if only is None or row[2] == only]
        if order_by == "moobd":
            rows.sort(key=lambda row: (row[3] is None, row[3] or 0.0))
        ids = [row[1] for row in rows[:limit]]
        return (
            test
            for start in range(0, len(ids), _AT_ONCE)
            for test in self._read(ids[start : start + _AT_ONCE], with_trajectory)
        )

    def _index(self) -> list[tuple[int, int, str, float | None]]:
        """Number of telling, id, outcome and MOOBD of all results, in the order of telling.

        Raises:
            CampaignError: a number is missing.
        """
        rows = self._select(
            "SELECT told, id, outcome, moobd FROM test WHERE told IS NOT NULL ORDER BY told"
        )
        for number, row in enumerate(rows, start=1):
            if row[0] != number:
                raise self._damaged(f"the result told as number {number} is missing")
        return rows

    def test(self, id: int, with_trajectory: bool = True) -> Test:  # noqa: A002
        """The test of the candidate with this id.

        Raises:
            CampaignError: there is none (the message names the existing ids), or it is damaged.
            ValueError: the id is no whole number.
        """
        number = _whole(id)
        self.write()
        ((told,),) = self._select(
            "SELECT count(*) FROM test WHERE id = ? AND told IS NOT NULL", (number,)
        )
        if not told:
            raise self._unknown("test of candidate", id, "WHERE told IS NOT NULL")
        return self._read([number], with_trajectory)[0]

    def _read(self, ids: Sequence[int], with_trajectory: bool | Container[int]) -> list[Test]:
        """The tests of some candidates, in this order."""
        has_path = ids if with_trajectory is True else with_trajectory or ()
        setting = self._setting if isinstance(self._setting, Setting) else None
        tests = []
        for row, findings in self._whole_rows(ids):
            with self._reading(f"test {row[0]}"):
                packed = self._packed(row[0], row[-1]) if row[0] in has_path else None
                tests.append(read_test(row, findings, packed, setting))
        return tests

    def _whole_rows(self, ids: Sequence[int]) -> Iterator[tuple[_Row, list[_Row]]]:
        """The rows of some candidates, in this order, each with those of its findings.

        Raises:
            CampaignError: one is missing, or does not match its checksum.
        """
        wanted = f"({', '.join('?' * len(ids))})"
        rows = {row[0]: row for row in self._select(_SELECT + wanted, ids)}
        findings: dict[int, list[_Row]] = {}
        for test, *values in self._select(f"{_SELECT_FINDINGS}{wanted} ORDER BY test, number", ids):
            findings.setdefault(test, []).append(tuple(values))
        for number in ids:
            if number not in rows:
                raise self._damaged(f"candidate {number} is missing")
            *row, stored = rows[number]
            own = findings.get(number, [])
            if checksum([*row, *(value for finding in own for value in finding)]) != stored:
                raise self._damaged(f"test {number} does not match its checksum")
            yield tuple(row[:-1]), [finding[1:] for finding in own]

    def _packed(self, number: int, records: int | None) -> bytes | None:
        """The encoded trajectory of a test with so many records, None if it has none.

        Raises:
            CampaignError: it is gone.
        """
        if records is None:
            return None
        ((packed,),) = self._select("SELECT trajectory FROM test WHERE id = ?", (number,))
        if packed is None:
            raise self._damaged(f"the trajectory of test {number} is gone")
        data: bytes = packed
        return data

    def trajectory(self, id: int) -> Trajectory | None:  # noqa: A002
        """The trajectory of the candidate with this id; None if none is stored.

        Raises:
            CampaignError: it is damaged.
        """
        number = _whole(id)
        self.write()
        rows = self._select("SELECT records FROM test WHERE id = ?", (number,))
        packed = self._packed(number, rows[0][0]) if rows else None
        if packed is None:
            return None
        with self._reading(f"the trajectory of test {id}"):
            return decode(packed)

    def candidate(self, id: int) -> Candidate:  # noqa: A002
        """The candidate with this id, whether it has a result or not.

        Raises:
            CampaignError: there is none (the message names the existing ids), or it is damaged.
        """
        number = _whole(id)
        self.write()
        if not self._select("SELECT 1 FROM test WHERE id = ?", (number,)):
            raise self._unknown("candidate", id)
        return self._read_candidates([number])[0]

    def candidates(self) -> Iterator[tuple[Candidate, int]]:
        """All candidates in the order of asking, each with the number of results told before it.

        Raises:
            CampaignError: one is damaged or missing.
        """
        self.write()
        places = dict(self._select("SELECT id, asked_after FROM test ORDER BY id"))
        ids = list(places)
        return (
            (candidate, places[candidate.id])
            for start in range(0, len(ids), _AT_ONCE)
            for candidate in self._read_candidates(ids[start : start + _AT_ONCE])
        )

    def _read_candidates(self, ids: Sequence[int]) -> list[Candidate]:
        candidates = []
        for row, _ in self._whole_rows(ids):
            with self._reading(f"candidate {row[0]}"):
                candidates.append(read_candidate(row))
        return candidates

    def by_outcome(self) -> dict[Outcome, int]:
        """The number of results per outcome; every outcome is present."""
        return self._count_by_outcome()[0]

    def counts(self) -> Counts:
        """The number of tests per outcome and of different roads, and the lowest MOOBD.

        Reads the roads of all tests: where numbers are enough, `by_outcome` is faster.
        """
        by_outcome, min_moobd = self._count_by_outcome()
        select = "SELECT step, curvatures, points FROM test WHERE outcome <> 'DROPPED'"
        roads = {road_key(*row) for row in self.rows(select)}
        return Counts.of(by_outcome, min_moobd, len(roads))

    def _count_by_outcome(self) -> tuple[dict[Outcome, int], float | None]:
        """The number of results per outcome, and the lowest MOOBD in m."""
        self.write()
        rows = self._select(
            "SELECT outcome, count(*), min(moobd) FROM test WHERE told IS NOT NULL GROUP BY outcome"
        )
        by_outcome = dict.fromkeys(Outcome, 0)
        with self._reading("the outcome of a test"):
            by_outcome |= {Outcome(outcome): count for outcome, count, _ in rows}
        return by_outcome, min((moobd for *_, moobd in rows if moobd is not None), default=None)

    def stored(self) -> int:
        """The number of results on disk, without held ones; 0 if it cannot be read."""
        with suppress(CampaignError):
            ((number,),) = self._select("SELECT count(told) FROM test")
            return int(number)
        return 0

    def elapsed(self) -> float:
        """The campaign's time at the last result, in s."""
        self.write()
        ((seconds,),) = self._select("SELECT coalesce(max(elapsed), 0.0) FROM test")
        return float(seconds)

    def rows(self, select: str, parameters: Sequence[object] = ()) -> Iterator[tuple[Any, ...]]:
        """The rows of a SELECT, for reading many tests at once.

        Nothing is checked. Later results may show up.
        """
        self.write()
        with translated(self._path):
            yield from self._connection.execute(select, tuple(parameters))

    def _select(self, select: str, parameters: Sequence[object] = ()) -> list[tuple[Any, ...]]:
        with translated(self._path):
            return self._connection.execute(select, tuple(parameters)).fetchall()

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        """Turns the faults of a value into a `CampaignError` that names it."""
        try:
            yield
        except (TypeError, ValueError, RecursionError) as error:
            raise self._damaged(f"{name}: {error}") from None
        except CampaignError as error:
            if str(self._path) in str(error):
                raise
            raise self._damaged(f"{name}: {error}") from None

    def _unknown(self, what: str, number: object, where: str = "") -> CampaignError:
        ((lowest, highest),) = self._select(f"SELECT min(id), max(id) FROM test {where}")  # noqa: S608
        there_are = f"ids run from {lowest} to {highest}" if lowest else "there are none so far"
        return CampaignError(f"{self._folder} holds no {what} {number}: {there_are}")

    def _damaged(self, what: str) -> CampaignError:
        return CampaignError(
            f"{self._path} is damaged: {what}; restore it from a copy, or run the campaign again"
        )


def _whole(number: object) -> int:
    """An id; 0 if it is beyond what SQLite knows.

    Raises:
        ValueError: it is no whole number.
    """
    try:
        value = operator.index(number)  # type: ignore[arg-type]  # of numpy, too
    except TypeError:
        raise ValueError(f"id is {number!r}: a whole number is needed") from None
    return value if 0 < value < 2**63 else 0
