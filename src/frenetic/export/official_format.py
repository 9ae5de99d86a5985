"""The JSON document in which the SBST/SBFT competition (cyber-physical systems) stores a test.

Positions and road are in metres on the map. Values that only a car in BeamNG.tech reports are
approximated, see `SimulationRecord`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.errors import RoadError
from frenetic.export.decimal_text import NEGATIVE_ZERO, TRUTH, decimal_rows
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road, Verdict
from frenetic.road.validity import interpolate

GROUND: Final = -28.0
"""Height of the competition's flat map, in m."""

_DECIMALS: Final = 6  # of numbers in the document: micrometres; our choice
_NEAR_HALF: Final = 1e-3
"""Distance from a half of the last decimal within which numbers are rounded singly; our choice."""


class SimulationRecord(NamedTuple):
    """A record of a drive; the fields have the competition's names and order."""

    timer: float
    """Simulated time, in s."""
    pos: tuple[float, float, float]
    """Centre of mass, in m; z is the height of the ground."""
    dir: tuple[float, float, float]
    """Unit vector in the direction of the car's heading."""
    vel: tuple[float, float, float]
    """Velocity on the map, in m/s."""
    steering: float
    """Angle of the front wheels in degrees, positive to the left.

    BeamNG.tech reports the angle of the steering wheel instead.
    """
    steering_input: float
    """Angle of the front wheels that the driver asked for, in degrees, positive to the left.

    BeamNG.tech reports a share from -1 to 1 instead.
    """
    brake: float
    """Position of the brake pedal, 0..1."""
    brake_input: float
    """Brake that the driver asked for: the same as ``brake``."""
    throttle: float
    """Position of the throttle pedal, 0..1."""
    throttle_input: float
    """Throttle that the driver asked for: the same as ``throttle``."""
    wheelspeed: float
    """Speed of the wheels, in m/s: the car's speed along its heading, as if no wheel slipped."""
    vel_kmh: int
    """Speed on the map, in km/h, rounded."""
    is_oob: bool
    """Whether the share of the car outside its lane is larger than the rules' tolerance."""
    oob_counter: int
    """Number of times that the car has left its lane so far."""
    max_oob_percentage: float
    """Largest share of the car outside since it last left its lane, 0..1; 0 before it ever did."""
    oob_distance: float
    """Half the lane's width minus the distance of ``pos`` from the lane's centre line, in m."""
    oob_percentage: float
    """Share of the car's box outside its lane, 0..1."""


def simulation_records(road: Road, drive: Drive) -> list[SimulationRecord]:
    """Return the records of a drive, up to the record at which a rule ended the drive."""
    columns = {name: values.tolist() for name, values in record_columns(road, drive).items()}
    return [
        SimulationRecord(
            timer=timer,
            pos=(x, y, GROUND),
            dir=(cosine, sine, 0.0),
            vel=(x_speed, y_speed, 0.0),
            steering=steering,
            steering_input=steering_input,
            brake=brake,
            brake_input=brake,
            throttle=throttle,
            throttle_input=throttle,
            **dict(zip(_LAST_NAMES, others, strict=True)),
        )
        for (
            timer, x, y, cosine, sine, x_speed, y_speed, steering, steering_input, brake, throttle,
            *others,
        ) in zip(*columns.values(), strict=True)
    ]  # fmt: skip


_LAST_NAMES: Final = SimulationRecord._fields[10:]
"""Fields of a record from ``wheelspeed`` on, which `record_columns` names alike."""


def record_columns(road: Road, drive: Drive) -> dict[str, npt.NDArray[Any]]:
    """Return the columns of a drive's records, rounded, each (n,).

    The records end with the record at which a rule ended the drive. Fields of `SimulationRecord`
    that hold three numbers have a column for each number that varies; ``brake_input`` and
    ``throttle_input``, which are like ``brake`` and ``throttle``, have none.
    """
    path = drive.trajectory
    if len(path) == 0:
        return {}
    assessment = assess(road, drive)
    n = len(assessment.distance)
    time, x, y, heading, ahead, left, _, steering, steering_input, throttle, brake = (
        getattr(path, name)[:n] for name in path.names()
    )
    shares = assessment.oob_share
    is_oob = shares > drive.rules.oob_tolerance
    leaves = is_oob & ~np.concatenate([[False], is_oob[:-1]])
    cosine, sine = np.cos(heading), np.sin(heading)
    return {
        "timer": _rounded(time),
        "x": _rounded(x),
        "y": _rounded(y),
        "cosine": _rounded(cosine),
        "sine": _rounded(sine),
        "x_speed": _rounded(ahead * cosine - left * sine),
        "y_speed": _rounded(ahead * sine + left * cosine),
        "steering": _rounded(np.degrees(steering)),
        "steering_input": _rounded(np.degrees(steering_input)),
        "brake": brake,
        "throttle": throttle,
        "wheelspeed": _rounded(ahead),
        "vel_kmh": np.rint(3.6 * np.hypot(ahead, left)).astype(np.int64),
        "is_oob": is_oob,
        "oob_counter": np.cumsum(leaves),
        "max_oob_percentage": _rounded(_largest_shares(shares, is_oob, leaves)),
        "oob_distance": _rounded(assessment.oob_distance),
        "oob_percentage": _rounded(shares),
    }


