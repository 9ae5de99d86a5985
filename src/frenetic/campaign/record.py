"""Records of a candidate's test: an `Attempt` of a worker, and the `TestRecord` that is stored.

The columns of a campaign's database are declared here with their valid values, and rows are decoded
here: input is validated once, on its way into a record.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime
from enum import Enum, auto
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, ClassVar, Final, NamedTuple, Self, get_args

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.notebook import Shown
from frenetic.campaign.trajectory_codec import decode, encode, rounded
from frenetic.errors import CampaignError
from frenetic.oracle import Departure, Result, Side
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.search.random_search import EARLIER
from frenetic.search.records import Candidate, Evaluation, Origin, Screening, Trace
from frenetic.simulators.drive import CarBody, Drive, Rules, Trajectory
from frenetic.spec import decode_config, is_number, shown


@dataclass(frozen=True)
class Attempt:
    """One attempt to test a candidate."""

    candidate_id: int
    result: Result
    """Verdict; of an undriven road only outcome and reason."""
    pose: Pose | None = None
    """Start of the road on the map; None if it fits nowhere."""
    trajectory: Trajectory | None = None
    """Trajectory; None if nothing was driven, or if it is packed."""
    packed: bytes | None = None
    """Encoded trajectory, small enough to travel between processes."""
    simulator_broke: bool = False
    """Whether the simulator broke, so that another attempt may succeed."""
    worker_lost: bool = False
    """Whether the worker was lost on the way; the result's reason says how."""
    worker: str | None = None
    """Name of the worker."""
    seconds: float = 0.0
    """Wall time that it took, in s."""
    traceback: str = ""
    """Traceback of the simulator's or driver's error, if known."""

    @classmethod
    def undriven(
        cls, candidate_id: int, outcome: Outcome, reason: str, pose: Pose | None = None
    ) -> Self:
        """A road that was refused, dropped, or lost with its worker."""
        return cls(candidate_id, Result(outcome, reason), pose)

    @classmethod
    def lost(
        cls, candidate_id: int, worker: str, seconds: float, reason: str, traceback: str = ""
    ) -> Self:
        """The attempt of a worker that was lost after the given s."""
        attempt = cls.undriven(candidate_id, Outcome.ERROR, reason)
        return replace(
            attempt, worker_lost=True, worker=worker, seconds=seconds, traceback=traceback
        )

    @property
    def failure(self) -> str | None:
        """Reason for another attempt; None if this one stands."""
        return self.result.reason if self.simulator_broke or self.worker_lost else None

    def pack(self, *, keep: bool = False) -> Self:
        """The same with a packed trajectory, in place of the exact one unless that is kept."""
        if self.trajectory is None:
            return self
        exact = self.trajectory if keep else None
        return replace(self, trajectory=exact, packed=encode(self.trajectory))

    def stored_trajectory(self) -> Trajectory | None:
        """The packed trajectory as it will be read from the campaign: rounded."""
        if self.packed is None:
            return None
        return decode(self.packed) if self.trajectory is None else rounded(self.trajectory)

    def record(
        self,
        candidate: Candidate,
        *,
        told: int,
        budget_spent: float,
        attempts: int = 1,
        elapsed: float | None = None,
        setting: Setting | None = None,
    ) -> TestRecord:
        """The test as a campaign keeps it."""
        result, departure = self.result, self.result.departure
        driven = self.trajectory is not None or self.packed is not None
        return TestRecord(
            candidate=candidate,
            told=told,
            outcome=result.outcome,
            reason=result.reason,
            budget_spent=budget_spent,
            pose=self.pose,
            moobd=result.moobd,
            max_oob_share=result.max_oob_share,
            duration=result.duration if driven else None,
            moobd_distance=result.moobd_distance,
            departure_time=departure.time if departure else None,
            departure_distance=departure.distance if departure else None,
            departure_x=departure.x if departure else None,
            departure_y=departure.y if departure else None,
            departure_side=departure.side if departure else None,
            seconds=self.seconds,
            attempts=attempts,
            worker=self.worker,
            elapsed=elapsed,
            trajectory=self.trajectory,
            setting=setting,
        )


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class TestRecord(Shown):
    """Record of one road test: its candidate, result and trajectory."""

    __test__: ClassVar[bool] = False  # no test class of pytest's

    candidate: Candidate
    told: int
    """Number from 1 in the order of telling."""
    outcome: Outcome
    reason: str
    """Reason of the outcome, for people."""
    budget_spent: float
    """Share of the campaign's budget spent when this was told, 0..1."""
    pose: tuple[float, float, float] | None = None
    """Start of the fitted road, x (m), y (m), heading (rad); None if it fits nowhere."""
    moobd: float | None = None
    """Minimum oob distance in m; None unless PASS or FAIL."""
    max_oob_share: float | None = None
    """Largest oob share of the drive, 0..1."""
    duration: float | None = None
    """Simulated time, in s."""
    moobd_distance: float | None = None
    """Distance along the road to where the oob distance was smallest, in m."""
    departure_time: float | None = None
    """Simulated time of the departure, in s; None without one, as for all of departure."""
    departure_distance: float | None = None
    """Distance along the road, in m."""
    departure_x: float | None = None
    """m."""
    departure_y: float | None = None
    """m."""
    departure_side: Side | None = None
    """The side of the lane on which it left."""
    seconds: float
    """Wall time that the test took, in s."""
    attempts: int = 1
    """Number of attempts; 0 if it was dropped before."""
    worker: str | None = None
    """Worker that drove it, None if unknown."""
    elapsed: float | None = None
    """Campaign time when this was told, in s; None in logs of old versions."""
    trajectory: Trajectory | None = None
    """Trajectory; None if nothing was driven, or if the record was read without it."""
    setting: Setting | None = None
    """Setting of its drive; None if the campaign does not record it."""

    @property
    def id(self) -> int:
        """The candidate's id."""
        return self.candidate.id

    @property
    def departure(self) -> Departure | None:
        """Place where the car left its lane, None if it did not."""
        place = (
            self.departure_time,
            self.departure_distance,
            self.departure_x,
            self.departure_y,
        )
        if self.departure_side is None or None in place:
            return None
        time, distance, x, y = (float(v) for v in place if v is not None)
        return Departure(time, distance, x, y, self.departure_side)

    @cached_property
    def road(self) -> Road:
        """Road in its place on the map; at its default place if it fitted nowhere.

        Raises:
            CampaignError: the campaign does not record the width of its lanes.
        """
        return Road(
            self.candidate.curvatures,
            self.candidate.step,
            **({} if self.pose is None else {"pose": Pose(*self.pose)}),
            lane_width=self._setting.lane_width,
        )

    @cached_property
    def drive(self) -> Drive | None:
        """Drive; None if nothing was driven, or if the record was read without its trajectory.

        Raises:
            CampaignError: the campaign does not record the car.
        """
        if self.trajectory is None:
            return None
        trouble = self.reason if self.outcome is Outcome.ERROR else None
        car, rules = self._setting.car, self._setting.rules
        return Drive(self.trajectory, car, rules, trouble, road=self.road)

    def __repr__(self) -> str:
        """The test at a glance."""
        moobd = "" if self.moobd is None else f", MOOBD {self.moobd:.2f} m"
        return f"<TestRecord {self.id}: {self.outcome}{moobd}>"

    @property
    def _setting(self) -> Setting:
        if self.setting is None:
            raise CampaignError(
                f"the campaign does not say with what test {self.id} was driven: 'frenetic check'"
                " says what is wrong with its configuration"
            )
        return self.setting


