"""The columns of a campaign's database: each value of a candidate, test, finding and segment.

The database's tables, the records that are read from them and the exported tables follow from these
columns.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property, partial
from json import JSONEncoder
from operator import attrgetter
from typing import Any, Final, Literal, TypeAlias

import numpy as np
from msgspec import convert, to_builtins

from frenetic._support.outside_text import read_json
from frenetic.campaign.record import Test
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.verdict import Finding
from frenetic.road import Pose
from frenetic.search.approach import SIZE
from frenetic.search.records import Candidate
from frenetic.segments.causes import Cause
from frenetic.segments.causes import Kind as CauseKind
from frenetic.segments.features import FEATURES
from frenetic.segments.values import SegmentValues
from frenetic.spec.terms import DriveSetting

Kind: TypeAlias = Literal["INTEGER", "REAL", "TEXT", "JSON", "REALS", "PAIRS"]
"""How the database stores a value: as SQLite's INTEGER, REAL or TEXT, as JSON in a text, or as
float64 in a blob, of shape (n,) for REALS and (n, 2) for PAIRS."""


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a table in the database."""

    name: str
    path: str
    """Attributes that lead from a `Test` or a `Finding` to the value, joined by dots."""
    kind: Kind
    about: str
    """Meaning of the value, for people."""
    unit: str = ""
    """Unit of the value, of both values of a pair; empty for a text, a share or a number."""

    @cached_property
    def attributes(self) -> list[str]:
        """The attributes of the path, one after the other."""
        return self.path.split(".")

    @cached_property
    def parent(self) -> str:
        """The path without its last attribute."""
        return ".".join(self.attributes[:-1])

    @cached_property
    def is_encoded(self) -> bool:
        """Whether SQLite's value differs from the value."""
        return self.kind not in ("INTEGER", "REAL", "TEXT")

    @property
    def sql_type(self) -> str:
        """SQLite's type of the column."""
        return {"JSON": "TEXT", "REALS": "BLOB", "PAIRS": "BLOB"}.get(self.kind, self.kind)

    @cached_property
    def encode(self) -> Callable[[Any], Any]:
        """Function that returns a value as the database stores it.

        It raises a ValueError if the value is not finite.
        """
        functions: dict[Kind, Callable[[Any], Any]] = {
            "INTEGER": int,
            "REAL": partial(_stored_number, self.name),
            "TEXT": _stored_text,
            "JSON": partial(_stored_json, self.name),
        }
        return functions.get(self.kind, partial(_stored_numbers, self.name))

    def decode(self, value: Any) -> Any:
        """Return the value of a cell of the database.

        Raises:
            ValueError: the value does not have this kind.
        """
        if value is None:
            return None
        if self.kind == "JSON":
            return _EMPTY_JSON[value]() if value in _EMPTY_JSON else read_json(value)
        if self.kind in ("REALS", "PAIRS"):
            values = np.frombuffer(value, "<f8").astype(np.float64, copy=False)
            if not np.isfinite(values).all():
                raise ValueError(f"the {self.name} are not all finite")
            return values.reshape(-1, 2) if self.kind == "PAIRS" else values
        return value


def _stored_number(name: str, value: Any) -> float:
    number = float(value) + 0.0  # SQLite knows no negative zero
    if not math.isfinite(number):
        raise ValueError(f"{name} is {value}: a finite number is needed")
    return number


def _stored_text(value: Any) -> str:
    text = str(value)
    # A broken driver's message may hold halves of characters, which SQLite refuses.
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode()


def _stored_json(name: str, value: Any) -> str:
    if not value and isinstance(value, dict | tuple):  # a shortcut: most are empty
        return "[]" if isinstance(value, tuple) else "{}"
    try:
        text = _FINITE_JSON.encode(to_builtins(value, enc_hook=_python_number))
    except ValueError:
        raise ValueError(f"{name} is {value}: finite numbers are needed") from None
    return _HALF_CHARACTER.sub(lambda half: rf"\\u{ord(half[0]):x}", text)


