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
    from frenetic.oracle.drive import Trajectory
    from frenetic.oracle.verdict import Finding
    from frenetic.road import Pose, Road
    from frenetic.road.classes import RoadClass


_PROFILES = ("superelevation", "grade", "widening", "speed_limits")
"""Names of the profiles of a candidate, as `frenetic.road.profile.NAMES`."""


@dataclass(frozen=True)
class Origin:
    """How a candidate was made."""

    operator: str
    """Name of the operator that made the road, such as ``random`` or ``P1``; the built-in names are
    in `frenetic.search.operator_names`."""
    parents: tuple[int, ...] = ()
    """Ids of the candidates from which it was made; empty for a random road."""
    generation: int = 0
    """Generation: 0 for a road without parents, otherwise 1 plus the largest of the parents'."""


@dataclass(frozen=True)
class SourceTest:
    """Test of another campaign whose road is driven again."""

    campaign: str
    """Folder of the campaign."""
    test: int
    """Id of the test."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A road that a strategy wants judged.

    Superelevation, grade, widening and speed limits are profiles: arrays whose rows hold a distance
    along the road in m and the value there, see `frenetic.road.Road`.
    """

    id: int
    """Number in the order of asking, from 1."""
    curvatures: FloatArray
    """Curvature samples, (N,) in 1/m, read-only."""
    step: float
    """Distance between two curvature samples, in m."""
    origin: Origin
    """How the road was made."""
    points: FloatArray | None = None
    """Points of the road on the map, (N, 2) in m, read-only; None if it was proposed as curvatures.

    Points are judged and driven where they lie, and the curvatures follow from them. The curvatures
    are empty if no road passes through the points.
    """
    conditions: Mapping[str, int | float] = field(default_factory=dict)
    """Name of a condition -> amount, if it differs from the campaign's. An amount that is a seed is
    a whole number."""
    repeat: int = 0
    """Number from 0 of this drive among the drives of one road in the same conditions."""
    source: SourceTest | None = None
    """Test that the road comes from; None if the strategy made the road."""
    notes: Mapping[str, Any] = field(default_factory=dict)
    """Notes of the strategy, as JSON: they are stored, and only the strategy reads them."""
    superelevation: FloatArray | None = None
    """Superelevation, (k, 2) in m and as a slope; None: from the campaign's road class; level if
    there is none."""
    grade: FloatArray | None = None
    """Grade, (k, 2) in m and as a slope; None for a road that neither rises nor falls."""
    widening: FloatArray | None = None
    """Widening of each lane, (k, 2) in m and m; None: from the campaign's road class; 0 if there is
    none."""
    speed_limits: FloatArray | None = None
    """Speed limits, (k, 2) in m and km/h, each from its distance on; None for a road without
    limits."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvatures", _read_only(self.curvatures))
        for name in ("points", *_PROFILES):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, _read_only(values))

    @property
    def length(self) -> float:
        """Length of the road, in m; 0 without curvatures."""
        return max(len(self.curvatures) - 1, 0) * self.step

    @property
    def has_profiles(self) -> bool:
        """Whether the candidate has a profile, such as a grade."""
        return any(getattr(self, name) is not None for name in _PROFILES)

    def road(
        self,
        lane_width: float,
        pose: Pose | None = None,
        road_class: RoadClass | None = None,
    ) -> Road:
        """Return the road of the curvatures and profiles.

        Args:
            lane_width: Width of each lane, in m.
            pose: Pose of the road's start; by default `frenetic.road.road.START`.
            road_class: Class whose superelevation and widening replace those that are None.

        Raises:
            RoadError: Curvatures or profiles make no road.
        """
        # Imported late: these modules load numba, which records without roads do not need.
        from frenetic.road import profile  # loads numba
        from frenetic.road.road import Road  # loads numba
        from frenetic.road.road_values import START  # loads numba

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
        # A copied array is writable: the constructor makes it read-only again.
        return Candidate, tuple(getattr(self, item.name) for item in fields(Candidate))


def _read_only(values: FloatArray) -> FloatArray:
    """Return a read-only copy."""
    copied = np.array(values, dtype=np.float64)
    copied.setflags(write=False)
    return copied


@dataclass(frozen=True, eq=False)
class Trace:
    """A drive relative to its road, record by record, up to the record that ended the drive."""

    distance: FloatArray
    """Distance along the road, (n,) in m, n >= 1."""
    lateral_offset: FloatArray
    """Distance left of the ego lane's centre line, (n,) in m."""
    speed: FloatArray
    """Speed, (n,) in m/s."""
    trajectory: Trajectory | None = None
    """Trajectory on the map, of n records or more; None if it is not known."""

    @classmethod
    def along(
        cls, road: Road, path: FloatArray, speed: FloatArray, trajectory: Trajectory | None = None
    ) -> Trace:
        """Return the trace of a path, (n, 2) in m on the map, with its speeds, (n,) in m/s."""
        track = road.track(path)
        # The ego lane's centre lies half a lane to the right of the road's centre line.
        return cls(track[:, 0], track[:, 1] + 0.5 * road.lane_width, speed, trajectory)


def _no_trace() -> Trace | None:
    """Return None; unlike a lambda, this default of `Evaluation.read_trace` can be pickled."""
    return None


@dataclass(frozen=True)
class Evaluation:
    """Result of a candidate, as a strategy is told it.

    Raises:
        ValueError: No outcome has this name.
    """

    candidate: Candidate
    """The candidate that was judged."""
    outcome: Outcome
    """Outcome; the constructor takes its name, too."""
    moobd: float | None
    """Minimum out-of-bounds distance (MOOBD) of the drive, in m: how far the car's centre stayed
    inside its lane, negative outside. None if nothing was driven (neither PASS nor FAIL) or nothing
    measured."""
    budget_spent: float
    """Share of the campaign's budget that was spent when the result was told, 0..1; 1 also if the
    budget was exceeded."""
    finding: Finding | None = None
    """Gravest breach of a criterion, see `frenetic.oracle.Result`; None for a PASS, and for a FAIL
    without a breach: the car stood still or was too slow."""
    worst_place: float | None = None
    """Distance along the road, in m, to where the drive was worst by the campaign's objective. By
    the MOOBD, the car was furthest from its lane's centre there."""
    duration: float | None = None
    """Simulated time, in s."""
    fault: Fault | None = None
    """Fault of the driver that ended the drive."""
    objective: float | None = None
    """Value to be minimised if the campaign has another objective than the MOOBD: the objective's
    value, negated where a higher value is worse for the driver. None if the objective is the
    MOOBD, or nothing was driven."""
    read_trace: Callable[[], Trace | None] = field(default=_no_trace, compare=False, repr=False)
    """Function that reads `trace`; it is called at most once."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "outcome", Outcome(self.outcome))

    @property
    def place(self) -> float | None:
        """Distance along the road to the finding, or else to the worst place, in m."""
        return self.worst_place if self.finding is None else self.finding.distance

    @property
    def fitness(self) -> float | None:
        """Value that the search minimises: `objective`, or the MOOBD where that is None.

        A lower value is a worse drive. None if nothing was driven or nothing measured.
        """
        return self.moobd if self.objective is None else self.objective

    @cached_property
    def trace(self) -> Trace | None:
        """Offsets and speeds along the road, read on first use; None if nothing was driven."""
        return self.read_trace()