@dataclass(frozen=True, eq=False)
class EarlierTest:
    """Test of an earlier campaign that a search starts from."""

    campaign: int
    """Number from 1 of the campaign among those that it starts from."""
    test: int
    """Id of the test there."""
    evaluation: Evaluation
    """Result, as the strategy is told it; its candidate counts from 1 in this order."""

    @property
    def number(self) -> int:
        """Number from 1 among all tests that a search starts from."""
        return self.evaluation.candidate.id


@dataclass(frozen=True)
class Setting:
    """Terms of a campaign's drives."""

    lane_width: float
    """m."""
    map_size: float
    """m."""
    margin: float
    """m."""
    rules: Rules
    car: CarBody

    @classmethod
    def of(cls, config: Mapping[str, Any]) -> Self:
        """The setting in a campaign's configuration, see `setting_faults`."""
        return cls(**decode_config(config, _names_of(cls)).values)


def setting_faults(config: Mapping[str, Any]) -> tuple[str, ...]:
    """Faults that keep a configuration from giving its `Setting`, each in one line."""
    return decode_config(config, _names_of(Setting)).faults


def _names_of(kind: type[Setting]) -> list[str]:
    return [item.name for item in fields(kind)]


# The columns of a database


class Kind(Enum):
    """Type of a column's values."""

    WHOLE = auto()
    """Whole numbers."""
    REAL = auto()
    """Numbers."""
    TEXT = auto()
    CHOICE = auto()
    """One of few texts."""
    MOMENT = auto()
    """A date and time, UTC, to the millisecond."""
    WHOLES = auto()
    """A list of whole numbers."""
    REALS = auto()
    """A list of numbers."""
    PAIRS = auto()
    """A list of pairs of numbers."""


