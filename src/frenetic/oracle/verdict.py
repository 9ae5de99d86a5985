"""The verdict on a drive: outcome, reason, how far the car left its lane, where and on which side.

`judge` combines the assessment of the drive (`frenetic.oracle.assessment`), the criteria beside the
lane (`frenetic.oracle.signals`) and a fault of the driver or the simulator.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np

from frenetic._support.bounds import Finite, NotNegative, Share
from frenetic._support.words import rounded_seconds
from frenetic.criteria.criterion import DRIVER, LANE, CriteriaSet, signal_named
from frenetic.errors import Fault, FreneticError, Trouble
from frenetic.oracle.assessment import (
    LEFT_LANE,
    REACHED,
    RECORD_HEADING,
    STUCK,
    TIMED_OUT,
    assess,
)
from frenetic.oracle.drive_assessment import Assessment
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import LocatedDrive, measure

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive
    from frenetic.road import Road

Side: TypeAlias = Literal["left", "right"]

BEHAVIOUR: Final = 2
"""Version of the rules: increase it when the same drive gets another verdict. Campaigns record it.
"""


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
    """Side on which the car left its lane, or to which the value points; None if the criterion has
    no sides."""
    time: NotNegative
    """Simulated time of the breach, in s."""
    distance: Finite
    """Distance of the breach along the road, in m."""
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
        """Return the finding that a car left its lane, for departures known only in part.

        The limit is unknown, so the oob share stands for it.

        Args:
            side: side of the lane on which the car left it.
            distance: distance along the road, in m.
            oob_share: share of the car's box outside the lane, 0..1.
            time: simulated time, in s.
            x: coordinate of the centre of mass, in m.
            y: coordinate of the centre of mass, in m.
        """
        return cls(LANE, oob_share, oob_share, side, time, distance, x, y)

    def as_json(self) -> dict[str, Any]:
        """Return the fields, for JSON."""
        return asdict(self) | {"time": rounded_seconds(self.time)}


@dataclass(frozen=True)
class Result:
    """The verdict on a `Drive` along its road."""

    outcome: Outcome
    reason: str
    """Reason of the outcome, in one sentence."""
    moobd: Finite | None = None
    """Minimum oob distance (MOOBD), in m; None if it was not measured, as without a drive."""
    moobd_distance: Finite | None = None
    """Distance along the road at which the oob distance was least, in m; None without a MOOBD."""
    max_oob_share: Share | None = None
    """Largest share 0..1 of the car's box outside the ego lane; None without a MOOBD."""
    duration: NotNegative | None = None
    """Simulated time until the drive ended, in s; None if nothing was driven."""
    distance: NotNegative | None = None
    """Length of the road from its start to where the drive ended, in m; None if nothing was driven
    or followed along the road, as when the simulator broke."""
    findings: tuple[Finding, ...] = ()
    """Breaches of the criteria, in the order of time."""
    fault: Fault | None = None
    """Fault that ended the drive: a driver's fault makes it a FAIL, a simulator's an ERROR."""

    @property
    def finding(self) -> Finding | None:
        """Main breach: the breach that ended the drive, else the first; None without a breach."""
        endings = (finding for finding in self.findings if finding.criterion in (LANE, DRIVER))
        return next(endings, self.findings[0] if self.findings else None)

    @property
    def departure(self) -> Finding | None:
        """Finding that the car left its lane by more than the tolerance; None if it did not."""
        return next((finding for finding in self.findings if finding.criterion == LANE), None)

    def as_json(self) -> dict[str, Any]:
        """Return the fields, for JSON."""
        findings = [finding.as_json() for finding in self.findings]
        return asdict(self) | {"duration": rounded_seconds(self.duration), "findings": findings}


def _rounded_up(share: float) -> str:
    """Return a share in percent, rounded up to a tenth, so that it exceeds the tolerance."""
    return f"{math.ceil(share * 1000.0 - 1e-9) / 10.0:g}%"


def judge(road: Road, drive: Drive) -> Result:
    """Return the verdict on one drive of a road.

    Records count until a rule ends the drive. A drive that its driver's fault ended is a FAIL. A
    drive is an ERROR if it stops before any rule ends it, or if the simulator broke.
    """
    if (result := _unusable_record(drive)) is not None:
        return result
    assessment = assess(road, drive, has_all_shares=False)
    duration = float(drive.trajectory.time[len(assessment.distance) - 1])
    distance = min(max(float(assessment.distance[-1]), 0.0), road.length)
    end = _drive_end(road, drive, assessment)
    if end is None:
        reason = f"The simulator stopped after {duration:.1f} s, before the drive had ended"
        return Result(Outcome.ERROR, reason, duration=duration, distance=distance)
    outcome, reason, findings = end.outcome, end.reason, end.findings
    if drive.rules.criteria:
        try:
            breaches = _breaches(road, drive, assessment)
        except FreneticError as error:
            return unusable_result(Trouble(str(error)), duration)
        findings = tuple(sorted((*breaches, *findings), key=lambda finding: finding.time))
        if breaches and outcome is Outcome.PASS:
            outcome, reason = Outcome.FAIL, breach_text(breaches, drive.rules.criteria)
    least = int(assessment.oob_distance.argmin())
    return Result(
        outcome,
        reason,
        moobd=float(assessment.oob_distance[least]),
        moobd_distance=float(assessment.distance[least]),
        max_oob_share=float(assessment.oob_share.max()),
        duration=duration,
        distance=distance,
        findings=findings,
        fault=end.fault,
    )


