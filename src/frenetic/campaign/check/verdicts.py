"""The check that judges stored drives and roads again.

A stored trajectory is rounded, see `frenetic.campaign.trajectory_codec`, so its numbers differ a
little from those of the drive. Rarely, this moves a record across the limit of a rule, and the
drive ends a record earlier or later, or not at all. So a differing verdict is given again with
every limit a little tighter and a little looser; the stored one must be among these.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

from frenetic.campaign.record import Setting, TestRecord
from frenetic.errors import RoadError
from frenetic.oracle import Result, judge
from frenetic.road import Road, check_validity
from frenetic.simulators.drive import Drive, Rules, Trajectory

MOOBD_TOLERANCE: Final = 1e-4
"""Largest difference of MOOBD, in m.

x and y are stored to within 0.05 mm each, which moves a car by at most 0.071 mm.
"""
SHARE_TOLERANCE: Final = 2e-4
"""Largest difference of oob shares: a point of the car's box moves by less than 0.1 mm."""
TIME_TOLERANCE: Final = 1e-4
"""Largest difference of times, in s; they are stored to within 0.05 ms."""
DISTANCE_TOLERANCE: Final = 1e-3
"""Largest difference along the road, in m: inside a bend a place moves further than the car."""


def judged_otherwise(record: TestRecord, trajectory: Trajectory, setting: Setting) -> str:
    """Difference of the verdict on a PASS or FAIL drive from the stored one.

    Empty if there is none beyond rounding.
    """
    try:
        road = record.road
    except RoadError as error:
        return f"it was driven, but its road is none: {error}"
    first = ""
    for rules in _rules(setting.rules):
        verdict = judge(road, Drive(trajectory, setting.car, rules))
        difference = _difference(record, verdict)
        if not difference:
            return ""
        first = first or difference
    return first


def _rules(rules: Rules) -> Iterator[Rules]:
    """The rules, then with every limit a little tighter, then a little looser."""
    yield rules
    for sign in (-1.0, 1.0):
        yield replace(
            rules,
            oob_tolerance=min(rules.oob_tolerance + sign * SHARE_TOLERANCE, 1.0),
            goal_distance=rules.goal_distance - sign * MOOBD_TOLERANCE,
            # Both ends of the car's movement are rounded.
            stuck_distance=rules.stuck_distance - 2.0 * sign * MOOBD_TOLERANCE,
            stuck_time=rules.stuck_time + sign * TIME_TOLERANCE,
            timeout_base=rules.timeout_base + sign * TIME_TOLERANCE,
        )


def _difference(record: TestRecord, verdict: Result) -> str:
    if verdict.outcome is not record.outcome:
        again = f"judged again it is {verdict.outcome}: {verdict.reason}"
        return f"it is stored as {record.outcome}, {again}"
    place = verdict.departure
    now: tuple[tuple[str, Any, float, str], ...] = (
        ("moobd", verdict.moobd, MOOBD_TOLERANCE, " m"),
        ("max_oob_share", verdict.max_oob_share, SHARE_TOLERANCE, ""),
        ("duration", verdict.duration, TIME_TOLERANCE, " s"),
        ("departure_time", place and place.time, TIME_TOLERANCE, " s"),
        ("departure_distance", place and place.distance, DISTANCE_TOLERANCE, " m"),
        ("departure_x", place and place.x, MOOBD_TOLERANCE, " m"),
        ("departure_y", place and place.y, MOOBD_TOLERANCE, " m"),
    )
    for column, value, tolerance, unit in now:
        stored = getattr(record, column)
        if stored is None and value is None:
            continue
        if stored is None or value is None or not abs(stored - value) <= tolerance:
            old, new = (_number(number, unit) for number in (stored, value))
            return f"{column} is stored as {old}, judged again it is {new}"
    if place is not None and place.side != record.departure_side:
        return f"it left to the {record.departure_side}, judged again to the {place.side}"
    return ""


def _number(value: float | None, unit: str) -> str:
    return "nothing" if value is None else f"{value:.6g}{unit}"


def refused_otherwise(record: TestRecord, setting: Setting) -> str:
    """Finding if a refused road is valid; otherwise empty."""
    try:
        if record.candidate.points is not None:
            verdict = check_validity(record.candidate.points, setting.map_size)
        else:
            candidate = record.candidate
            road = Road(candidate.curvatures, candidate.step, lane_width=setting.lane_width)
            _, verdict = road.placed(setting.map_size, setting.margin)
    except RoadError:
        return ""
    return "it is stored as INVALID, but its road is valid" if verdict.valid else ""
