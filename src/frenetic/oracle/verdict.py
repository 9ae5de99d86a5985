"""The verdict on a drive: outcome, reason, how far the car left its lane, where and on which side.

The kernel `assess_record` holds the rules for ending a drive. It assesses one record. Simulators
call it after every record to know when to stop, and `judge` calls it for each record of a
trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, NotNegative, Share
from frenetic._support.compiled import njit
from frenetic._support.words import simulated_time
from frenetic.criteria.criterion import DRIVER, LANE, CriteriaSet, signal_named
from frenetic.errors import Fault, FreneticError, Trouble
from frenetic.oracle.lane_share import share_outside
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import LocatedDrive, measure
from frenetic.road.geometry import heading_at, project_global, project_near, reach_of
from frenetic.road.profile import value_at

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive, Rules
    from frenetic.road import Road

Side: TypeAlias = Literal["left", "right"]

RUNNING, REACHED, LEFT_LANE, STUCK, TIMED_OUT = range(5)
"""States of a drive at a record: the drive goes on, or how it ended."""

BEHAVIOUR: Final = 2
"""Version of the rules: raised when the same drive is judged otherwise; campaigns record it."""

# Columns of the assessment of a trajectory, one row per record.
DISTANCE, OFFSET, OOB_SHARE = range(3)


@dataclass(frozen=True)
class Finding:
    """One breach of a criterion in a drive."""

    criterion: str
    """`LANE`, `DRIVER` or the name of a signal, see `frenetic.criteria.criterion`."""
    value: Finite
    """Value that breached the criterion."""
    limit: Finite
    """Limit of that value."""
    side: Side | None
    """Side of the ego lane, or to which the value points; None if the criterion has no sides."""
    time: NotNegative
    """Simulated time, in s."""
    distance: Finite
    """Distance along the road, in m."""
    x: Finite
    """Coordinate of the centre of mass, in m."""
    y: Finite
    """Coordinate of the centre of mass, in m."""

    @classmethod
    def departure(
        cls,
        side: Side,
        distance: float,
        *,
        oob_share: float = 1.0,
        time: float = 0.0,
        x: float = 0.0,
        y: float = 0.0,
    ) -> Finding:
        """Return the finding that a car left its lane, with defaults for unknown values.

        Args:
            side: side of the lane on which the car left it.
            distance: distance along the road, in m.
            oob_share: share of the car's box outside the lane, 0..1.
            time: simulated time, in s.
            x: coordinate of the centre of mass, in m.
            y: coordinate of the centre of mass, in m.
        """
        return cls(LANE, oob_share, oob_share, side, time, distance, x, y)


@dataclass(frozen=True)
class Result:
    """The verdict on a `Drive` along its road."""

    outcome: Outcome
    reason: str
    """The reason, in one sentence."""
    moobd: Finite | None = None
    """Minimum oob distance, in m; None unless PASS or FAIL, or if it was not measured."""
    moobd_distance: Finite | None = None
    """Distance along the road where the oob distance was least, in m; None with the MOOBD."""
    max_oob_share: Share | None = None
    """Largest share 0..1 of the car's box outside the ego lane; None with the MOOBD."""
    duration: NotNegative | None = None
    """Simulated time until the drive ended, in s; None if nothing was driven."""
    findings: tuple[Finding, ...] = ()
    """Breaches of the criteria, in the order of time."""
    fault: Fault | None = None
    """Fault that ended the drive: a driver's makes it a FAIL, a simulator's an ERROR."""

    @property
    def finding(self) -> Finding | None:
        """Gravest breach: the one that ended the drive, or else the first; None without breach."""
        ends = (finding for finding in self.findings if finding.criterion in (LANE, DRIVER))
        return next(ends, self.findings[0] if self.findings else None)

    @property
    def departure(self) -> Finding | None:
        """Finding that the car left its lane by more than the tolerance; None if it did not."""
        return next((finding for finding in self.findings if finding.criterion == LANE), None)

    def as_json(self) -> dict[str, Any]:
        """Return the fields, for JSON."""
        findings = [
            asdict(finding) | {"time": simulated_time(finding.time)} for finding in self.findings
        ]
        return asdict(self) | {"duration": simulated_time(self.duration), "findings": findings}


