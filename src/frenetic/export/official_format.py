"""A test as the SBST/SBFT cyber-physical systems competition stores it, and its results folder.

Positions and road are in metres on the map. Values that only a car in BeamNG.tech reports are
approximated, see `SimulationRecord`.
"""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.printable import text_cell
from frenetic.analysis.official_segment import failure_segment
from frenetic.analysis.sparseness import MOST_COMPARED, largest_distances
from frenetic.campaign.configuration import owner_of
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import RoadError
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road, Verdict
from frenetic.road.validity import interpolate

GROUND: Final = -28.0
"""Height of the competition's flat map, in m."""

_DIGITS: Final = 6  # decimals: micrometres


class SimulationRecord(NamedTuple):
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


def simulation_records(road: Road, drive: Drive) -> list[SimulationRecord]:
    """Return the records of a drive, with oob values, up to the record that ended the drive."""
    path = drive.trajectory
    if len(path) == 0:
        return []
    assessment = assess(road, drive)
    columns = {name: getattr(path, name).tolist() for name in path.names()}
    shares, distances = assessment.oob_share.tolist(), assessment.oob_distance.tolist()
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


def _rounded(x: float, y: float, z: float) -> tuple[float, float, float]:
    return round(x, _DIGITS), round(y, _DIGITS), round(z, _DIGITS)


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
        road: the road at its place on the map; None if the proposal describes no road.
        test_id: the test's number.
        verdict: whether the road is valid; None if unknown.
        outcome: outcome of the test; None or DROPPED leaves out the outcome, its description and
            the records.
        description: reason of the outcome.
        drive: the drive; None if nothing was driven.
        points: points through which the road leads, (N, 2) in m; None for a road of curvatures.
    """
    if points is None:
        points = np.empty((0, 2)) if road is None else road.road_points.round(_DIGITS)
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
    """Return the road of a test; None if the proposal describes no road."""
    try:
        return test.road
    except RoadError:
        return None


# The results folder


def write_competition_folder(
    folder: Path,
    store: CampaignStore,
    *,
    outcomes: Collection[Outcome],
    driven: Collection[Outcome],
    on_test: Callable[[int], None],
) -> None:
    """Write a file per road test, and three tables about the whole campaign.

    DROPPED candidates are no road tests and have no file. The tables cover all tests, with or
    without a file. A cell of unknown value is empty: ``time_budget`` without a time budget,
    ``real_time_generation`` where several tests were driven at once, and sparseness for fewer than
    two failures or more than `MOST_COMPARED`.

    Args:
        folder: an empty folder.
        store: the campaign.
        outcomes: outcomes of the tests that get a file.
        driven: outcomes of the tests whose files hold execution data.
        on_test: called with the number of tests so far.

    Raises:
        CampaignError: the campaign is damaged.
        OSError: a file cannot be written.
    """
    compared = store.by_outcome()[Outcome.FAIL] <= MOST_COMPARED
    numbers: Counter[Outcome] = Counter()
    by_side: Counter[str] = Counter()
    segments: list[FloatArray] = []
    driven_for = simulated = elapsed = 0.0
    for done, record in enumerate(store.tests(), start=1):
        outcome, departure = record.outcome, record.departure
        on_test(done)
        if not outcome.is_test:
            continue
        numbers[outcome] += 1
        simulated += record.result.duration or 0.0
        driven_for += 0.0 if outcome is Outcome.INVALID else record.seconds
        elapsed = record.elapsed
        if outcome is Outcome.FAIL and departure is not None:
            by_side[str(departure.side)] += 1
            if compared and (segment := failure_segment(record)) is not None:
                segments.append(segment)
        if outcome in outcomes:
            _write_test(folder, store.test(record.id) if outcome in driven else record)
    alone = store.config.get("workers", 1) == 1 and store.config.get("cluster") is None
    generation = {
        "test_generated": numbers.total(),
        "test_valid": numbers.total() - numbers[Outcome.INVALID],
        "test_invalid": numbers[Outcome.INVALID],
        "test_passed": numbers[Outcome.PASS],
        "test_failed": numbers[Outcome.FAIL],
        "test_in_error": numbers[Outcome.ERROR],
        "real_time_generation": round(elapsed - driven_for, 3) if alone else None,
        "real_time_execution": round(driven_for, 3),
        "simulated_time_execution": round(simulated, 3),
    }
    _write_row(folder / "generation_stats.csv", generation)
    _write_row(folder / "oob_stats.csv", _oob_row(by_side, segments))
    _write_row(folder / "experiment_description.csv", _experiment(store))


def _write_test(folder: Path, test: Test) -> None:
    path = folder / f"test.{test.id:04d}.json"
    text = json.dumps(stored_test_document(test), allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8")


def _oob_row(by_side: Counter[str], segments: Sequence[FloatArray]) -> dict[str, object]:
    """Return the row of oob_stats.csv: failures by side, and their sparseness."""
    distances = largest_distances(segments)
    return {
        "total_oob": by_side.total(),
        "left_oob": by_side["left"],
        "right_oob": by_side["right"],
        "avg_sparseness": round(float(distances.mean()), 6) if len(distances) else None,
        "stdev_sparseness": round(float(distances.std()), 6) if len(distances) else None,
    }


def _experiment(store: CampaignStore) -> dict[str, object]:
    """Return the row of experiment_description.csv: options of the competition's command line."""
    config = store.config
    rules = _mapping(config.get("rules"))
    module, _, name = str(_mapping(config.get("strategy")).get("class", "")).rpartition(":")
    owner = owner_of(config)
    time_budget = _mapping(store.facts.get("budget", config.get("budget"))).get("time")
    if owner is not None and owner.time_budget is not None:
        time_budget = owner.time_budget
    return {
        "executor": str(_mapping(config.get("simulator")).get("class", "")).rpartition(":")[2],
        "time_budget": time_budget,
        "map_size": config.get("map_size"),
        "oob_tolerance": rules.get("oob_tolerance"),
        "speed_limit": rules.get("speed_limit"),
        "module_name": module,
        "class_name": name,
    }


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _write_row(path: Path, row: Mapping[str, object]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(row), lineterminator="\n")
        writer.writeheader()
        writer.writerow({k: text_cell(v) if isinstance(v, str) else v for k, v in row.items()})
