"""Records of a candidate's test: the `Attempt` that a worker answers, and the stored `Test`.

`frenetic.campaign.columns` declares how the database stores a test.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from frenetic._support.bounds import Count, Finite, Index, NotNegative, Share
from frenetic._support.notebook import NotebookRepr
from frenetic.campaign.trajectory_codec import decode, encode_and_round, rounded
from frenetic.errors import IS_KILLED, CampaignError, Trouble
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result, unusable_result
from frenetic.road import Pose, Road
from frenetic.search.records import Candidate
from frenetic.segments.segment import Segment, segment_of
from frenetic.segments.values import SegmentValues
from frenetic.spec.terms import DriveSetting


@dataclass(frozen=True)
class Attempt:
    """An attempt to test a candidate, as a worker answers it, small enough to cross processes."""

    candidate_id: Count
    result: Result
    """Verdict; for a road that nobody drove only outcome and reason."""
    pose: Pose | None = None
    """Start of the road on the map; None if the road fits nowhere."""
    trajectory: Trajectory | None = None
    """Exact trajectory; None if nothing was driven, or if only `packed` is kept."""
    packed: bytes | None = None
    """Trajectory as the database stores it, see `frenetic.campaign.trajectory_codec`; None before
    `pack`, or if nothing was driven."""
    records: Index | None = None
    """Number of the trajectory's records; None before `pack`, or if nothing was driven."""
    simulator_broke: bool = False
    """Whether the simulator broke, so that another attempt may succeed."""
    worker_lost: bool = False
    """Whether the worker was lost during the attempt; the result's reason says how."""
    worker: str | None = None
    """Name of the worker."""
    seconds: NotNegative = 0.0
    """Wall time of the attempt, in s."""
    driver_seconds: float = field(default=0.0, compare=False)
    """Part of `seconds` in the driver's code, in s."""
    trouble: Trouble | None = None
    """Error of the driver, the simulator or the worker; None without an error."""
    reported_share: Share | None = None
    """Spent share of the budget that a client reports; None if the campaign counts."""
    rounded_trajectory: Trajectory | None = field(default=None, compare=False)
    """`stored_trajectory`, if it is known already."""
    road: Road | None = field(default=None, compare=False)
    """Road that was driven; None if nothing was driven, or if another process drove."""

    @classmethod
    def undriven(
        cls, candidate_id: int, outcome: Outcome, reason: str, pose: Pose | None = None
    ) -> Self:
        """Return the attempt at a road that nobody drives, since it was refused or dropped."""
        return cls(candidate_id, Result(outcome, reason), pose)

    @classmethod
    def lost(cls, candidate_id: int, worker: str, seconds: float, trouble: Trouble) -> Self:
        """Return the attempt of a worker that was lost after `seconds` s."""
        return cls(
            candidate_id,
            unusable_result(trouble),
            worker_lost=True,
            worker=worker,
            seconds=seconds,
            trouble=trouble,
        )

    @property
    def failure(self) -> str | None:
        """Reason for another attempt; None if this attempt's result counts.

        A driver that breaks is a result. A driver whose process was killed gets another attempt:
        the system may have killed the process.
        """
        fault = self.result.fault
        is_error = self.result.outcome is Outcome.ERROR
        is_doubtful = is_error or (fault is not None and fault.kind == IS_KILLED)
        broke = self.simulator_broke or self.worker_lost
        return self.result.reason if broke and is_doubtful else None

    def pack(self, *, keep_exact: bool = False) -> Self:
        """Return the attempt with a packed trajectory.

        Args:
            keep_exact: whether it has the exact trajectory, too.
        """
        if self.trajectory is None or (keep_exact and self.packed is not None):
            return self
        packed, stored = self.packed, None
        if packed is None:
            packed, stored = encode_and_round(self.trajectory)
        return replace(
            self,
            trajectory=self.trajectory if keep_exact else None,
            packed=packed,
            records=len(self.trajectory),
            rounded_trajectory=stored if keep_exact else None,
        )

    def stored_trajectory(self) -> Trajectory | None:
        """Return the trajectory as it will be read from the database, rounded; None if unpacked."""
        if self.packed is None or self.rounded_trajectory is not None:
            return self.rounded_trajectory
        return decode(self.packed) if self.trajectory is None else rounded(self.trajectory)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Test(NotebookRepr):
    """One road test: a candidate with its result."""

    __test__: ClassVar[bool] = False  # pytest collects no class with this attribute

    candidate: Candidate
    result: Result
    """Verdict; for a road that nobody drove only outcome and reason."""
    result_number: Count
    """Number from 1 in the order of results."""
    budget_spent: Share
    """Spent share of the campaign's budget after this test, from 0 to 1."""
    reported_share: Share | None = None
    """Spent share of the budget that a client reported; None if the campaign counts."""
    pose: Pose | None = None
    """Start of the road on the map; None if the road fits nowhere."""
    trajectory: Trajectory | None = None
    """Trajectory; None if nothing was driven, or if the test was read without its trajectory."""
    records: Index | None = None
    """Number of the trajectory's records, even if it was not read; None if nothing was driven."""
    worker: str | None = None
    """Name of the worker; None if nobody drove."""
    seconds: NotNegative = 0.0
    """Wall time of the attempt that counts, in s."""
    attempts: Index = 1
    """Number of attempts; 0 if the candidate was dropped before the first."""
    elapsed: NotNegative = 0.0
    """Time of the campaign at this result, in s."""
    finished_at: str = ""
    """Date and time of the result, UTC, ISO 8601."""
    objective: Finite | None = None
    """Value that the campaign minimises or maximises; None for the MOOBD, or without a drive."""
    setting: DriveSetting | None = None
    """Setting of the drive; None if the campaign does not record it."""
    stored_values: SegmentValues | None = None
    """Values of the drive's segment as the database holds them; None if they were not read."""

    @classmethod
    def of(
        cls,
        candidate: Candidate,
        attempt: Attempt,
        *,
        result_number: int,
        budget_spent: float,
        attempts: int = 1,
        elapsed: float = 0.0,
        finished_at: str = "",
        setting: DriveSetting | None = None,
    ) -> Self:
        """Return the test of a candidate whose attempt counts, as it will be stored."""
        test = cls(
            candidate=candidate,
            result=attempt.result,
            result_number=result_number,
            budget_spent=budget_spent,
            reported_share=attempt.reported_share,
            pose=attempt.pose,
            trajectory=attempt.stored_trajectory(),
            records=attempt.records,
            worker=attempt.worker,
            seconds=attempt.seconds,
            attempts=attempts,
            elapsed=elapsed,
            finished_at=finished_at,
            setting=setting,
        )
        if attempt.road is not None and candidate.points is None:
            vars(test)["road"] = attempt.road  # the road of the same values
        return test

    @property
    def id(self) -> int:
        """The candidate's id."""
        return self.candidate.id

    @property
    def outcome(self) -> Outcome:
        """The verdict's outcome."""
        return self.result.outcome

    @property
    def reason(self) -> str:
        """The verdict's reason, for people."""
        return self.result.reason

    @property
    def moobd(self) -> float | None:
        """Minimum oob distance in m; None if nothing was driven or measured."""
        return self.result.moobd

    @property
    def departure(self) -> Finding | None:
        """Where and when the car left its lane; None if it did not."""
        return self.result.departure

    @property
    def lane_width(self) -> float:
        """Width of each lane, in m.

        Raises:
            CampaignError: the campaign does not record it.
        """
        return self._setting.lane_width

    @cached_property
    def road(self) -> Road:
        """Road in its place on the map, or in its default place if it fits nowhere.

        Raises:
            CampaignError: the campaign does not record the width of its lanes.
        """
        setting = self._setting
        return self.candidate.road(setting.lane_width, self.pose, setting.road_class)

    @cached_property
    def drive(self) -> Drive | None:
        """Drive; None if nothing was driven, or if the test was read without its trajectory.

        Raises:
            CampaignError: the campaign does not record the car.
        """
        if self.trajectory is None:
            return None
        fault = self.result.fault
        broke = self.outcome is Outcome.ERROR or fault is not None
        setting = self._setting
        return Drive(
            self.trajectory,
            setting.car,
            setting.rules_in(self.candidate.conditions),
            self.road,
            Trouble(self.reason, fault=fault) if broke else None,
        )

    @cached_property
    def segment(self) -> Segment | None:
        """Segment of the drive; None if the drive has no records, or they were not read.

        Raises:
            CampaignError: the campaign does not record the car.
        """
        if self.drive is None or not len(self.drive.trajectory):
            return None
        return segment_of(self.road, self.drive, self.result.finding)

    @cached_property
    def segment_values(self) -> SegmentValues | None:
        """Values of the drive's segment: stored values, or measured on the trajectory.

        None if the drive was not judged or has no records, or neither was read.

        Raises:
            CampaignError: the campaign does not record the car.
        """
        if self.stored_values is not None or not self.outcome.is_driven or self.segment is None:
            return self.stored_values
        return SegmentValues.of(self.segment, self.result)

    def measure(self) -> SegmentValues | None:
        """Return the values of the drive's segment, measured on the test's trajectory.

        None if the drive was not judged, has no records, or is so odd that a value is no number:
        time may stand still in a drive that a client of `frenetic ask-tell` reports.
        """
        test = self if self.stored_values is None else replace(self, stored_values=None)
        try:
            with np.errstate(all="ignore"):
                values = test.segment_values
        except (ArithmeticError, ValueError, CampaignError):
            return None
        return values if values is not None and values.are_finite else None

    def __repr__(self) -> str:
        """The test at a glance."""
        moobd = "" if self.moobd is None else f", MOOBD {self.moobd:.2f} m"
        return f"<Test {self.id}: {self.outcome}{moobd}>"

    @property
    def _setting(self) -> DriveSetting:
        if self.setting is None:
            raise CampaignError(
                f"the campaign does not say with what test {self.id} was driven: 'frenetic check'"
                " says what is wrong with its configuration"
            )
        return self.setting


def file_stem(candidate_id: int) -> str:
    """Return the name of a test's files, without suffix, such as ``test-00007``."""
    return f"test-{candidate_id:05d}"
