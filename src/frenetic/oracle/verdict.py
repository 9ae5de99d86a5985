"""The verdict on a drive: outcome, reason, how far the car left its lane, where and on which side.

One kernel holds the rules for ending a drive. It assesses one record: simulators call it after
every record to know when to stop, and `judge` calls it over a whole trajectory.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, NotNegative, Share
from frenetic._support.compiled import njit
from frenetic._support.words import simulated_time
from frenetic.criteria.criterion import DRIVER, LANE, QUANTITIES, Criterion, Profile, quantity
from frenetic.errors import Fault, FreneticError, Trouble
from frenetic.oracle.lane_share import share_outside
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import Measured, Seen, measure, worst
from frenetic.road.geometry import heading_at, project_global, project_near, reach_of
from frenetic.road.profile import value_at

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive, Rules
    from frenetic.road import Road

Side: TypeAlias = Literal["left", "right"]

RUNNING, REACHED, LEFT_LANE, STUCK, TIMED_OUT = range(5)
"""State of a drive at a record: it goes on, or how it ended."""

BEHAVIOUR: Final = 2
"""Raised when the same drive is judged otherwise; campaigns record it."""

# Columns of the assessment of a trajectory, one row per record.
DISTANCE, OFFSET, OOB_SHARE = range(3)


@dataclass(frozen=True)
class Finding:
    """One breach of a criterion in a drive."""

    criterion: str
    """`LANE`, `DRIVER` or the name of a quantity, see `frenetic.criteria.criterion`."""
    value: Finite
    """Value that breached it."""
    limit: Finite
    """Limit of that value."""
    side: Side | None
    """Side of the ego lane, or to which the value is; None if the criterion knows none."""
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
        """Return the finding that a car left its lane, for whoever knows only some of it.

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
    """Minimum oob distance, in m; None unless PASS or FAIL, or if nobody measured it."""
    moobd_distance: Finite | None = None
    """Distance along the road where the oob distance was least, in m; None with the MOOBD."""
    max_oob_share: Share | None = None
    """Largest share 0..1 of the car's box outside the ego lane; None with the MOOBD."""
    duration: NotNegative | None = None
    """Simulated time until the drive ended, in s; None if nothing was driven."""
    findings: tuple[Finding, ...] = ()
    """Breaches of the criteria, in the order of time."""
    fault: Fault | None = None
    """The fault that ended the drive: the driver's makes it a FAIL, the simulator's an ERROR."""

    @property
    def finding(self) -> Finding | None:
        """The gravest breach: what ended the drive, or else the first; None if there is none."""
        ends = (one for one in self.findings if one.criterion in (LANE, DRIVER))
        return next(ends, self.findings[0] if self.findings else None)

    @property
    def departure(self) -> Finding | None:
        """The place where the car left its lane by more than the tolerance; None if it did not."""
        return next((one for one in self.findings if one.criterion == LANE), None)

    def as_json(self) -> dict[str, Any]:
        """Its fields, for JSON."""
        findings = [asdict(one) | {"time": simulated_time(one.time)} for one in self.findings]
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
    """Assessment of record ``i``: (end, s, d, road heading, oob share).

    Args:
        table, ds: the road, see `frenetic.road.geometry`.
        lane_width: m.
        rules: `rules_array`.
        car: (3,) length, width, centre_ahead in m.
        times, xs, ys: columns of the trajectory, filled up to ``i``.
        heading: rad, the car's at record ``i``.
        s_before: m, distance along the road at record ``i - 1``; not used for record 0.
        least: an oob share that is surely less may be told as 0; at most the tolerance.
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
    else:
        # The latest record at least stuck_time ago, where records come at a steady rate; guessed,
        # then made sure.
        passed = times[i] - times[i - 1] if i > 0 else 0.0
        j = max(0, i - int(stuck_time / passed)) if passed > 0.0 else i
        while j < i and times[i] - times[j + 1] >= stuck_time - 1e-9:
            j += 1
        while j > 0 and times[i] - times[j] < stuck_time - 1e-9:
            j -= 1
        if (
            times[i] - times[j] >= stuck_time - 1e-9
            and math.hypot(x - xs[j], y - ys[j]) < stuck_distance
        ):
            end = STUCK
        elif times[i] > timeout:
            end = TIMED_OUT
    return end, s, d, road_heading, share


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
    """The rules for `assess_record`: tolerance, goal, stuck distance, stuck time, timeout."""
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
    """A trajectory seen from its road, record by record, up to the record that ended the drive."""

    end: int
    """RUNNING, REACHED, LEFT_LANE, STUCK or TIMED_OUT."""
    distance: FloatArray
    """Distance along the road, (n,) in m."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""
    oob_distance: FloatArray
    """Oob distance, (n,) in m, see `Result.moobd`."""
    oob_share: FloatArray
    """(n,) 0..1."""