@dataclass(frozen=True)
class Column:
    """A column of a table, with its valid values."""

    name: str
    kind: Kind
    description: str
    unit: str = ""
    """Unit, empty for a text, a share or a number."""
    optional: bool = False
    """Whether values may be missing."""
    low: float = -math.inf
    """Least value that a campaign writes."""
    high: float = math.inf
    """Largest value that a campaign writes."""
    is_positive: bool = False
    """Whether any other value is unusable."""
    choices: tuple[str, ...] = ()
    """Allowed texts; any if empty."""

    def read(self, value: object) -> Any:
        """A value from the database, decoded.

        Raises:
            ValueError: it does not fit this column; the message continues the column's name.
        """
        if value is None and self.optional:
            return None
        return self._reader(self, value)

    def check(self, value: Any) -> None:
        """Checks that a decoded value is one that a campaign writes.

        Raises:
            ValueError: it is not; the message continues the column's name.
        """
        if self._is_bounded and value is not None and not self.low <= value <= self.high:
            raise ValueError(f"is {value}: {self._needed} is needed")

    # Looked up once: enums hash slowly.

    @cached_property
    def _reader(self) -> Callable[[Column, object], Any]:
        return _READERS[self.kind]

    @cached_property
    def _is_bounded(self) -> bool:
        return self.low > -math.inf or self.high < math.inf

    @property
    def _needed(self) -> str:
        if self.is_positive:
            return f"a positive number{' of metres' if self.unit == 'm' else ''}"
        if self.kind is Kind.WHOLE:
            return f"a whole number of at least {self.low:g}"
        if self.high == 1.0:
            return "a share from 0 to 1"
        return "a finite number" if self.low == -math.inf else "a number of at least 0"


def _whole(column: Column, value: object) -> int:
    if type(value) is not int:
        raise ValueError(f"is {shown(value)}: {column._needed} is needed")
    return value


def _real(column: Column, value: object) -> float:
    if type(value) is float and not column.is_positive and math.isfinite(value):
        return value  # as almost all are
    if not is_number(value) or (column.is_positive and value <= 0.0):  # type: ignore[operator]
        raise ValueError(f"is {shown(value)}: {column._needed} is needed")
    return float(value)  # type: ignore[arg-type]


def _text(column: Column, value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"is {shown(value)}: a text is needed")
    if column.choices and value not in column.choices:
        raise ValueError(f"is {shown(value)}: one of {', '.join(column.choices)} is needed")
    return value


def _moment(_: Column, value: object) -> str:
    if not is_moment(value):
        raise ValueError(f"is {shown(value)}: a date and time is needed")
    return str(value)


def is_moment(value: object) -> bool:
    """Whether it is a date and time with its distance from UTC, in ISO 8601."""
    try:
        return isinstance(value, str) and datetime.fromisoformat(value).tzinfo is not None
    except ValueError:
        return False


