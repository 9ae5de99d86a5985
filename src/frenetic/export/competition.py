"""A test as the SBST/SBFT cyber-physical systems competition stores it: one JSON document.

Positions and road are in metres on the map. Values that only a car in BeamNG.tech reports are given
as closely as possible, see `SimulationRecord`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Final

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import TestRecord
from frenetic.oracle import assess
from frenetic.outcome import Outcome
from frenetic.road import Road, Verdict
from frenetic.road.validity import interpolate
from frenetic.simulators.drive import Drive

GROUND: Final = -28.0
"""Height of the competition's flat map, in m."""

_DIGITS: Final = 6  # decimals: micrometres


@dataclass(frozen=True)
class SimulationRecord:
    """One record of a drive; the fields have the competition's names and order."""

    timer: float
    """Simulated time, in s."""
    pos: tuple[float, float, float]
    """Centre of mass, in m; z is the map's ground."""
    dir: tuple[float, float, float]
    """Unit vector along the car."""
    vel: tuple[float, float, float]
    """Vel on the map, in m/s."""
    steering: float
    """Degrees of the front wheels, positive to the left; BeamNG reports the steering wheel's."""
    steering_input: float
    """Degrees that the driver asked for; BeamNG reports -1..1."""
    brake: float
    """0..1."""
    brake_input: float
    """0..1, the same."""
    throttle: float
    """0..1."""
    throttle_input: float
    """0..1, the same."""
    wheelspeed: float
    """Wheelspeed along the car, in m/s: wheels do not slip lengthwise."""
    vel_kmh: int
    """Vel kmh in km/h, rounded."""
    is_oob: bool
    """Whether more of the car is outside its lane than the tolerance."""
    oob_counter: int
    """Number of times it has gone out so far."""
    max_oob_percentage: float
    """Largest share 0..1 outside since it last went out; 0 before it ever did."""
    oob_distance: float
    """Lane half-width minus the distance to the lane's centre line, in m."""
    oob_percentage: float
    """Share 0..1 of the car's box outside its lane."""


# `dataclasses.astuple` copies every value deeply, which takes longer than all the rest.
_values = attrgetter(*(item.name for item in fields(SimulationRecord)))


def simulation_records(road: Road, drive: Drive) -> list[SimulationRecord]:
    """The records of a drive up to the one that ended it, oob values included."""
    path = drive.trajectory
    if len(path) == 0:
        return []
    seen = assess(road, drive)
    columns = {name: getattr(path, name).tolist() for name in path.names()}
    shares, distances = seen.oob_share.tolist(), seen.oob_distance.tolist()
    records: list[SimulationRecord] = []
    was_oob, counter, largest = False, 0, 0.0
    for i, share in enumerate(shares):
        record = {name: column[i] for name, column in columns.items()}
        is_oob = share > drive.rules.oob_tolerance
        if is_oob:
            counter += not was_oob
            largest = max(largest, share) if was_oob else share
        was_oob = is_oob
        c, s = math.cos(record["heading"]), math.sin(record["heading"])
        ahead, left = record["speed"], record["lateral_speed"]
        records.append(
            SimulationRecord(
                timer=round(record["time"], _DIGITS),
                pos=_rounded(record["x"], record["y"], GROUND),
                dir=_rounded(c, s, 0.0),
                vel=_rounded(ahead * c - left * s, ahead * s + left * c, 0.0),
                steering=round(math.degrees(record["steering"]), _DIGITS),
                steering_input=round(math.degrees(record["steering_input"]), _DIGITS),
                brake=record["brake"],
                brake_input=record["brake"],
                throttle=record["throttle"],
                throttle_input=record["throttle"],
                wheelspeed=round(ahead, _DIGITS),
                vel_kmh=round(3.6 * math.hypot(ahead, left)),
                is_oob=is_oob,
                oob_counter=counter,
                max_oob_percentage=round(largest, _DIGITS),
                oob_distance=round(distances[i], _DIGITS),
                oob_percentage=round(share, _DIGITS),
            )
        )
    return records


def simulation_rows(road: Road, drive: Drive) -> list[tuple[Any, ...]]:
    """The values of `simulation_records`, as they stand in a test's JSON document."""
    return [_values(record) for record in simulation_records(road, drive)]


def _rounded(x: float, y: float, z: float) -> tuple[float, float, float]:
    return round(x, _DIGITS), round(y, _DIGITS), round(z, _DIGITS)


def competition_document(
    road: Road,
    test_id: int,
    verdict: Verdict | None,
    *,
    outcome: Outcome | None = None,
    description: str = "",
    drive: Drive | None = None,
    points: FloatArray | None = None,
) -> dict[str, Any]:
    """A test as a JSON object with the competition's keys, in its order.

    Args:
        road: where it lies on the map.
        test_id: the test's number.
        verdict: whether the road is valid; None if unknown.
        outcome: of the test; without one, or dropped, the object has neither an outcome nor what
            belongs to it.
        description: reason of the outcome.
        drive: None without one.
        points: (N, 2) m through which the road was laid, if it was given by points.
    """
    road_points = road.road_points.round(_DIGITS) if points is None else points
    document: dict[str, Any] = {
        "id": test_id,
        "is_valid": None if verdict is None else verdict.valid,
        "validation_message": None if verdict is None else verdict.message,
        "road_points": road_points.tolist(),
        "interpolated_points": [
            (x, y, GROUND, 2.0 * road.lane_width) for x, y in interpolate(road_points).tolist()
        ],
    }
    if outcome is not None and outcome.is_test:
        document |= {
            "test_outcome": str(outcome),
            "description": description,
            "execution_data": [] if drive is None else simulation_rows(road, drive),
        }
    return document


def stored_test_document(test: TestRecord) -> dict[str, Any]:
    """A campaign's test as `competition_document` gives it."""
    is_invalid = test.outcome is Outcome.INVALID
    verdict = Verdict(not is_invalid, test.reason if is_invalid else "")
    return competition_document(
        test.road,
        test.id,
        verdict if test.outcome.is_test else None,
        outcome=test.outcome,
        description=test.reason,
        drive=test.drive,
        points=test.candidate.points,
    )