def _stored_numbers(name: str, value: Any) -> bytes:
    if not np.isfinite(value).all():
        raise ValueError(f"{name} are not all finite")
    return np.ascontiguousarray(value, "<f8").tobytes()


_FINITE_JSON: Final = JSONEncoder(ensure_ascii=False, allow_nan=False)
"""Encoder that refuses NaN and infinity; msgspec's would write null for them."""
_EMPTY_JSON: Final[Mapping[str, type]] = {"[]": list, "{}": dict}
"""Texts of most values -> the type of the value."""
_HALF_CHARACTER: Final = re.compile("[\ud800-\udfff]")
"""Half of a surrogate pair, which is no character and not allowed in UTF-8."""


def _python_number(value: Any) -> Any:
    """Return a number of numpy as a number of Python."""
    return value.item()


CANDIDATE_COLUMNS: Final = (
    Column("id", "candidate.id", "INTEGER", "counts from 1 in the order of asking"),
    Column(
        "operator",
        "candidate.origin.operator",
        "TEXT",
        "operator that made the road: random, P1, ..",
    ),
    Column(
        "parents",
        "candidate.origin.parents",
        "JSON",
        "ids of the candidates that the road was made from",
    ),
    Column("generation", "candidate.origin.generation", "INTEGER", "0 for a random road"),
    Column("step", "candidate.step", "REAL", "distance between two curvatures", "m"),
    Column(
        "curvatures",
        "candidate.curvatures",
        "REALS",
        "curvatures, positive to the left, linear in between",
        "1/m",
    ),
    Column(
        "points",
        "candidate.points",
        "PAIRS",
        "points of the road, if it was proposed as points",
        "m",
    ),
    Column(
        "superelevation",
        "candidate.superelevation",
        "PAIRS",
        "distance along the road, slope across it",
        "m, m/m",
    ),
    Column(
        "grade", "candidate.grade", "PAIRS", "distance along the road, slope along it", "m, m/m"
    ),
    Column(
        "widening",
        "candidate.widening",
        "PAIRS",
        "distance along the road, width by which lanes are wider there",
        "m, m",
    ),
    Column(
        "speed_limits",
        "candidate.speed_limits",
        "PAIRS",
        "distance along the road, speed limit from there on",
        "m, km/h",
    ),
    Column(
        "conditions",
        "candidate.conditions",
        "JSON",
        "conditions in which the drive differs from others",
    ),
    Column("repeat", "candidate.repeat", "INTEGER", "counts the drives of one road from 0"),
    Column("source", "candidate.source", "JSON", "campaign and test from which the road was taken"),
    Column("notes", "candidate.notes", "JSON", "notes of the strategy"),
)
"""Columns of a candidate, which the strategy was asked for."""

RESULT_COLUMNS: Final = (
    Column("result_number", "result_number", "INTEGER", "counts from 1 in the order of results"),
    Column("outcome", "result.outcome", "TEXT", "PASS, FAIL, INVALID, ERROR or DROPPED"),
    Column("reason", "result.reason", "TEXT", "reason of the outcome"),
    Column("budget_spent", "budget_spent", "REAL", "share of the budget spent after the result"),
    Column("reported_share", "reported_share", "REAL", "spent share that a client reported"),
    Column("x", "pose.x", "REAL", "of the start of the road on the map", "m"),
    Column("y", "pose.y", "REAL", "of the start of the road on the map", "m"),
    Column("heading", "pose.heading", "REAL", "of the start of the road on the map", "rad"),
    Column("moobd", "result.moobd", "REAL", "minimum oob distance", "m"),
    Column(
        "moobd_distance",
        "result.moobd_distance",
        "REAL",
        "distance along the road to the MOOBD",
        "m",
    ),
    Column(
        "max_oob_share", "result.max_oob_share", "REAL", "largest share of the car outside its lane"
    ),
    Column("duration", "result.duration", "REAL", "simulated time of the drive", "s"),
    Column(
        "distance",
        "result.distance",
        "REAL",
        "length of the road from its start to where the drive ended",
        "m",
    ),
    Column("fault", "result.fault", "JSON", "part whose code broke, and where"),
    Column("objective", "objective", "REAL", "value of the objective, unless it is the MOOBD"),
    Column("seconds", "seconds", "REAL", "wall time of the test", "s"),
    Column("elapsed", "elapsed", "REAL", "campaign time of the result", "s"),
    Column("finished_at", "finished_at", "TEXT", "time of the result"),
    Column("attempts", "attempts", "INTEGER", "number of attempts"),
    Column("worker", "worker", "TEXT", "name of the worker that drove"),
    Column("records", "records", "INTEGER", "number of records of its trajectory"),
)
"""Columns of a candidate's result; all are NULL while the candidate is outstanding."""