@njit()
def assess_record(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    times: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    heading: float,
    i: int,
    s_before: float,
    least: float,
) -> tuple[int, float, float, float, float]:
    """Return the assessment of record ``i``: (end, s, d, road heading, oob share).

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        lane_width: m.
        rules: `rules_array`.
        car: (3,) length, width, centre_ahead in m.
        times, xs, ys: columns of the trajectory, filled up to ``i``.
        heading: heading of the car at record ``i``, in rad.
        s_before: distance along the road at record ``i - 1``, in m; not used for record 0.
        least: the kernel may return 0 for an oob share that is surely below this one, which is at
            most the tolerance.
    """
    x, y = xs[i], ys[i]
    if i == 0:
        s, d = project_global(table, ds, x, y)
    else:
        moved = math.hypot(x - xs[i - 1], y - ys[i - 1])
        s, d = project_near(table, ds, x, y, s_before, reach_of(moved))
    road_heading = heading_at(table, ds, s)
    share = share_outside(
        table,
        ds,
        0.0,
        -lane_width,
        s,
        d,
        road_heading,
        x,
        y,
        heading,
        car[0],
        car[1],
        car[2],
        least,
    )
    tolerance, goal, stuck_distance = rules[0], rules[1], rules[2]
    stuck_time, timeout = rules[3], rules[4]
    last = len(table) - 1
    end = RUNNING
    if share > tolerance:
        end = LEFT_LANE
    elif (
        # Near the centre line's end, or at the end of a lane that is too wide to come near it.
        math.hypot(x - table[last, 0], y - table[last, 1]) <= goal and s >= last * ds - 2.0 * goal
    ) or (s >= last * ds - 1e-9 and -lane_width <= d <= 0.0):
        end = REACHED
    elif _is_stuck(times, xs, ys, i, stuck_distance, stuck_time):
        end = STUCK
    elif times[i] > timeout:
        end = TIMED_OUT
    return end, s, d, road_heading, share


@njit()
def _is_stuck(
    times: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    i: int,
    stuck_distance: float,
    stuck_time: float,
) -> bool:
    """Return whether a car at record ``i`` is too near to its place ``stuck_time`` s before."""
    # Find the latest record that is at least stuck_time old. The first guess assumes a steady rate
    # of records; the loops correct it.
    passed = times[i] - times[i - 1] if i > 0 else 0.0
    j = max(0, i - int(stuck_time / passed)) if passed > 0.0 else i
    while j < i and times[i] - times[j + 1] >= stuck_time - 1e-9:
        j += 1
    while j > 0 and times[i] - times[j] < stuck_time - 1e-9:
        j -= 1
    return bool(
        times[i] - times[j] >= stuck_time - 1e-9
        and math.hypot(xs[i] - xs[j], ys[i] - ys[j]) < stuck_distance
    )


@njit()
def _assess(
    table: FloatArray,
    ds: float,
    lane_width: float,
    rules: FloatArray,
    car: FloatArray,
    times: FloatArray,
    xs: FloatArray,
    ys: FloatArray,
    headings: FloatArray,
    least: float,
) -> tuple[int, FloatArray]:
    """Return how the drive ended, and distance, lateral offset and oob share, (n, 3)."""
    n = len(times)
    rows = np.empty((n, 3))
    s = 0.0
    for i in range(n):
        end, s, d, _, share = assess_record(
            table, ds, lane_width, rules, car, times, xs, ys, headings[i], i, s, least
        )
        rows[i, 0] = s
        rows[i, 1] = d
        rows[i, 2] = share
        if end != 0:
            return end, rows[: i + 1]
    return 0, rows


def rules_array(rules: Rules, road_length: float) -> FloatArray:
    """Return the rules for `assess_record`: tolerance, goal, stuck distance and time, timeout."""
    return np.array(
        [
            rules.oob_tolerance,
            rules.goal_distance,
            rules.stuck_distance,
            rules.stuck_time,
            rules.timeout(road_length),
        ]
    )


