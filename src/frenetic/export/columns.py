"""The columns of a campaign's tables, the same in every format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from types import MappingProxyType
from typing import Final

from frenetic.campaign.trajectory_codec import RESOLUTIONS


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


@dataclass(frozen=True)
class Column:
    """A column of a table."""

    name: str
    kind: Kind
    description: str
    unit: str = ""
    """Unit, empty for a text, a share or a number."""
    optional: bool = False
    """Whether values may be missing."""


TESTS: Final = (
    Column("id", Kind.WHOLE, "of the candidate: counts from 1 in the order of asking"),
    Column("told", Kind.WHOLE, "counts from 1 in the order of telling"),
    Column("outcome", Kind.CHOICE, "PASS, FAIL, INVALID, ERROR or DROPPED"),
    Column("reason", Kind.TEXT, "why it ended so"),
    Column("operator", Kind.CHOICE, "what made the road: random, P1 .. P6, F1 .. F4, C1, C2"),
    Column("parents", Kind.WHOLES, "ids of the candidates it was made from"),
    Column("generation", Kind.WHOLE, "0 for a random road"),
    Column("asked_after", Kind.WHOLE, "results that had been told when it was asked"),
    Column("length", Kind.REAL, "of the road", "m"),
    Column("curvature_count", Kind.WHOLE, "number of curvatures"),
    Column("max_curvature", Kind.REAL, "largest curvature, without its sign", "1/m", True),
    Column("curvatures", Kind.REALS, "positive to the left, linear in between", "1/m"),
    Column("step", Kind.REAL, "between two curvatures", "m"),
    Column("x", Kind.REAL, "of the pose in which the road starts on the map", "m", True),
    Column("y", Kind.REAL, "likewise", "m", True),
    Column("heading", Kind.REAL, "likewise, counter-clockwise from +x", "rad", True),
    Column("moobd", Kind.REAL, "minimum oob distance", "m", True),
    Column("moobd_distance", Kind.REAL, "along the road to where that was", "m", True),
    Column("max_oob_share", Kind.REAL, "largest share of the car outside its lane", "", True),
    Column("duration", Kind.REAL, "simulated time of the drive", "s", True),
    Column("departure_time", Kind.REAL, "when the car left its lane", "s", True),
    Column("departure_distance", Kind.REAL, "along the road to where it left", "m", True),
    Column("departure_x", Kind.REAL, "where it left", "m", True),
    Column("departure_y", Kind.REAL, "where it left", "m", True),
    Column("departure_side", Kind.CHOICE, "left or right", "", True),
    Column("seconds", Kind.REAL, "wall time of the test", "s"),
    Column("elapsed", Kind.REAL, "the campaign's time when it was told", "s", True),
    Column("attempts", Kind.WHOLE, "how often it was tried"),
    Column("worker", Kind.CHOICE, "who drove it", "", True),
    Column("budget_spent", Kind.REAL, "share of the budget when it was told"),
    Column("finished_at", Kind.MOMENT, "when it was told"),
)
"""The table of tests: one row per candidate that was told."""

_DRIVEN: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "time": ("since the start of the drive", "s"),
        "x": ("centre of mass", "m"),
        "y": ("centre of mass", "m"),
        "heading": ("counter-clockwise from +x, unwrapped", "rad"),
        "speed": ("along the car", "m/s"),
        "lateral_speed": ("across the car, positive to the left", "m/s"),
        "yaw_rate": ("positive to the left", "rad/s"),
        "steering": ("angle of the front wheels, positive to the left", "rad"),
        "steering_input": ("the angle that the driver asked for", "rad"),
        "throttle": ("0..1, as the driver asked", ""),
        "brake": ("0..1, as the driver asked", ""),
    }
)

TRAJECTORIES: Final = (
    Column("id", Kind.WHOLE, "of the test"),
    *(Column(name, Kind.REAL, *_DRIVEN[name]) for name in RESOLUTIONS),
)
"""The table of trajectories: one row per record of a drive."""

TABLES: Final[Mapping[str, tuple[Column, ...]]] = MappingProxyType(
    {"tests": TESTS, "trajectories": TRAJECTORIES}
)
"""Name of a table -> its columns."""