FINDING_COLUMNS: Final = tuple(
    Column(item.name, item.name, "TEXT" if item.name in ("criterion", "side") else "REAL", "")
    for item in fields(Finding)
)
"""Columns of a finding, which follow the id of its test and its number in the test."""
_FINDING_NAMES: Final = tuple(column.name for column in FINDING_COLUMNS)

SEGMENT_COLUMNS: Final = (
    Column("place", "place", "REAL", "distance along the road to the segment's place", "m"),
    Column("side", "side", "TEXT", "side of the finding, or of the lane's nearer edge"),
    Column("criterion", "criterion", "TEXT", "criterion of the finding"),
    Column("cause", "cause.kind.name", "TEXT", "kind of the failure's cause"),
    Column("bend_side", "cause.bend_side", "TEXT", "side to which the bends of the cause turn"),
    *(
        Column(feature.name, f"features.{feature.name}", "REAL", feature.description, feature.unit)
        for feature in FEATURES.values()
    ),
    Column("slowest", "slowest", "REAL", "least speed once it was half of the largest", "m/s"),
    Column("fastest", "fastest", "REAL", "largest speed of the drive", "m/s"),
    Column(
        "approach",
        "approach",
        "REALS",
        "19 points of the road around the place, then 13 offsets and 13 speeds before it",
    ),
)
"""Columns of the segment of a judged drive, see `frenetic.segments.values`. They follow the id of
its test."""

TEST_COLUMNS: Final = (*CANDIDATE_COLUMNS, *RESULT_COLUMNS)
"""Columns of a test: a candidate with its result."""


def row_of(record: Any, columns: Sequence[Column]) -> tuple[Any, ...]:
    """Return the values of a candidate, test or finding, in the order of the columns.

    Raises:
        ValueError: a number is not finite.
    """
    # A column's path starts at a test; from a candidate it is shorter by "candidate".
    start = 1 if isinstance(record, Candidate) else 0
    paths, encoders = _paths_and_encoders(tuple(columns), start)
    try:
        values = attrgetter(*paths)(record)
    except AttributeError:  # an object on a path is None
        values = tuple([value_at(record, path.split(".")) for path in paths])
    return tuple(
        [
            None if value is None else encode(value)
            for encode, value in zip(encoders, values, strict=True)
        ]
    )


@cache
def _paths_and_encoders(
    columns: tuple[Column, ...], start: int
) -> tuple[list[str], list[Callable[[Any], Any]]]:
    """Return the paths of columns from an attribute on, and their functions that encode."""
    paths = [".".join(column.attributes[start:]) for column in columns]
    return paths, [column.encode for column in columns]


def segment_row(values: SegmentValues) -> tuple[Any, ...]:
    """Return the values of a segment, in the order of `SEGMENT_COLUMNS`.

    Raises:
        ValueError: a number is not finite.
    """
    cause = values.cause
    row = (
        values.place,
        values.side,
        values.criterion,
        None if cause is None else cause.kind.name,
        None if cause is None else cause.bend_side,
        *values.features.values(),
        values.slowest,
        values.fastest,
        values.approach,
    )
    return tuple(
        [
            None if value is None else column.encode(value)
            for column, value in zip(SEGMENT_COLUMNS, row, strict=True)
        ]
    )


