"""The columns of a campaign's tables, the same in every format.

Those of tests are declared in `frenetic.campaign.record`; three more are made of them, and the
objective has a table of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from frenetic.campaign.record import CANDIDATE_COLUMNS, TEST_COLUMNS
from frenetic.campaign.record import Column as Column
from frenetic.campaign.record import Kind as Kind
from frenetic.campaign.trajectory_codec import RESOLUTIONS

DERIVED: Final = (
    Column("length", Kind.REAL, "of the road", "m"),
    Column("curvature_count", Kind.WHOLE, "number of curvatures"),
    Column("max_curvature", Kind.REAL, "largest curvature, without its sign", "1/m", True),
)
"""Columns of tests that are not stored."""
OBJECTIVE: Final = Column(
    "objective", Kind.REAL, "what the search minimised, if it is not the MOOBD", "", True
)

_BY_NAME: Final = {
    **TEST_COLUMNS,
    **CANDIDATE_COLUMNS,
    **{column.name: column for column in (*DERIVED, OBJECTIVE)},
}
_ORDER: Final = """
    id told outcome reason operator parents generation asked_after
    length curvature_count max_curvature curvatures step x y heading
    moobd moobd_distance max_oob_share objective duration
    departure_time departure_distance departure_x departure_y departure_side
    seconds elapsed attempts worker budget_spent finished_at
"""

TESTS: Final = tuple(_BY_NAME[name] for name in _ORDER.split())
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
