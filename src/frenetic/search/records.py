"""Records that a campaign and a search strategy exchange."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.oracle.outcome import Outcome

if TYPE_CHECKING:
    from frenetic.errors import Fault
    from frenetic.oracle.verdict import Finding
    from frenetic.road import Pose, Road
    from frenetic.road.classes import RoadClass


@dataclass(frozen=True)
class Origin:
    """Origin of a candidate."""

    operator: str
    """Name of the operator that made the road, as in Listing 1: ``random``, ``P1`` .. ``C2``."""
    parents: tuple[int, ...] = ()
    """Ids of the candidate's parents."""
    generation: int = 0
    """Generation: 0 for a random road, otherwise one more than its youngest parent's."""


@dataclass(frozen=True)
class SourceTest:
    """Test of another campaign whose road is driven again."""

    campaign: str
    """Folder of the campaign."""
    test: int
    """Number of the test."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A road that a strategy wants judged."""

    id: int
    """Number from 1 in the order of asking."""
    curvatures: FloatArray
    """Curvature samples, (N,) in 1/m, read-only."""
    step: float
    """Distance between two curvature samples, in m."""
    origin: Origin
    points: FloatArray | None = None
    """Points of the road on the map, (N, 2) in m, read-only, if it was proposed as points.

    Then the points are judged and driven where they lie, and the curvatures follow from them;
    curvatures are empty if no road passes through the points.
    """
    conditions: Mapping[str, int | float] = field(default_factory=dict)
    """Name of a condition -> its amount, where it differs from the campaign's; seeds are whole
    numbers."""
    repeat: int = 0
    """Number from 0 of this drive among the drives of one road in the same conditions."""
    source: SourceTest | None = None
    """Test that the road comes from; None if the strategy made the road."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Notes of the strategy, as JSON; stored, and read by nobody else."""
    superelevation: FloatArray | None = None
    """Superelevation, (k, 2), see `frenetic.road.Road`; None for a level road, or for the profile
    of the campaign's road class."""
    grade: FloatArray | None = None
    """Grade, (k, 2); None for a road that neither rises nor falls."""
    widening: FloatArray | None = None
    """Widening of the lanes, (k, 2); None for lanes of one width, or as the campaign's road class
    widens them."""
    speed_limits: FloatArray | None = None
    """Speed limits of the road, (k, 2) in m and km/h, each from its station on; None for a road
    without a limit of its own."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvatures", _read_only(self.curvatures))
        for name in ("points", "superelevation", "grade", "widening", "speed_limits"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, _read_only(values))

    @property
    def length(self) -> float:
        """Length of the road, in m."""
        return (len(self.curvatures) - 1) * self.step

    def road(
        self,
        lane_width: float,
        pose: Pose | None = None,
        road_class: RoadClass | None = None,
    ) -> Road:
        """Return the road of the curvatures and profiles, at a pose or at the usual place.

        Args:
            lane_width: m.
            pose: Pose of the road's start.
            road_class: Class by which the road leans and widens where the candidate does not say.

        Raises:
            RoadError: Curvatures or profiles make no road.
        """
        from frenetic.road import profile  # a strategy's records need no compiled code
        from frenetic.road.road import START, Road

        profiles: dict[str, FloatArray] = {}
        if road_class is not None:
            profiles = road_class.profiles(self.curvatures, self.step)
        for name in profile.NAMES:
            if (values := getattr(self, name)) is not None:
                profiles[name] = values
        return Road(
            self.curvatures,
            self.step,
            START if pose is None else pose,
            lane_width=lane_width,
            **profiles,
        )

    def __reduce__(self) -> tuple[Any, ...]:
        # Made anew, so that the values are read-only again.
        return Candidate, tuple(getattr(self, item.name) for item in fields(Candidate))


def _read_only(values: FloatArray) -> FloatArray:
    copied = np.array(values, dtype=np.float64)
    copied.setflags(write=False)
    return copied


@dataclass(frozen=True, eq=False)
class Trace:
    """A drive relative to its road, record by record, up to the record that ended it."""

    distance: FloatArray
    """Distance along the road, (n,) in m, n >= 1."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""
    speed: FloatArray
    """Speed, (n,) in m/s."""

    @classmethod
    def along(cls, road: Road, path: FloatArray, speed: FloatArray) -> Trace:
        """Return the trace of a path, (n, 2) in m on the map, with its speeds, (n,) in m/s."""
        track = road.track(path)
        return cls(track[:, 0], track[:, 1] + 0.5 * road.lane_width, speed)


def _no_trace() -> Trace | None:
    return None


@dataclass(frozen=True)
class Evaluation:
    """Result of a candidate, as a strategy is told it.

    Fields with a default may be left out. A resumed campaign tells the same results, bit for bit.

    Raises:
        ValueError: There is no such outcome.
    """

    candidate: Candidate
    outcome: Outcome
    """An outcome, or its name."""
    moobd: float | None
    """Minimum oob distance in m, smaller is worse for the driver; None unless PASS or FAIL, or if
    nobody measured it."""
    budget_spent: float
    """Share of the campaign's budget spent when this was told, 0..1."""
    finding: Finding | None = None
    """Gravest breach of a criterion, see `frenetic.oracle.Result`; None if there is none, as for a
    car that stood still."""
    worst_place: float | None = None
    """Distance along the road to where the drive was worst by the objective, for the MOOBD to where
    the car was furthest off its lane's centre, in m."""
    duration: float | None = None
    """Simulated time, in s."""
    fault: Fault | None = None
    """Fault of the driver that ended the drive."""
    objective: float | None = None
    """Value to be minimised, if the campaign has another objective than the MOOBD."""
    read_trace: Callable[[], Trace | None] = field(default=_no_trace, compare=False, repr=False)
    """Source of `trace`."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "outcome", Outcome(self.outcome))

    @property
    def place(self) -> float | None:
        """Distance along the road to the finding, or else to the worst place, in m."""
        return self.worst_place if self.finding is None else self.finding.distance

    @property
    def severity(self) -> float | None:
        """Value to be minimised, lower is worse for the driver; None unless PASS or FAIL."""
        return self.moobd if self.objective is None else self.objective

    @cached_property
    def trace(self) -> Trace | None:
        """Offsets and speeds along the road, read on first use; None unless PASS or FAIL."""
        return self.read_trace()