@dataclass(frozen=True)
class Assessment:
    """Place and lane share of each record of a drive, up to the record that ended it."""

    end: int
    """RUNNING, REACHED, LEFT_LANE, STUCK or TIMED_OUT."""
    distance: FloatArray
    """Distance along the road, (n,) in m."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""
    oob_distance: FloatArray
    """Oob distance, (n,) in m, see `Result.moobd`."""
    oob_share: FloatArray
    """Share of the car's box outside the ego lane, (n,), 0..1."""


def assess(road: Road, drive: Drive, *, has_shares: bool = True) -> Assessment:
    """Return place, lateral offset, oob distance and oob share of each record of a drive.

    Args:
        road: the road that was driven.
        drive: the drive along that road.
        has_shares: whether all oob shares are needed; otherwise shares below the tolerance may be
            0.
    """
    t = drive.trajectory
    end, rows = _assess(
        road.table,
        road.sub_step,
        road.lane_width,
        rules_array(drive.rules, road.length),
        drive.car.to_array(),
        # Copies: a kernel is compiled anew for read-only arrays, and the rollout's are writable.
        np.array(t.time),
        np.array(t.x),
        np.array(t.y),
        np.array(t.heading),
        0.0 if has_shares else drive.rules.oob_tolerance,
    )
    half = 0.5 * road.lane_width
    offset = rows[:, OFFSET] + half
    oob_distance = half - np.abs(offset)
    if len(road.widening):
        right = half + offset + value_at(road.widening, rows[:, DISTANCE])
        oob_distance = np.minimum(half - offset, right)
    return Assessment(end, rows[:, DISTANCE], offset, oob_distance, rows[:, OOB_SHARE])


def _rounded_up(share: float) -> str:
    """Return a share in percent, never rounded below its value."""
    return f"{math.ceil(share * 1000.0 - 1e-9) / 10.0:g}%"


def judge(road: Road, drive: Drive) -> Result:
    """Return the verdict on one drive of a road.

    Records count until a rule ends the drive. A drive that a fault of its driver ended is a FAIL.
    A drive is an ERROR if it stops before any rule ends it, or if another part broke.
    """
    path = drive.trajectory
    records = len(path)
    trouble = drive.trouble
    if records == 0 or (trouble is not None and not is_drivers(trouble.fault)):
        duration = float(path.time[-1]) if records else 0.0
        return unusable_result(trouble or Trouble("The simulator recorded nothing"), duration)
    if not all(np.isfinite(column).all() for column in (path.time, path.x, path.y, path.heading)):
        return unusable_result(
            trouble or Trouble("The simulator recorded places that are no numbers")
        )
    assessment = assess(road, drive)
    duration = float(path.time[len(assessment.distance) - 1])
    end = _drive_end(road, drive, assessment)
    if end is None:
        reason = f"The simulator stopped after {duration:.1f} s, before the drive had ended"
        return Result(Outcome.ERROR, reason, duration=duration)
    outcome, reason, findings = end.outcome, end.reason, end.findings
    if drive.rules.criteria:
        try:
            breaches = _breaches(road, drive, assessment)
        except FreneticError as error:
            return unusable_result(Trouble(str(error)), duration)
        findings = tuple(sorted((*breaches, *findings), key=lambda finding: finding.time))
        if breaches and outcome is Outcome.PASS:
            outcome, reason = Outcome.FAIL, breach_text(breaches, drive.rules.criteria)
    least = int(np.argmin(assessment.oob_distance))
    return Result(
        outcome,
        reason,
        float(assessment.oob_distance[least]),
        float(assessment.distance[least]),
        float(assessment.oob_share.max()),
        duration,
        findings,
        end.fault,
    )


@dataclass(frozen=True)
class _DriveEnd:
    """How a drive ended, before the criteria beside the lane are judged."""

    outcome: Outcome
    reason: str
    findings: tuple[Finding, ...] = ()
    fault: Fault | None = None