def _ids(_: Column, value: object) -> tuple[int, ...]:
    ids = _ids_in(value) if isinstance(value, str) else None
    if ids is None:
        raise ValueError(f"are {shown(value)}: a JSON list of ids is needed")
    return ids


@lru_cache(maxsize=10_000)  # most roads have no parents, or those of their siblings
def _ids_in(text: str) -> tuple[int, ...] | None:
    """The ids in a JSON list, None for anything else."""
    try:
        ids = json.loads(text)
    except (ValueError, RecursionError):
        return None
    is_fine = isinstance(ids, list) and all(type(one) is int and abs(one) < 2**63 for one in ids)
    return tuple(ids) if is_fine else None


def _reals(_: Column, value: object) -> FloatArray:
    if not isinstance(value, bytes) or len(value) % 8:
        raise ValueError("are no whole number of float64")
    return _finite(np.frombuffer(value, dtype="<f8").astype(np.float64, copy=False))


def _pairs(_: Column, value: object) -> FloatArray:
    if not isinstance(value, bytes) or len(value) % 16:
        raise ValueError("are no whole pairs of float64")
    return _finite(np.frombuffer(value, dtype="<f8").reshape(-1, 2))


def _finite(values: FloatArray) -> FloatArray:
    if not np.isfinite(values).all():
        raise ValueError("are not all finite")
    return values


_READERS: Final[Mapping[Kind, Callable[[Column, object], Any]]] = {
    Kind.WHOLE: _whole,
    Kind.REAL: _real,
    Kind.TEXT: _text,
    Kind.CHOICE: _text,
    Kind.MOMENT: _moment,
    Kind.WHOLES: _ids,
    Kind.REALS: _reals,
    Kind.PAIRS: _pairs,
}

POSE: Final = "x", "y", "heading"
"""Columns of a pose."""


def _by_name(*columns: Column) -> Mapping[str, Column]:
    return MappingProxyType({column.name: column for column in columns})


CANDIDATE_COLUMNS: Final = _by_name(
    Column("id", Kind.WHOLE, "of the candidate: counts from 1 in the order of asking", low=1),
    Column("operator", Kind.CHOICE, "what made the road: random, redraw, P1 .."),
    Column("parents", Kind.WHOLES, "ids of the candidates it was made from"),
    Column("generation", Kind.WHOLE, "0 for a random road", low=0),
    Column("step", Kind.REAL, "between two curvatures", "m", is_positive=True),
    Column("curvatures", Kind.REALS, "positive to the left, linear in between", "1/m"),
    Column("asked_after", Kind.WHOLE, "results that had been told when it was asked", low=0),
    Column("points", Kind.PAIRS, "the road as points, if it was proposed so", "m", True),
)
"""Name -> column of the table of candidates, in its order."""

TEST_COLUMNS: Final = _by_name(
    Column("candidate_id", Kind.WHOLE, "of the candidate", low=1),
    Column("told", Kind.WHOLE, "counts from 1 in the order of telling", low=1),
    Column("outcome", Kind.CHOICE, "PASS, FAIL, INVALID, ERROR or DROPPED", choices=tuple(Outcome)),
    Column("reason", Kind.TEXT, "why it ended so"),
    Column("budget_spent", Kind.REAL, "share of the budget when it was told", low=0.0, high=1.0),
    Column("x", Kind.REAL, "of the pose in which the road starts on the map", "m", True),
    Column("y", Kind.REAL, "likewise", "m", True),
    Column("heading", Kind.REAL, "likewise, counter-clockwise from +x", "rad", True),
    Column("moobd", Kind.REAL, "minimum oob distance", "m", True),
    Column(
        "max_oob_share", Kind.REAL, "largest share of the car outside its lane", "", True, 0.0, 1.0
    ),
    Column("duration", Kind.REAL, "simulated time of the drive", "s", True, 0.0),
    Column("moobd_distance", Kind.REAL, "along the road to where that was", "m", True),
    Column("departure_time", Kind.REAL, "when the car left its lane", "s", True, 0.0),
    Column("departure_distance", Kind.REAL, "along the road to where it left", "m", True),
    Column("departure_x", Kind.REAL, "where it left", "m", True),
    Column("departure_y", Kind.REAL, "where it left", "m", True),
    Column("departure_side", Kind.CHOICE, "left or right", "", True, choices=get_args(Side)),
    Column("seconds", Kind.REAL, "wall time of the test", "s", low=0.0),
    Column("finished_at", Kind.MOMENT, "when it was told"),
    Column("attempts", Kind.WHOLE, "how often it was tried", low=0),
    Column("worker", Kind.CHOICE, "who drove it", "", True),
    Column("elapsed", Kind.REAL, "the campaign's time when it was told", "s", True, 0.0),
)
"""Name -> column of the table of tests, in its order."""

