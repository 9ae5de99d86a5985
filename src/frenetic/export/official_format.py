"""The JSON document in which the SBST/SBFT competition (cyber-physical systems) stores a test.

Positions and road are in metres on the map. Values that only a car in BeamNG.tech reports are
approximated, see `SimulationRecord`.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.record import Test
from frenetic.errors import RoadError
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road, Verdict
from frenetic.road.validity import interpolate

GROUND: Final = -28.0
"""Height of the competition's flat map, in m."""

_DECIMALS: Final = 6  # of numbers in the document: micrometres; our choice


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
    path = drive.trajectory
    if len(path) == 0:
        return []
    assessment = assess(road, drive)
    columns = {name: getattr(path, name).tolist() for name in path.names()}
    shares, distances = assessment.oob_share.tolist(), assessment.oob_distance.tolist()
    records: list[SimulationRecord] = []
    was_oob, oob_counter, largest_share = False, 0, 0.0
    for i, share in enumerate(shares):
        record = {name: column[i] for name, column in columns.items()}
        is_oob = share > drive.rules.oob_tolerance
        if is_oob:
            oob_counter += not was_oob
            largest_share = max(largest_share, share) if was_oob else share
        was_oob = is_oob
        cosine, sine = math.cos(record["heading"]), math.sin(record["heading"])
        ahead, left = record["speed"], record["lateral_speed"]
        records.append(
            SimulationRecord(
                timer=round(record["time"], _DECIMALS),
                pos=_rounded(record["x"], record["y"], GROUND),
                dir=_rounded(cosine, sine, 0.0),
                vel=_rounded(ahead * cosine - left * sine, ahead * sine + left * cosine, 0.0),
                steering=round(math.degrees(record["steering"]), _DECIMALS),
                steering_input=round(math.degrees(record["steering_input"]), _DECIMALS),
                brake=record["brake"],
                brake_input=record["brake"],
                throttle=record["throttle"],
                throttle_input=record["throttle"],
                wheelspeed=round(ahead, _DECIMALS),
                vel_kmh=round(3.6 * math.hypot(ahead, left)),
                is_oob=is_oob,
                oob_counter=oob_counter,
                max_oob_percentage=round(largest_share, _DECIMALS),
                oob_distance=round(distances[i], _DECIMALS),
                oob_percentage=round(share, _DECIMALS),
            )
        )
    return records


def _rounded(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a vector with `_DECIMALS` decimals."""
    return round(x, _DECIMALS), round(y, _DECIMALS), round(z, _DECIMALS)


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


def stored_test_document(test: Test) -> dict[str, Any]:
    """Return a campaign's test as a `competition_document`."""
    points, is_invalid = test.candidate.points, test.outcome is Outcome.INVALID
    verdict = Verdict(not is_invalid, test.reason if is_invalid else "")
    return competition_document(
        _road_of(test),
        test.id,
        verdict if test.outcome.is_test else None,
        outcome=test.outcome,
        description=test.reason,
        drive=test.drive,
        points=points,
    )


def _road_of(test: Test) -> Road | None:
    """Return the road of a test; None if the candidate describes no road."""
    try:
        return test.road
    except RoadError:
        return None