def assess(road: Road, drive: Drive, *, has_shares: bool = True) -> Assessment:
    """The drive record by record: place, lateral offset, oob distance and oob share.

    Args:
        road: that was driven.
        drive: along it.
        has_shares: whether oob shares are needed; those below the tolerance may be 0 otherwise.
    """
    t = drive.trajectory
    end, rows = _assess(
        road.table,
        road.sub_step,
        road.lane_width,
        rules_array(drive.rules, road.length),
        drive.car.to_array(),
        # Copies, as kernels are compiled for each kind of array: the rollout's can be written.
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
    """A share in percent, never rounded below its value."""
    return f"{math.ceil(share * 1000.0 - 1e-9) / 10.0:g}%"


def judge(road: Road, drive: Drive) -> Result:
    """The verdict on one drive of a road.

    Records count until a rule ends the drive. A drive that a fault of its driver ended is a FAIL.
    One that stops before any rule ends it, or that carries other trouble, is an ERROR.
    """
    path = drive.trajectory
    records = len(path)
    trouble = drive.trouble
    if records == 0 or (trouble is not None and not is_drivers(trouble.fault)):
        duration = float(path.time[-1]) if records else 0.0
        return broken(trouble or Trouble("The simulator recorded nothing"), duration)
    if not all(np.isfinite(column).all() for column in (path.time, path.x, path.y, path.heading)):
        return broken(trouble or Trouble("The simulator recorded places that are no numbers"))
    seen = assess(road, drive)
    i = len(seen.distance) - 1
    duration = float(path.time[i])
    least = int(np.argmin(seen.oob_distance))
    outcome = Outcome.FAIL
    findings: tuple[Finding, ...] = ()
    fault: Fault | None = None
    rules = drive.rules
    place = duration, float(seen.distance[i]), float(path.x[i]), float(path.y[i])
    if seen.end == REACHED:
        outcome, reason = Outcome.PASS, "Car reached the end of the road"
    elif seen.end == LEFT_LANE:
        side: Side = "left" if seen.lateral_offset[i] > 0.0 else "right"
        share = float(seen.oob_share[i])
        findings = (Finding(LANE, share, rules.oob_tolerance, side, *place),)
        reason = (
            f"Car drove out of the lane to the {side} after {seen.distance[i]:.0f} m:"
            f" {_rounded_up(float(seen.oob_share[i]))} of it outside,"
            f" {rules.oob_tolerance * 100:g}% tolerated"
        )
    elif seen.end == STUCK:
        reason = (
            f"Car moved less than {rules.stuck_distance:g} m in {rules.stuck_time:g} s"
            f" at {seen.distance[i]:.0f} m"
        )
    elif seen.end == TIMED_OUT:
        reason = (
            f"Car took longer than {rules.timeout(road.length):.0f} s"
            f" and was at {seen.distance[i]:.0f} m of {road.length:.0f} m"
        )
    elif trouble is not None:
        reason, fault = trouble.reason, trouble.fault
        findings = (Finding(DRIVER, 1.0, 0.0, None, *place),)
    else:
        reason = f"The simulator stopped after {duration:.1f} s, before the drive had ended"
        return Result(Outcome.ERROR, reason, duration=duration)
    if rules.criteria:
        try:
            breaches = _breaches(road, drive, seen)
        except FreneticError as error:
            return broken(Trouble(str(error)), duration)
        findings = tuple(sorted((*breaches, *findings), key=lambda one: one.time))
        if breaches and outcome is Outcome.PASS:
            outcome, reason = Outcome.FAIL, breach_in_words(breaches, rules.criteria)
    return Result(
        outcome,
        reason,
        float(seen.oob_distance[least]),
        float(seen.distance[least]),
        float(seen.oob_share.max()),
        duration,
        findings,
        fault,
    )


def seen_by_criteria(road: Road, drive: Drive, assessment: Assessment | None = None) -> Seen:
    """A drive as its criteria see it."""
    seen = assess(road, drive) if assessment is None else assessment
    return Seen.of(road, drive, seen.distance, seen.lateral_offset)


def measured(road: Road, drive: Drive, criteria: Iterable[Criterion]) -> list[Measured]:
    """The worst values in a drive; a criterion whose window is longer than the drive has none.

    Raises:
        FreneticError: a quantity cannot be measured.
    """
    seen = seen_by_criteria(road, drive)
    return [found for one in criteria if (found := measure(one, seen)) is not None]


def measures_json(road: Road, drive: Drive) -> list[dict[str, Any]]:
    """The worst value of every quantity in a drive, for JSON, with the limits that it was given.

    Raises:
        FreneticError: a quantity cannot be measured.
    """
    seen = seen_by_criteria(road, drive)
    limits = {one.quantity: one for one in drive.rules.criteria.criteria}
    rows = []
    for name in {**QUANTITIES, **limits}:
        found, limit, what = worst(name, seen), limits.get(name), quantity(name)
        if found is None:
            continue
        rows.append(
            {
                "quantity": name,
                "unit": what.unit,
                "value": found.value,
                "side": found.side,
                "time": simulated_time(float(seen.path.time[found.record])),
                "distance": found.distance,
                "window": found.criterion.window,
                "limit": None if limit is None else limit.limit,
                "clause": "" if limit is None else limit.clause,
                "kept": None if limit is None else found.margin >= 0.0,
            }
        )
    return rows


def _breaches(road: Road, drive: Drive, assessment: Assessment) -> list[Finding]:
    """Findings of the criteria beside the lane, each where its value is worst.

    Raises:
        FreneticError: a quantity cannot be measured.
    """
    seen = seen_by_criteria(road, drive, assessment)
    if not np.isfinite(seen.path.to_rows()).all():
        raise FreneticError(
            "The simulator recorded values that are no numbers: they cannot be judged"
        )
    findings = []
    for criterion in drive.rules.criteria.criteria:
        found = measure(criterion, seen)
        if found is not None and found.margin < 0.0:
            i, path = found.record, seen.path
            time, x, y = (float(column[i]) for column in (path.time, path.x, path.y))
            name, limit, place = criterion.quantity, criterion.limit, found.distance
            findings.append(Finding(name, found.value, limit, found.side, time, place, x, y))
    return findings


def breach_in_words(findings: Sequence[Finding], criteria: Profile) -> str:
    """The breaches of criteria beside the lane, in a sentence; empty without any."""
    limits = {one.quantity: one for one in criteria.criteria}
    texts = []
    for one in findings:
        if one.criterion in limits:
            what = quantity(one.criterion)
            side = f" {'to' if what.has_sides else 'on'} the {one.side}" if one.side else ""
            text = f"{what.words} {what.told(one.value)}{side} at {one.distance:.0f} m"
            texts.append(f"{text} ({limits[one.criterion].told()})")
    text = "; ".join(texts)
    return text[:1].upper() + text[1:]


def is_drivers(fault: Fault | None) -> bool:
    """Whether a fault is the driver's."""
    return fault is not None and fault.part == "driver"


def broken(trouble: Trouble, duration: float | None = None) -> Result:
    """The verdict on a drive without a usable record: a FAIL if the fault is the driver's."""
    outcome = Outcome.FAIL if is_drivers(trouble.fault) else Outcome.ERROR
    return Result(outcome, trouble.reason, duration=duration, fault=trouble.fault)
