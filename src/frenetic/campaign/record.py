"""Records of a candidate's test: the `Attempt` that a worker answers, and the stored `Test`.

`ASKED`, `REPORTED` and `FINDING` declare each value that the database holds. Its tables, the
records read from them and the exported tables follow from these columns.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from json import JSONEncoder
from typing import Any, ClassVar, Final, Literal, Self, TypeAlias

import numpy as np
from msgspec import convert, to_builtins

from frenetic._support.bounds import Count, Finite, Index, NotNegative, Share
from frenetic._support.notebook import NotebookRepr
from frenetic._support.outside_text import read_json
from frenetic.campaign.trajectory_codec import decode, encode, rounded
from frenetic.errors import IS_KILLED, CampaignError, Trouble
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result, unusable_result
from frenetic.road import Pose, Road
from frenetic.search.records import Candidate
from frenetic.spec.terms import DriveSetting


@dataclass(frozen=True)
class Attempt:
    """A worker's answer: an attempt to test a candidate, small enough to cross processes."""

    candidate_id: Count
    result: Result
    """Verdict; of an undriven road only outcome and reason."""
    pose: Pose | None = None
    """Start of the road on the map; None if it fits nowhere."""
    trajectory: Trajectory | None = None
    """Trajectory; None if nothing was driven, or if it is packed only."""
    packed: bytes | None = None
    """Encoded trajectory."""
    records: Index | None = None
    """Number of the trajectory's records; None if there is no trajectory, wherever it is."""
    simulator_broke: bool = False
    """Whether the simulator broke, so that another attempt may succeed."""
    worker_lost: bool = False
    """Whether the worker was lost on the way; the result's reason says how."""
    worker: str | None = None
    """Name of the worker."""
    seconds: NotNegative = 0.0
    """Wall time of the attempt, in s."""
    driver_seconds: float = field(default=0.0, compare=False)
    """Wall time in the driver's own code, in s."""
    trouble: Trouble | None = None
    """Error of the driver, the simulator or the worker; None without an error."""
    reported_share: Share | None = None
    """Spent share of the budget, as a client reports it; None if the campaign counts."""

    @classmethod
    def undriven(
        cls, candidate_id: int, outcome: Outcome, reason: str, pose: Pose | None = None
    ) -> Self:
        """Return the attempt at a road that was refused, dropped, or lost with its worker."""
        return cls(candidate_id, Result(outcome, reason), pose)

    @classmethod
    def lost(cls, candidate_id: int, worker: str, seconds: float, trouble: Trouble) -> Self:
        """Return the attempt of a worker that was lost after `seconds`."""
        return cls(
            candidate_id,
            unusable_result(trouble),
            worker_lost=True,
            worker=worker,
            seconds=seconds,
            trouble=trouble,
        )

    @property
    def failure(self) -> str | None:
        """Reason for another attempt; None if this attempt stands, as a driver's fault does.

        A killed process gets another attempt: the system may have killed it.
        """
        fault = self.result.fault
        is_error = self.result.outcome is Outcome.ERROR
        is_doubtful = is_error or (fault is not None and fault.kind == IS_KILLED)
        broke = self.simulator_broke or self.worker_lost
        return self.result.reason if broke and is_doubtful else None

    def pack(self, *, keep: bool = False) -> Self:
        """Return the attempt with a packed trajectory; without the exact one unless `keep`."""
        if self.trajectory is None or (keep and self.packed is not None):
            return self
        return replace(
            self,
            trajectory=self.trajectory if keep else None,
            packed=self.packed or encode(self.trajectory),
            records=len(self.trajectory),
        )

    def stored_trajectory(self) -> Trajectory | None:
        """Return the packed trajectory as it will be read from the campaign: rounded."""
        if self.packed is None:
            return None
        return decode(self.packed) if self.trajectory is None else rounded(self.trajectory)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Test(NotebookRepr):
    """One road test: a candidate with its result."""

    __test__: ClassVar[bool] = False  # no test class of pytest's

    candidate: Candidate
    result: Result
    """Verdict; of an undriven road only outcome and reason."""
    result_number: Count
    """Number from 1 in the order of results."""
    budget_spent: Share
    """Share of the campaign's budget spent after this test, 0..1."""
    reported_share: Share | None = None
    """Spent share as a client reports it, 0..1; None if the campaign counts."""
    pose: Pose | None = None
    """Start of the road on the map; None if it fits nowhere."""
    trajectory: Trajectory | None = None
    """Trajectory; None if nothing was driven, or if the test was read without it."""
    records: Index | None = None
    """Number of the trajectory's records, also if it was not read; None if there is none."""
    worker: str | None = None
    """Name of the worker."""
    seconds: NotNegative = 0.0
    """Wall time of the attempt that stands, in s."""
    attempts: Index = 1
    """Number of attempts; 0 if it was dropped before."""
    elapsed: NotNegative = 0.0
    """Campaign time at this result, in s."""
    finished_at: str = ""
    """Time of the result, UTC, ISO 8601."""
    objective: Finite | None = None
    """Value that the campaign minimises or maximises; None for the MOOBD, or without a drive."""
    setting: DriveSetting | None = None
    """Setting of the drive; None if the campaign does not record it."""

    @classmethod
    def of(
        cls,
        candidate: Candidate,
        attempt: Attempt,
        *,
        result_number: int,
        budget_spent: float,
        attempts: int = 1,
        elapsed: float = 0.0,
        finished_at: str = "",
        setting: DriveSetting | None = None,
    ) -> Self:
        """Return the test of a candidate whose attempt stands, without its trajectory."""
        return cls(
            candidate=candidate,
            result=attempt.result,
            result_number=result_number,
            budget_spent=budget_spent,
            reported_share=attempt.reported_share,
            pose=attempt.pose,
            records=attempt.records,
            worker=attempt.worker,
            seconds=attempt.seconds,
            attempts=attempts,
            elapsed=elapsed,
            finished_at=finished_at,
            setting=setting,
        )

    @property
    def id(self) -> int:
        """The candidate's id."""
        return self.candidate.id

    @property
    def outcome(self) -> Outcome:
        """The verdict's outcome."""
        return self.result.outcome

    @property
    def reason(self) -> str:
        """The verdict's reason, for people."""
        return self.result.reason

    @property
    def moobd(self) -> float | None:
        """Minimum oob distance in m; None unless PASS or FAIL, or without a measurement."""
        return self.result.moobd

    @property
    def departure(self) -> Finding | None:
        """Place where the car left its lane, None if it did not."""
        return self.result.departure

    @cached_property
    def road(self) -> Road:
        """Road in its place on the map; at its default place if it fitted nowhere.

        Raises:
            CampaignError: the campaign does not record the width of its lanes.
        """
        setting = self._setting
        return self.candidate.road(setting.lane_width, self.pose, setting.road_class)

    @cached_property
    def drive(self) -> Drive | None:
        """Drive; None if nothing was driven, or if the test was read without its trajectory.

        Raises:
            CampaignError: the campaign does not record the car.
        """
        if self.trajectory is None:
            return None
        fault = self.result.fault
        broke = self.outcome is Outcome.ERROR or fault is not None
        setting = self._setting
        return Drive(
            self.trajectory,
            setting.car,
            setting.rules_in(self.candidate.conditions),
            self.road,
            Trouble(self.reason, fault=fault) if broke else None,
        )

    def __repr__(self) -> str:
        """The test at a glance."""
        moobd = "" if self.moobd is None else f", MOOBD {self.moobd:.2f} m"
        return f"<Test {self.id}: {self.outcome}{moobd}>"

    @property
    def _setting(self) -> DriveSetting:
        if self.setting is None:
            raise CampaignError(
                f"the campaign does not say with what test {self.id} was driven: 'frenetic check'"
                " says what is wrong with its configuration"
            )
        return self.setting