def _unusable_record(drive: Drive) -> Result | None:
    """Return the verdict on a drive whose trajectory cannot be assessed; None if it can."""
    path, trouble = drive.trajectory, drive.trouble
    if len(path) == 0 or (trouble is not None and not is_drivers(trouble.fault)):
        duration = float(path.time[-1]) if len(path) else 0.0
        return unusable_result(trouble or Trouble("The simulator recorded nothing"), duration)
    if not np.isfinite(path.block[: RECORD_HEADING + 1]).all():
        return unusable_result(
            trouble or Trouble("The simulator recorded places that are no numbers")
        )
    return None


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
    time_and_place = float(path.time[i]), distance, float(path.x[i]), float(path.y[i])
    if assessment.end == REACHED:
        return _DriveEnd(Outcome.PASS, "Car reached the end of the road")
    if assessment.end == LEFT_LANE:
        side: Side = "left" if assessment.lateral_offset[i] > 0.0 else "right"
        share = float(assessment.oob_share[i])
        reason = (
            f"Car drove out of the lane to the {side} after {distance:.0f} m:"
            f" {_rounded_up(share)} of it outside, {rules.oob_tolerance * 100:g}% tolerated"
        )
        departure = Finding(LANE, share, rules.oob_tolerance, side, *time_and_place)
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
        # A driver's fault has no amount: 1 fault, where 0 are allowed.
        finding = Finding(DRIVER, 1.0, 0.0, None, *time_and_place)
        return _DriveEnd(Outcome.FAIL, trouble.reason, (finding,), trouble.fault)
    return None


def locate_drive(road: Road, drive: Drive, assessment: Assessment | None = None) -> LocatedDrive:
    """Return a drive with the position of each record on the road, from which signals follow."""
    if assessment is None:
        assessment = assess(road, drive)
    return LocatedDrive.of(road, drive, assessment.distance, assessment.lateral_offset)


def _breaches(road: Road, drive: Drive, assessment: Assessment) -> list[Finding]:
    """Return a finding for each breached criterion beside the lane, where its value is worst.

    Raises:
        FreneticError: a signal cannot be measured.
    """
    located = locate_drive(road, drive, assessment)
    path = located.path  # without records of the same time, so other indices than the assessment's
    if not np.isfinite(path.block).all():
        raise FreneticError(
            "The simulator recorded values that are no numbers: they cannot be judged"
        )
    findings = []
    for criterion in drive.rules.criteria.criteria:
        measurement = measure(criterion, located)
        if measurement is not None and measurement.margin < 0.0:
            i = measurement.record
            findings.append(
                Finding(
                    criterion.signal,
                    measurement.value,
                    criterion.limit,
                    measurement.side,
                    time=float(path.time[i]),
                    distance=measurement.distance,
                    x=float(path.x[i]),
                    y=float(path.y[i]),
                )
            )
    return findings


def breach_text(findings: Sequence[Finding], criteria: CriteriaSet) -> str:
    """Return the breaches of criteria beside the lane, in a sentence; empty without breaches."""
    by_signal = {criterion.signal: criterion for criterion in criteria.criteria}
    texts = []
    for finding in findings:
        if finding.criterion in by_signal:
            signal = signal_named(finding.criterion)
            side = ""
            if finding.side:
                side = f" {'to' if signal.has_sides else 'on'} the {finding.side}"
            text = f"{signal.words} {signal.text(finding.value)}{side}"
            limit = by_signal[finding.criterion].text()
            texts.append(f"{text} at {finding.distance:.0f} m ({limit})")
    text = "; ".join(texts)
    return text[:1].upper() + text[1:]


def is_drivers(fault: Fault | None) -> bool:
    """Return whether a fault is the driver's."""
    return fault is not None and fault.part == "driver"


def unusable_result(trouble: Trouble, duration: float | None = None) -> Result:
    """Return the verdict on a drive with trouble: FAIL if the driver is at fault, else ERROR."""
    outcome = Outcome.FAIL if is_drivers(trouble.fault) else Outcome.ERROR
    return Result(outcome, trouble.reason, duration=duration, fault=trouble.fault)