def _drive_end(road: Road, drive: Drive, assessment: Assessment) -> _DriveEnd | None:
    """Return how a drive ended; None if neither a rule nor the driver ended it."""
    rules, path = drive.rules, drive.trajectory
    i = len(assessment.distance) - 1
    distance = float(assessment.distance[i])
    place = float(path.time[i]), distance, float(path.x[i]), float(path.y[i])
    if assessment.end == REACHED:
        return _DriveEnd(Outcome.PASS, "Car reached the end of the road")
    if assessment.end == LEFT_LANE:
        side: Side = "left" if assessment.lateral_offset[i] > 0.0 else "right"
        share = float(assessment.oob_share[i])
        reason = (
            f"Car drove out of the lane to the {side} after {distance:.0f} m:"
            f" {_rounded_up(share)} of it outside, {rules.oob_tolerance * 100:g}% tolerated"
        )
        departure = Finding(LANE, share, rules.oob_tolerance, side, *place)
        return _DriveEnd(Outcome.FAIL, reason, (departure,))
    if assessment.end == STUCK:
        reason = (
            f"Car moved less than {rules.stuck_distance:g} m in {rules.stuck_time:g} s"
            f" at {distance:.0f} m"
        )
        return _DriveEnd(Outcome.FAIL, reason)
    if assessment.end == TIMED_OUT:
        reason = (
            f"Car took longer than {rules.timeout(road.length):.0f} s"
            f" and was at {distance:.0f} m of {road.length:.0f} m"
        )
        return _DriveEnd(Outcome.FAIL, reason)
    if (trouble := drive.trouble) is not None:
        finding = Finding(DRIVER, 1.0, 0.0, None, *place)
        return _DriveEnd(Outcome.FAIL, trouble.reason, (finding,), trouble.fault)
    return None


def locate_drive(road: Road, drive: Drive, assessment: Assessment | None = None) -> LocatedDrive:
    """Return a drive with the place of each record along its road, for its criteria."""
    if assessment is None:
        assessment = assess(road, drive)
    return LocatedDrive.of(road, drive, assessment.distance, assessment.lateral_offset)


def _breaches(road: Road, drive: Drive, assessment: Assessment) -> list[Finding]:
    """Return the findings of the criteria beside the lane, each where its value is worst.

    Raises:
        FreneticError: a signal cannot be measured.
    """
    located = locate_drive(road, drive, assessment)
    path = located.path
    if not np.isfinite(path.to_rows()).all():
        raise FreneticError(
            "The simulator recorded values that are no numbers: they cannot be judged"
        )
    findings = []
    for criterion in drive.rules.criteria.criteria:
        worst_value = measure(criterion, located)
        if worst_value is not None and worst_value.margin < 0.0:
            i = worst_value.record
            findings.append(
                Finding(
                    criterion.signal,
                    worst_value.value,
                    criterion.limit,
                    worst_value.side,
                    float(path.time[i]),
                    worst_value.distance,
                    float(path.x[i]),
                    float(path.y[i]),
                )
            )
    return findings


def breach_text(findings: Sequence[Finding], criteria: CriteriaSet) -> str:
    """Return the breaches of criteria beside the lane, in a sentence; empty without breaches."""
    limits = {criterion.signal: criterion for criterion in criteria.criteria}
    texts = []
    for finding in findings:
        if finding.criterion in limits:
            limited = signal_named(finding.criterion)
            side = ""
            if finding.side:
                side = f" {'to' if limited.has_sides else 'on'} the {finding.side}"
            text = f"{limited.words} {limited.text(finding.value)}{side}"
            limit = limits[finding.criterion].text()
            texts.append(f"{text} at {finding.distance:.0f} m ({limit})")
    text = "; ".join(texts)
    return text[:1].upper() + text[1:]


def is_drivers(fault: Fault | None) -> bool:
    """Return whether a fault is the driver's."""
    return fault is not None and fault.part == "driver"


def unusable_result(trouble: Trouble, duration: float | None = None) -> Result:
    """Return the verdict on an unusable drive: FAIL if the fault is the driver's, else ERROR."""
    outcome = Outcome.FAIL if is_drivers(trouble.fault) else Outcome.ERROR
    return Result(outcome, trouble.reason, duration=duration, fault=trouble.fault)