# The database

Kind: TypeAlias = Literal["INTEGER", "REAL", "TEXT", "JSON", "REALS", "PAIRS"]
"""SQLite's type; or JSON in a text, or float64 in a blob: (n,) or (n, 2)."""


@dataclass(frozen=True)
class Column:
    """A value of a test in the database."""

    name: str
    path: str
    """Attributes that lead to the value from a `Test`, joined by dots."""
    kind: Kind
    about: str
    unit: str = ""
    """Unit, empty for a text, a share or a number."""

    @cached_property
    def places(self) -> list[str]:
        """The steps of the path."""
        return self.path.split(".")

    @property
    def sql_type(self) -> str:
        """SQLite's type."""
        return {"JSON": "TEXT", "REALS": "BLOB", "PAIRS": "BLOB"}.get(self.kind, self.kind)

    def encoded(self, value: Any) -> Any:
        """Return a value for the database.

        Raises:
            ValueError: the value is not finite.
        """
        if value is None:
            return None
        if self.kind == "REAL":
            if not math.isfinite(value):
                raise ValueError(f"{self.name} is {value}: a finite number is needed")
            return float(value) + 0.0  # SQLite knows no negative zero
        if self.kind == "INTEGER":
            return int(value)
        if self.kind == "TEXT":  # half characters of a broken driver's message as in Python
            return str(value).encode("utf-8", "backslashreplace").decode()
        if self.kind == "JSON":
            if not value and isinstance(value, dict | tuple):  # as most are
                return "[]" if isinstance(value, tuple) else "{}"
            try:
                text = _FINITE.encode(to_builtins(value, enc_hook=_plain))
            except ValueError:
                raise ValueError(f"{self.name} is {value}: finite numbers are needed") from None
            return _HALF_CHARACTER.sub(lambda half: rf"\\u{ord(half[0]):x}", text)
        if not np.isfinite(value).all():
            raise ValueError(f"{self.name} are not all finite")
        return np.ascontiguousarray(value, "<f8").tobytes()

    def decoded(self, value: Any) -> Any:
        """Return a value from the database.

        Raises:
            ValueError: the value does not have this kind.
        """
        if value is None:
            return None
        if self.kind == "JSON":
            return read_json(value)
        if self.kind in ("REALS", "PAIRS"):
            values = np.frombuffer(value, "<f8").astype(np.float64, copy=False)
            if not np.isfinite(values).all():
                raise ValueError(f"the {self.name} are not all finite")
            return values.reshape(-1, 2) if self.kind == "PAIRS" else values
        return value