def _largest_shares(
    shares: FloatArray, is_oob: npt.NDArray[np.bool_], leaves: npt.NDArray[np.bool_]
) -> FloatArray:
    """Return the largest share outside since the car last left its lane, (n,); 0 before that."""
    largest = np.zeros(len(shares))
    for first, end in pairwise([*np.flatnonzero(leaves).tolist(), len(shares)]):
        largest[first:end] = np.maximum.accumulate(
            np.where(is_oob[first:end], shares[first:end], 0.0)
        )
    return largest


def _rounded(values: FloatArray) -> FloatArray:
    """Return values with `_DECIMALS` decimals, (n,), as `round` rounds each."""
    scaled = values * 10.0**_DECIMALS
    rounded: FloatArray = np.rint(scaled) / 10.0**_DECIMALS
    # Near a half, the product may be on the other side of it than the number.
    for i in np.flatnonzero(~(np.abs(scaled - np.floor(scaled) - 0.5) > _NEAR_HALF)):
        rounded[i] = round(float(values[i]), _DECIMALS)
    return rounded


def competition_document(
    road: Road | None,
    test_id: int,
    verdict: Verdict | None,
    *,
    outcome: Outcome | None = None,
    description: str = "",
    drive: Drive | None = None,
    points: FloatArray | None = None,
) -> dict[str, Any]:
    """Return a test as a JSON object with the competition's keys, in the competition's order.

    Args:
        road: the road at its place on the map; None if the candidate describes no road.
        test_id: the test's number.
        verdict: whether the road is valid, and why not; None if unknown.
        outcome: outcome of the test. With None or DROPPED the document has no outcome, no
            description and no records.
        description: reason of the outcome.
        drive: the drive; None if nothing was driven.
        points: points through which the road leads, (N, 2) in m; None for a road that is described
            by its curvatures.
    """
    if points is None:
        points = np.empty((0, 2)) if road is None else road.road_points.round(_DECIMALS)
    document: dict[str, Any] = {
        "id": test_id,
        "is_valid": None if verdict is None else verdict.valid,
        "validation_message": None if verdict is None else verdict.message,
        "road_points": points.tolist(),
        "interpolated_points": []
        if road is None
        else [(x, y, GROUND, 2.0 * road.lane_width) for x, y in interpolate(points).tolist()],
    }
    if outcome is not None and outcome.is_test:
        document |= {
            "test_outcome": str(outcome),
            "description": description,
            "execution_data": simulation_records(road, drive) if road and drive else [],
        }
    return document


def stored_test_document(test: Test, *, has_records: bool = True) -> dict[str, Any]:
    """Return a campaign's test as a `competition_document`.

    Args:
        test: the test.
        has_records: whether the document has the records of the drive.
    """
    points, is_invalid = test.candidate.points, test.outcome is Outcome.INVALID
    verdict = Verdict(not is_invalid, test.reason if is_invalid else "")
    return competition_document(
        _road_of(test),
        test.id,
        verdict if test.outcome.is_test else None,
        outcome=test.outcome,
        description=test.reason,
        drive=test.drive if has_records else None,
        points=points,
    )


def stored_test_text(test: Test) -> str:
    """Return the text of a stored test's document, as `json.dumps` would write it.

    A kernel writes the records, which are most of it.
    """
    text = json.dumps(stored_test_document(test, has_records=False), allow_nan=False)
    road, drive = _road_of(test), test.drive
    if not test.outcome.is_test or road is None or drive is None or not len(drive.trajectory):
        return text
    return f"{text.removesuffix('[]}')}[{_records_text(record_columns(road, drive))}]}}"


def _records_text(columns: Mapping[str, npt.NDArray[Any]]) -> str:
    """Return columns of a stored drive's records as JSON, without brackets around all."""
    repeated = [columns[name] for name in _WRITTEN]
    multiples = np.array(
        [
            np.rint(values * 10.0**_DECIMALS) if values.dtype == np.float64 else values
            for values in repeated
        ],
        dtype=np.int64,
    )
    for row, values in zip(multiples, repeated, strict=True):
        row[(row == 0) & np.signbit(values)] = NEGATIVE_ZERO
    decimals = np.array(
        [{np.float64: _DECIMALS, np.bool_: TRUTH}.get(values.dtype.type, 0) for values in repeated]
    )
    rows = decimal_rows(multiples, decimals, _SEPARATORS, has_exponents=True)
    return rows.decode()[: -len(", ")]


_WRITTEN: Final = (
    *("timer", "x", "y", "cosine", "sine", "x_speed", "y_speed", "steering", "steering_input"),
    *("brake", "brake", "throttle", "throttle", *_LAST_NAMES),
)
"""Columns of a record in the order in which its numbers are written."""
_SEPARATORS: Final = [
    b"[",
    b", [",
    b", ",
    f", {GROUND}], [".encode(),
    b", ",
    b", 0.0], [",
    b", ",
    b", 0.0], ",
    *(b", ",) * (len(_WRITTEN) - 8),
    b"], ",
]
"""Texts before each number of a record, and after the last."""


def _road_of(test: Test) -> Road | None:
    """Return the road of a test; None if the candidate describes no road."""
    try:
        return test.road
    except RoadError:
        return None