EARLIER_COLUMNS: Final = _by_name(
    Column("number", Kind.WHOLE, "counts from 1", low=1),
    Column("campaign", Kind.WHOLE, "of those that it starts from, from 1", low=1),
    Column("test", Kind.WHOLE, "id of the test there", low=1),
    Column("step", Kind.REAL, "between two curvatures", "m", is_positive=True),
    Column("curvatures", Kind.REALS, "of its road", "1/m"),
    Column("outcome", Kind.CHOICE, "PASS or FAIL", choices=(Outcome.PASS, Outcome.FAIL)),
    Column("moobd", Kind.REAL, "minimum oob distance", "m"),
    Column("objective", Kind.REAL, "what is minimised instead", "", True),
    Column("place", Kind.REAL, "along the road to where it left or was furthest off", "m", True),
    Column("side", Kind.CHOICE, "left or right, where it left", "", True, choices=get_args(Side)),
    Column("duration", Kind.REAL, "simulated time of the drive", "s", True, 0.0),
    Column("distance", Kind.REALS, "along the road, of each record of the drive", "m"),
    Column("lateral_offset", Kind.REALS, "left of the ego lane's centre line", "m"),
    Column("speed", Kind.REALS, "likewise", "m/s"),
)
"""Name -> column of the table of earlier campaigns' tests, in its order."""
SCREENING_COLUMNS: Final = _by_name(
    Column("candidate_id", Kind.WHOLE, "of the candidate", low=1),
    Column("role", Kind.CHOICE, "whether the twin chose its road", choices=("screened", "control")),
    Column("drawn", Kind.WHOLE, "roads that the twin drove to choose it", low=0),
    Column("outcome", Kind.CHOICE, "of the twin's drive", choices=tuple(Outcome)),
    Column("moobd", Kind.REAL, "of the twin's drive", "m", True),
)
"""Name -> column of the table of screened candidates, in its order."""

RECORD_COLUMNS: Final[Mapping[str, Column]] = MappingProxyType(
    {name: column for name, column in TEST_COLUMNS.items() if name != "finished_at"}
)
"""The columns that make a `TestRecord`."""
_AS_THEY_ARE: Final = tuple(RECORD_COLUMNS.keys() - {"candidate_id", "outcome", *POSE})


_OF_EVALUATION: Final = ("place", "side", "duration", "objective")
_OF_TRACE: Final = ("distance", "lateral_offset", "speed")


# Checksums of rows

CHECKSUM: Final = "checksum"
"""Name of the column with a row's checksum, the last of a table; NULL in rows of old versions."""


def checksum(row: Iterable[object]) -> int:
    """CRC-32 of the other values of a row, in the order of their columns.

    It is that of a JSON list in ASCII, as Python writes it, with the CRC-32 of a blob in its place.
    SQLite knows no negative zero, so it counts as zero.
    """
    values = [
        value + 0.0
        if type(value) is float
        else zlib.crc32(value)
        if type(value) is bytes
        else value
        for value in row
    ]
    return zlib.crc32(json.dumps(values).encode())


def with_checksum(row: tuple[object, ...]) -> tuple[object, ...]:
    """A row with its checksum."""
    return (*row, checksum(row))