_FINITE: Final = JSONEncoder(ensure_ascii=False, allow_nan=False)  # msgspec makes null of NaN
_HALF_CHARACTER: Final = re.compile("[\ud800-\udfff]")


def _plain(value: Any) -> Any:
    """Return a number of numpy as a number of Python."""
    return value.item()


ASKED: Final = (
    Column("id", "candidate.id", "INTEGER", "counts from 1 in the order of asking"),
    Column("operator", "candidate.origin.operator", "TEXT", "what made the road: random, P1 .."),
    Column("parents", "candidate.origin.parents", "JSON", "ids of the candidates it was made from"),
    Column("generation", "candidate.origin.generation", "INTEGER", "0 for a random road"),
    Column("step", "candidate.step", "REAL", "between two curvatures", "m"),
    Column(
        "curvatures", "candidate.curvatures", "REALS", "positive left, linear in between", "1/m"
    ),
    Column("points", "candidate.points", "PAIRS", "the road as points, if proposed so", "m"),
    Column(
        "superelevation", "candidate.superelevation", "PAIRS", "distance in m and slope across it"
    ),
    Column("grade", "candidate.grade", "PAIRS", "distance in m and slope along it"),
    Column("widening", "candidate.widening", "PAIRS", "distance in m and m by which lanes widen"),
    Column("speed_limits", "candidate.speed_limits", "PAIRS", "distance in m and km/h from there"),
    Column("conditions", "candidate.conditions", "JSON", "what differs from the campaign's drives"),
    Column("repeat", "candidate.repeat", "INTEGER", "counts the drives of one road from 0"),
    Column("source", "candidate.source", "JSON", "campaign and test whose road it is"),
    Column("notes", "candidate.notes", "JSON", "what the strategy says of it"),
)
"""Columns of a candidate."""