def value_at(record: Any, path: Sequence[str]) -> Any:
    """Return the value at the end of a path of attributes; None if an attribute is None."""
    value = record
    for name in path:
        if value is None:
            return None
        value = getattr(value, name)
    return value


def read_candidate(row: Sequence[Any]) -> Candidate:
    """Return the candidate in a row of `TEST_COLUMNS`.

    Raises:
        ValueError: the row is damaged; the message names the value.
    """
    candidate: Candidate = convert(_nested(CANDIDATE_COLUMNS, row)["candidate"], Candidate)
    return candidate


def read_test(
    row: Sequence[Any],
    findings: Sequence[Sequence[Any]] = (),
    trajectory: Trajectory | None = None,
    setting: DriveSetting | None = None,
    stored_values: SegmentValues | None = None,
) -> Test:
    """Return the test in a row of `TEST_COLUMNS`.

    Args:
        row: values of the test.
        findings: rows of the test's findings, each with the values of `FINDING_COLUMNS`.
        trajectory: trajectory of the test; None to leave it out.
        setting: setting of the campaign's drives; None if the campaign does not record it.
        stored_values: values of the drive's segment; None to leave them out.

    Raises:
        ValueError: a row is damaged; the message names the value.
    """
    values = _nested(TEST_COLUMNS, row)
    if pose := values.pop("pose"):
        values["pose"] = [pose.get(name) for name in Pose._fields]
    if findings:
        values["result"]["findings"] = [
            dict(zip(_FINDING_NAMES, finding, strict=True)) for finding in findings
        ]
    test: Test = convert(values, Test)
    # The new test is completed in place: a copy by `replace` would take as long as its conversion.
    for name, value in (
        ("trajectory", trajectory),
        ("setting", setting),
        ("stored_values", stored_values),
    ):
        object.__setattr__(test, name, value)
    return test


def read_segment(row: Sequence[Any]) -> SegmentValues:
    """Return the values of a segment in a row of `SEGMENT_COLUMNS`.

    Raises:
        ValueError: the row is damaged.
    """
    place, side, criterion, kind, bend_side, *numbers, slowest, fastest, approach = row
    if None in (place, *numbers, slowest, fastest, approach) or len(approach) != 8 * SIZE:
        raise ValueError("a value of its segment is missing")
    cause = None
    if kind is not None:
        cause_kind = _kind_of_cause(kind)
        exceeded = criterion if cause_kind is CauseKind.EXCEEDS else ""
        cause = Cause(cause_kind, bend_side, exceeded)
    return SegmentValues(
        place=place,
        side=side,
        criterion=criterion,
        cause=cause,
        features=dict(zip(FEATURES, numbers, strict=True)),
        slowest=slowest,
        fastest=fastest,
        approach=np.frombuffer(approach, "<f8").astype(np.float64, copy=False),
    )


def _kind_of_cause(name: str) -> CauseKind:
    """Return the kind of cause with this name.

    Raises:
        ValueError: no kind has this name.
    """
    if name not in CauseKind.__members__:
        raise ValueError(f"its cause is {name!r}, which this version of frenetic does not know")
    return CauseKind[name]


def _nested(columns: Sequence[Column], row: Sequence[Any]) -> dict[str, Any]:
    """Return the values of a row in dictionaries nested by the columns' paths, without NULLs."""
    origin: dict[str, Any] = {}
    candidate: dict[str, Any] = {"origin": origin}
    result: dict[str, Any] = {}
    pose: dict[str, Any] = {}
    values: dict[str, Any] = {"candidate": candidate, "result": result, "pose": pose}
    parents = {
        "": values,
        "candidate": candidate,
        "candidate.origin": origin,
        "result": result,
        "pose": pose,
    }
    for column, value in zip(columns, row, strict=False):  # a row may hold more than `columns`
        if value is not None:
            decoded = column.decode(value) if column.is_encoded else value
            parents[column.parent][column.attributes[-1]] = decoded
    return values