def checksum_fault(row: Sequence[object]) -> str:
    """How a row, with its checksum at the end, contradicts that; empty if it does not."""
    *values, stored = row
    if stored is None or stored == checksum(values):
        return ""
    return "does not match its checksum: a value was changed"


# From rows to records


class Fault(NamedTuple):
    """Fault of a value in a row."""

    column: str
    text: str
    """Continues the column's name, after that of the row if needed."""


class RowError(Exception):
    """A row with a value that does not fit its column."""

    def __init__(self, column: str, text: str) -> None:
        super().__init__(f"{column} {text}")
        self.fault = Fault(column, text)


def read_values(
    columns: Mapping[str, Column], row: Iterable[object]
) -> tuple[dict[str, Any], list[Fault]]:
    """The values of a row by their columns' names, as far as they can be read, and their faults.

    A value that can be read, but is none that a campaign writes, is a fault, too.
    """
    values: dict[str, Any] = {}
    faults = []
    for column, value in zip(columns.values(), row, strict=True):
        try:
            values[column.name] = column.read(value)
            column.check(values[column.name])
        except ValueError as error:
            faults.append(Fault(column.name, str(error)))
    return values, faults


def read_row(columns: Mapping[str, Column], row: Iterable[object]) -> dict[str, Any]:
    """The values of a row by their columns' names.

    Raises:
        RowError: some cannot be read.
    """
    values: dict[str, Any] = {}
    try:
        for column, value in zip(columns.values(), row, strict=True):
            values[column.name] = column.read(value)
    except ValueError as error:
        raise RowError(column.name, str(error)) from None
    return values


def read_candidate(row: Iterable[object]) -> tuple[Candidate, int]:
    """The candidate of a row of `CANDIDATE_COLUMNS`, and the number of results told before it.

    Raises:
        RowError: the row is damaged.
    """
    values = read_row(CANDIDATE_COLUMNS, row)
    origin = Origin(values["operator"], values["parents"], values["generation"])
    candidate = Candidate(
        values["id"], values["curvatures"], values["step"], origin, values["points"]
    )
    return candidate, values["asked_after"]


def read_screening(row: Iterable[object]) -> Screening:
    """The screening of a row of `SCREENING_COLUMNS`.

    Raises:
        RowError: the row is damaged.
    """
    values = read_row(SCREENING_COLUMNS, row)
    return Screening(values["role"], values["drawn"], Outcome(values["outcome"]), values["moobd"])


def read_test(
    row: Iterable[object],
    candidate: Candidate,
    trajectory: Trajectory | None = None,
    setting: Setting | None = None,
) -> TestRecord:
    """The record of a row of `TEST_COLUMNS`.

    Raises:
        RowError: the row is damaged.
    """
    values = dict(zip(TEST_COLUMNS, row, strict=True))
    read = read_row(RECORD_COLUMNS, (values[name] for name in RECORD_COLUMNS))
    return record_of(read, candidate, trajectory, setting)


def read_earlier(row: Iterable[object]) -> EarlierTest:
    """The test of a row of `EARLIER_COLUMNS`.

    Raises:
        RowError: the row is damaged.
    """
    values = read_row(EARLIER_COLUMNS, row)
    trace = Trace(*(values[name] for name in _OF_TRACE))
    if not 0 < len(trace.distance) == len(trace.lateral_offset) == len(trace.speed):
        raise RowError("distance", "has not as many records as lateral_offset and speed")
    return EarlierTest(
        values["campaign"],
        values["test"],
        Evaluation(
            Candidate(values["number"], values["curvatures"], values["step"], Origin(EARLIER)),
            Outcome(values["outcome"]),
            values["moobd"],
            0.0,
            **{name: values[name] for name in _OF_EVALUATION},
            read_trace=lambda: trace,
        ),
    )