REPORTED: Final = (
    Column("result_number", "result_number", "INTEGER", "counts from 1 in the order of results"),
    Column("outcome", "result.outcome", "TEXT", "PASS, FAIL, INVALID, ERROR or DROPPED"),
    Column("reason", "result.reason", "TEXT", "why it ended so"),
    Column("budget_spent", "budget_spent", "REAL", "share of the budget spent after the result"),
    Column("reported_share", "reported_share", "REAL", "spent share that a client reported"),
    Column("x", "pose.x", "REAL", "of the pose in which the road starts on the map", "m"),
    Column("y", "pose.y", "REAL", "of the pose in which the road starts on the map", "m"),
    Column("heading", "pose.heading", "REAL", "of that pose, counter-clockwise from +x", "rad"),
    Column("moobd", "result.moobd", "REAL", "minimum oob distance", "m"),
    Column("moobd_distance", "result.moobd_distance", "REAL", "along the road to there", "m"),
    Column("max_oob_share", "result.max_oob_share", "REAL", "largest share of the car outside"),
    Column("duration", "result.duration", "REAL", "simulated time of the drive", "s"),
    Column("fault", "result.fault", "JSON", "whose code broke, and where"),
    Column("objective", "objective", "REAL", "what the search minimised, if not the MOOBD"),
    Column("seconds", "seconds", "REAL", "wall time of the test", "s"),
    Column("elapsed", "elapsed", "REAL", "campaign time of the result", "s"),
    Column("finished_at", "finished_at", "TEXT", "time of the result"),
    Column("attempts", "attempts", "INTEGER", "how often it was tried"),
    Column("worker", "worker", "TEXT", "who drove it"),
    Column("records", "records", "INTEGER", "number of records of its trajectory"),
)
"""Columns of a result; all are NULL while a candidate is outstanding."""

FINDING: Final = tuple(
    Column(item.name, item.name, "TEXT" if item.name in ("criterion", "side") else "REAL", "")
    for item in fields(Finding)
)
"""Columns of a finding, after its test and its number."""

FINISHED: Final = (*ASKED, *REPORTED)


def row_of(record: Any, columns: Sequence[Column]) -> tuple[Any, ...]:
    """Return the values of a candidate, test or finding, in the order of the columns.

    Raises:
        ValueError: a number is not finite.
    """
    start = isinstance(record, Candidate)
    return tuple([column.encoded(value_at(record, column.places[start:])) for column in columns])


def value_at(record: Any, path: Sequence[str]) -> Any:
    """Return the value at the end of a path of attributes; None if an attribute is None."""
    value = record
    for name in path:
        if value is None:
            return None
        value = getattr(value, name)
    return value


def read_candidate(row: Sequence[Any]) -> Candidate:
    """Return the candidate in a row of `FINISHED`.

    Raises:
        ValueError: the row is damaged; the message names the place.
    """
    candidate: Candidate = convert(_nested(ASKED, row)["candidate"], Candidate)
    return candidate


def read_test(
    row: Sequence[Any],
    findings: Sequence[Sequence[Any]] = (),
    trajectory: Trajectory | None = None,
    setting: DriveSetting | None = None,
) -> Test:
    """Return the test in a row of `FINISHED`.

    Args:
        row: values of the test.
        findings: rows of `FINDING` of the test.
        trajectory: trajectory of the test, if it is wanted.
        setting: setting of the campaign.

    Raises:
        ValueError: a row is damaged; the message names the place.
    """
    values = _nested(FINISHED, row)
    if pose := values.pop("pose"):
        values["pose"] = [pose.get(name) for name in Pose._fields]
    names = [column.name for column in FINDING]
    values["result"]["findings"] = [dict(zip(names, finding, strict=True)) for finding in findings]
    test: Test = convert(values, Test)
    return replace(test, trajectory=trajectory, setting=setting)


def _nested(columns: Sequence[Column], row: Sequence[Any]) -> dict[str, Any]:
    """Return the values of a row, nested by the paths of the columns, without missing ones."""
    values: dict[str, Any] = {"candidate": {"origin": {}}, "result": {}, "pose": {}}
    for column, value in zip(columns, row, strict=False):
        if value is None:
            continue
        place = values
        for name in column.places[:-1]:
            place = place[name]
        place[column.places[-1]] = column.decoded(value)
    return values