def record_of(
    values: Mapping[str, Any],
    candidate: Candidate,
    trajectory: Trajectory | None,
    setting: Setting | None,
) -> TestRecord:
    """The record of values that were read from the columns of a test.

    Raises:
        RowError: only a part of the pose is there.
    """
    pose = tuple(values[name] for name in POSE)
    missing = [name for name, value in zip(POSE, pose, strict=True) if value is None]
    if missing and len(missing) < len(POSE):
        raise RowError(missing[0], "is None: only a part of its pose is there")
    return TestRecord(
        candidate=candidate,
        outcome=Outcome(values["outcome"]),
        pose=None if missing else pose,
        trajectory=trajectory,
        setting=setting,
        **{name: values[name] for name in _AS_THEY_ARE},
    )


# From records to rows


def row_of_candidate(candidate: Candidate, asked_after: int) -> tuple[object, ...]:
    """A candidate as a row of `CANDIDATE_COLUMNS`, with the number of results told before it.

    Raises:
        ValueError: a number is not finite.
    """
    origin = candidate.origin
    curvatures, points = candidate.curvatures, candidate.points
    if curvatures.ndim != 1 or not np.isfinite(curvatures).all():
        raise ValueError(f"the curvatures of candidate {candidate.id} are not all finite")
    if points is not None and not (
        points.ndim == 2 and points.shape[1] == 2 and np.isfinite(points).all()
    ):
        raise ValueError(f"the points of candidate {candidate.id} are not pairs of finite numbers")
    if not (math.isfinite(candidate.step) and candidate.step > 0.0):
        raise ValueError(f"step is {candidate.step}: a positive number is needed")
    return (
        int(candidate.id),
        origin.operator,
        json.dumps([int(parent) for parent in origin.parents]),
        int(origin.generation),
        float(candidate.step),
        _as_blob(curvatures),
        asked_after,
        None if points is None else _as_blob(points),
    )


def row_of_earlier(test: EarlierTest) -> tuple[object, ...]:
    """A test of an earlier campaign as a row of `EARLIER_COLUMNS`.

    Raises:
        ValueError: it has no trace.
    """
    told = test.evaluation
    candidate, trace = told.candidate, told.trace
    if trace is None or told.moobd is None:
        raise ValueError(f"test {test.test} of an earlier campaign was not driven")
    values: dict[str, object] = {
        "number": candidate.id,
        "campaign": test.campaign,
        "test": test.test,
        "step": float(candidate.step),
        "curvatures": _as_blob(candidate.curvatures),
        "outcome": str(told.outcome),
        "moobd": float(told.moobd),
        **{name: getattr(told, name) for name in _OF_EVALUATION},
        **{name: _as_blob(getattr(trace, name)) for name in _OF_TRACE},
    }
    return tuple(values[name] for name in EARLIER_COLUMNS)


def _as_blob(values: FloatArray) -> bytes:
    return values.astype("<f8", copy=False).tobytes()


def row_of_screening(candidate: Candidate) -> tuple[object, ...]:
    """A screened candidate as a row of `SCREENING_COLUMNS`."""
    one = candidate.screening
    assert one is not None
    moobd = None if one.moobd is None else float(one.moobd)
    return int(candidate.id), one.role, int(one.drawn), str(one.outcome), moobd


def row_of_test(record: TestRecord, finished_at: str) -> tuple[object, ...]:
    """A record as a row of `TEST_COLUMNS`.

    Raises:
        ValueError: a number is not finite.
    """
    x, y, heading = record.pose or (None, None, None)
    special: dict[str, Any] = {
        "candidate_id": int(record.candidate.id),
        "told": int(record.told),
        "attempts": int(record.attempts),
        "outcome": str(record.outcome),
        "reason": as_text(record.reason),
        "x": x,
        "y": y,
        "heading": heading,
        "finished_at": finished_at,
    }
    row: list[object] = []
    for column in TEST_COLUMNS.values():
        name = column.name
        value = special[name] if name in special else getattr(record, name)
        if column.kind is Kind.REAL and value is not None:
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}: a finite number is needed")
            value = float(value)  # numpy's numbers would be stored as blobs
        row.append(value)
    return tuple(row)


def as_text(reason: str) -> str:
    """A broken driver's message with half characters escaped as in Python."""
    return reason.encode("utf-8", "backslashreplace").decode("utf-8")
