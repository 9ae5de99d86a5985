"""Distinct failures: clusters of failures that are the same problem.

Two failures are laid over each other so that the places and directions of the road where the car
left its lane coincide; `frenetic.search.approach` says how their *difference*, in metres, follows.
The road further than 15 m ahead does not count: the car never got there, and with it the clusters
of a campaign and of its half were less alike.

Average linkage (UPGMA on the square of the difference) clusters the failures of each side of the
lane as long as the root mean square difference within a cluster is at most 2 m, half a lane. Equal
failures count once, so the order of the failures and their repetitions do not matter; the number of
clusters follows from the failures.

Faults of the driver, such as exceptions, are the same problem if the same line raised, whatever the
road. They come first.

Distinct failures share a *cause* if the driver does the same wrong before them, see
`frenetic.analysis.causes`: the one of most of a distinct failure's members.

The nearest misses are the passing tests of lowest MOOBD, told apart in the same way, seen from the
place where the car came nearest to its lane's edge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.words import counted, lane_words
from frenetic.analysis.causes import Cause, Kind, cause_of, in_words
from frenetic.analysis.segments import (
    Segment,
    place_in_words,
    segment_of_test,
    segments_of,
)
from frenetic.campaign.objective import MOOBD, Objective, evaluation_of
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.warm_start import read_earlier
from frenetic.criteria.criterion import EDGE_DISTANCE
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, Side
from frenetic.search.approach import (
    ALIKE,
    ROAD_SIZE,
    SIZE,
    STATES,
    as_vector,
    is_near,
    road_around,
    states_before,
)
from frenetic.search.archive import SIDES, places_of
from frenetic.search.records import Evaluation, Trace

IntArray = npt.NDArray[np.int64]

THRESHOLD: Final = ALIKE
"""Largest root mean square difference within a cluster, in m."""
BATCH: Final = 3000
"""Failures that are linked at a time; memory and time grow with the square."""
COMPARED: Final = 10_000
"""Most failures of a campaign that are compared with each other, the most severe first."""
LISTED: Final = 10
"""Default number of representative failures that are listed and drawn."""
NEAR_MISSES: Final = 5
"""Default number of distinct near misses that are listed and drawn."""

_FEWEST: Final = 10  # random roads from which something is said of all
_DOUBTFUL: Final = 0.95  # failing share of them
_UNSURE: Final = 0.05
_MOSTLY: Final = 0.75  # share of the failures of a cause in bends to the same side
_NEARLY_ALL: Final = 0.95
_PASSES_COMPARED: Final = 500, COMPARED  # as many as needed for the wanted near misses


@dataclass(frozen=True, eq=False)
class Failure:
    """The compared part of a failure: road and drive, seen from the place of departure."""

    id: int
    """Id of the test."""
    moobd: float
    """Minimum oob distance, in m."""
    side: Side | None
    """The side of the lane on which the car left, None if it failed without leaving."""
    curvatures: FloatArray
    """Curvatures of the whole road, (n,) in 1/m."""
    step: float
    """Distance between two curvatures, in m."""
    place: float
    """Place of the departure, in m along the road."""
    road: FloatArray
    """Centre line, (19, 2) in m, every 2.5 m from 30 m before the place to 15 m after it: x ahead,
    y to the left of the road at the place."""
    offsets: FloatArray
    """Lateral offset to the left, (13,) in m, every 2.5 m over the 30 m before the place."""
    speeds: FloatArray
    """Speeds, (13,) in m/s, likewise."""
    is_near_miss: bool = False
    """Whether the test passed; the place is then that of its MOOBD, the side that of the edge."""
    lane_width: float = 4.0
    """m."""
    fault: Fault | None = None
    """Fault of the driver that ended the drive. Without a record of it, all arrays hold zeros."""
    cause: Cause | None = None
    """What the driver did wrong; None for a fault or a near miss."""
    criterion: str | None = None
    """Criterion that the drive exceeded, see `frenetic.oracle.Finding`; None if it stood still."""

    @classmethod
    def of(
        cls,
        segment: Segment,
        *,
        id: int,  # noqa: A002
        moobd: float,
        is_near_miss: bool = False,
        fault: Fault | None = None,
    ) -> Failure:
        """The failure of a test, or the near miss of a passing one, from its segment."""
        road, place, seen = segment.road, segment.place, segment.assessment
        speed = segment.drive.trajectory.speed[: len(seen.distance)]
        side = segment.side
        if is_near_miss:
            side = (
                "left" if seen.lateral_offset[int(np.argmin(seen.oob_distance))] > 0.0 else "right"
            )
        return cls(
            id,
            moobd,
            side,
            road.curvatures,
            road.step,
            place,
            road_around(road.table, road.sub_step, place),
            *states_before(Trace(seen.distance, seen.lateral_offset, speed), place),
            is_near_miss,
            road.lane_width,
            fault,
            None if is_near_miss or fault is not None else cause_of(segment),
            segment.criterion,
        )

    @classmethod
    def of_segment(
        cls,
        segment: Segment | None,
        result: Result,
        id: int = 0,  # noqa: A002
    ) -> Failure | None:
        """The failure of a drive that was judged FAIL, from its segment.

        None without records, unless by a fault.
        """
        fault = result.fault
        if segment is not None:
            return cls.of(segment, id=id, moobd=result.moobd or 0.0, fault=fault)
        if fault is None:
            return None
        line, states = np.zeros((ROAD_SIZE // 2, 2)), np.zeros(STATES)
        return cls(id, 0.0, None, np.zeros(2), 1.0, 0.0, line, states, states, fault=fault)

    @classmethod
    def of_test(cls, record: Test) -> Failure | None:
        """The failure of a stored test; None unless it failed and was read with its trajectory."""
        if record.outcome is not Outcome.FAIL:
            return None
        return cls.of_segment(segment_of_test(record), record.result, record.id)

    def difference(self, other: Failure) -> float:
        """Difference of two failures in m, whatever their sides; see this module's text."""
        return float(np.linalg.norm(self.vector() - other.vector()))

    def vector(self) -> FloatArray:
        """Vector of a failure, (64,) in m; the distance of two is the failures' difference."""
        return as_vector(self.road, self.offsets, self.speeds)


@dataclass(frozen=True)
class Cluster:
    """A cluster of failures that are the same problem."""

    ids: tuple[int, ...]
    """Ids of the tests, ascending."""
    most_severe: int
    """Id of the failure with the lowest MOOBD."""
    typical: int
    """Id of the failure with the cause of most that differs least from all: the medoid."""
    moobd: float
    """Lowest MOOBD, in m."""
    side: Side | None
    """The side of the lane on which the car left; None if it failed without leaving."""
    spread: float
    """Root mean square difference of the failures from their mean, in m."""
    description: str
    """Description of the most severe failure, in one phrase."""
    was_known: bool | None = None
    """Whether an earlier campaign, from which this one started, holds a failure like one of these;
    None if it started afresh."""
    failure: Failure | None = field(default=None, repr=False, compare=False)
    """The most severe failure, for its picture."""

    cause: Cause | None = None
    """What the driver does wrong in most of them; None for a fault or a near miss."""

    @property
    def fault(self) -> Fault | None:
        """Fault of the driver that they have in common, at one line of its code."""
        return None if self.failure is None else self.failure.fault

    def __len__(self) -> int:
        return len(self.ids)

    def __str__(self) -> str:
        text = f"{self.description}: {counted(len(self), 'failure')}"
        if self.failure is None or self.fault is not None:
            return text
        return f"{text}, at worst {lane_words(self.moobd, self.failure.lane_width)}"


@dataclass(frozen=True)
class CauseGroup:
    """The distinct failures in which the driver does the same wrong."""

    words: str
    """What it does, without a subject: ``brakes too late into right-hand bends``."""
    clusters: tuple[Cluster, ...]
    """The most severe first."""

    @property
    def fault(self) -> Fault | None:
        """Fault of the driver, if it is the cause."""
        return self.clusters[0].fault

    @property
    def failures(self) -> int:
        """Number of failures."""
        return sum(map(len, self.clusters))

    @property
    def example(self) -> int:
        """Id of the typical failure of the cluster with most failures."""
        return max(self.clusters, key=len).typical


@dataclass(frozen=True, repr=False)
class Clusters:
    """The distinct failures among many, the most severe first."""

    clusters: tuple[Cluster, ...]
    threshold: float
    """Largest root mean square difference within a cluster, in m."""

    def __len__(self) -> int:
        return len(self.clusters)

    def __repr__(self) -> str:
        """The clusters at a glance."""
        found, among = counted(len(self), "distinct failure"), counted(self.failures, "failure")
        return f"<Clusters: {found} among {among}>"

    def __iter__(self) -> Iterator[Cluster]:
        return iter(self.clusters)

    def __getitem__(self, place: int) -> Cluster:
        return self.clusters[place]

    @property
    def failures(self) -> int:
        """Number of failures in all clusters."""
        return sum(map(len, self.clusters))

    @cached_property
    def causes(self) -> tuple[CauseGroup, ...]:
        """The causes of the failures: faults of the driver first, then by number of failures."""
        groups: dict[object, list[Cluster]] = {}
        for one in self.clusters:
            if what := one.cause._replace(bends=None) if one.cause else one.fault:
                groups.setdefault(what, []).append(one)
        found = [CauseGroup(_cause_words(group), tuple(group)) for group in groups.values()]
        return tuple(sorted(found, key=lambda one: (one.fault is None, -one.failures)))

    @property
    def known(self) -> int:
        """Number of clusters that were known from earlier campaigns."""
        return sum(cluster.was_known is True for cluster in self.clusters)

    def of(self, id: int) -> Cluster:  # noqa: A002
        """The cluster of a test.

        Raises:
            KeyError: no failure has this id.
        """
        for cluster in self.clusters:
            if id in cluster.ids:
                return cluster
        raise KeyError(f"no failure has the id {id}")


def _cause_words(clusters: list[Cluster]) -> str:
    """What the driver does wrong in clusters with the same fault or the same kind of cause."""
    first, *_ = clusters
    if first.cause is None:
        return str(first.fault)
    kind, _, criterion = first.cause
    sides = Counter[Side | None]()
    for one in clusters:
        sides[one.cause and one.cause.bends] += len(one)
    side, most = sides.most_common(1)[0]
    share = most / sides.total()
    if side is None or share < _MOSTLY:
        return in_words(kind, None, criterion)
    if share > _NEARLY_ALL:
        return in_words(kind, side, criterion)
    return f"{in_words(kind, None, criterion)}, mostly {side}-hand"


def failures_of(store: CampaignStore, limit: int | None = None) -> list[Failure]:
    """The failures of a campaign, the most severe first, at most ``limit`` of them.

    A repeated road counts once, see `CampaignStore.repeats`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    records = store.tests(Outcome.FAIL, "moobd", limit, with_trajectory=True, with_repeats=False)
    return [failure for failure in map(Failure.of_test, records) if failure is not None]


def distinct_failures(store: CampaignStore, limit: int | None = COMPARED) -> Clusters:
    """The distinct failures of a campaign.

    If it started from earlier campaigns, those are marked as known of which a failure differs by at
    most 2 m from one that was taken from there.

    Args:
        store: the campaign.
        limit: number of failures to compare, the most severe first; None for all.

    Raises:
        CampaignError: the campaign is damaged.
    """
    return distinct_among(store, failures_of(store, limit))


def distinct_among(store: CampaignStore, failures: Sequence[Failure]) -> Clusters:
    """The distinct ones among failures of a campaign, marked likewise.

    Raises:
        CampaignError: the campaign is damaged.
    """
    found = cluster_failures(failures)
    moobd = Objective.load(MOOBD)
    earlier = [
        evaluation_of(test, partial(store.earlier_trajectory, test.id), moobd)
        for test in read_earlier(store)
        if test.outcome is Outcome.FAIL
    ]
    return _with_known(found, failures, earlier) if earlier else found


def _with_known(
    clusters: Clusters, failures: Iterable[Failure], earlier: Iterable[Evaluation]
) -> Clusters:
    places = [places_of(evaluation, evaluation.candidate, 0.0)[0] for evaluation in earlier]
    theirs = {
        side: np.array([one.vector for one in places if one.side == SIDES[side]]).reshape(-1, SIZE)
        for side in SIDES
    }
    known = {
        failure.id
        for failure in failures
        if is_near(theirs[failure.side], failure.vector(), THRESHOLD**2)
    }
    marked = (replace(one, was_known=not known.isdisjoint(one.ids)) for one in clusters)
    return Clusters(tuple(marked), clusters.threshold)


def nearest_misses(store: CampaignStore, number: int = NEAR_MISSES) -> Clusters:
    """The distinct near misses of a campaign: its passing tests of lowest MOOBD, the nearest first.

    They are told apart as failures are. Each cluster counts what is alike among the passing tests
    of lowest MOOBD, 500 or, if these hold too few distinct ones, 10 000.

    Args:
        store: the campaign.
        number: most near misses to return; fewer where there are fewer distinct ones.

    Raises:
        CampaignError: the campaign is damaged.
    """
    found = Clusters((), THRESHOLD)
    for limit in _PASSES_COMPARED:
        passes = segments_of(store, Outcome.PASS, order_by="moobd", limit=limit, with_repeats=False)
        found = cluster_failures(
            Failure.of(segment, id=record.id, moobd=record.moobd or 0.0, is_near_miss=True)
            for record, segment in passes
        )
        if len(found) >= number or found.failures < limit:
            break
    return Clusters(found.clusters[:number], THRESHOLD)


def representative_failures(
    store: CampaignStore, number: int = LISTED, *, clusters: Clusters | None = None
) -> list[Test]:
    """The most telling failures: an example of each cause, then others.

    These are the most severe ones of distinct failures without an example, the worst first. The
    records come without their trajectories; fewer where there are fewer distinct failures.

    Args:
        store: the campaign.
        number: most failures to return.
        clusters: its distinct failures, if known; or near misses.

    Raises:
        CampaignError: the campaign is damaged.
    """
    found = distinct_failures(store) if clusters is None else clusters
    examples = [cause.example for cause in found.causes]
    shown = [found.of(example) for example in examples]
    others = [one.most_severe for one in found if one not in shown]
    return [store.test(i, with_trajectory=False) for i in [*examples, *others][:number]]


def caution(store: CampaignStore) -> str:
    """What the counts alone may lead to believe wrongly, in a sentence; mostly empty.

    Nearly all random roads fail: then it may not be the roads. None fails: then little is known of
    what seldom fails. Faults of the driver do not count: they are told as such. The criteria ask
    for longer drives: then nothing is shown by them.
    """
    return "; ".join(filter(None, (_of_random_roads(store), _of_little_time(store))))


def _of_little_time(store: CampaignStore) -> str:
    """That nothing failed in less time than the criteria ask for."""
    rules: Any = store.config.get("rules") or {}
    criteria = rules.get("criteria", {})
    needed = criteria.get("driven_time", 0.0)
    if not needed or store.by_outcome()[Outcome.FAIL]:
        return ""
    rows = store.rows("SELECT id, duration FROM test WHERE outcome = 'PASS'")
    repeats = store.repeats()
    driven = sum(duration or 0.0 for number, duration in rows if number not in repeats)
    if driven >= needed:
        return ""
    return f"{driven:.0f} s were driven, and {criteria['name']} asks for {needed:.0f} s"


def _of_random_roads(store: CampaignStore) -> str:
    rows = store.rows(
        "SELECT id, outcome FROM test WHERE operator = 'random' AND fault IS NULL AND outcome IN"
        " ('PASS', 'FAIL')"
    )
    repeats = store.repeats()
    counts = Counter(outcome for number, outcome in rows if number not in repeats)
    failed, driven = counts["FAIL"], counts.total()
    if driven < _FEWEST:
        return ""
    if not store.by_outcome()[Outcome.FAIL]:
        most = 1.0 - _UNSURE ** (1.0 / driven)
        return (
            f"{counted(driven, 'random road')} passed, so fewer than {100.0 * most:.2g} % of such"
            " roads fail, with 95 % confidence; rarer failures take more roads"
        )
    if failed < _DOUBTFUL * driven:
        return ""
    return (
        f"{failed} of {driven} random roads fail: it may be the car, the speed or the code between"
        " driver and simulator, rather than the roads; see how a straight road is driven first"
    )


def cluster_failures(failures: Iterable[Failure], *, threshold: float = THRESHOLD) -> Clusters:
    """The distinct failures, by the rule in this module's text.

    Above `BATCH` different failures on one side, the most severe are linked first. Each of the
    others joins the cluster to whose members its root mean square difference is least, if that is
    at most the threshold. The rest are linked in turn.

    Args:
        failures: in any order, each id once.
        threshold: m, a larger one gives fewer clusters.

    Raises:
        ValueError: the threshold is not a positive number, or an id is there twice.
    """
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise ValueError(f"threshold is {threshold}: a positive number of metres is needed")
    listed = sorted(failures, key=lambda failure: failure.id)
    for one, other in pairwise(listed):
        if one.id == other.id:
            raise ValueError(f"failure {one.id} is there twice: give each failure once")
    clusters: list[Cluster] = []
    for kind in dict.fromkeys((one.side, one.fault, one.criterion) for one in listed):
        members = [one for one in listed if (one.side, one.fault, one.criterion) == kind]
        vectors = np.array([failure.vector() for failure in members])
        moobds = np.array([failure.moobd for failure in members])
        is_fault = kind[1] is not None
        labels = np.zeros_like(moobds) if is_fault else _labels(vectors, moobds, threshold)
        for label in np.unique(labels):
            own = np.flatnonzero(labels == label)
            clusters.append(_cluster([members[i] for i in own], vectors[own]))
    clusters.sort(key=lambda one: (one.fault is None, one.moobd, one.most_severe))
    return Clusters(tuple(clusters), threshold)


def _cluster(members: list[Failure], vectors: FloatArray) -> Cluster:
    squares = ((vectors - vectors.mean(axis=0)) ** 2).sum(axis=1)
    cause = Counter(one.cause for one in members).most_common(1)[0][0]
    has_cause = np.array([one.cause == cause for one in members])
    # Sums of squares differ by rounding where two members are mirror images or doubles: the first.
    is_least = squares <= squares[has_cause].min() + 1e-9
    typical = members[int(np.flatnonzero(is_least & has_cause)[0])]
    worst = min(members, key=lambda failure: (failure.moobd, failure.id))
    return Cluster(
        ids=tuple(failure.id for failure in members),
        most_severe=worst.id,
        typical=typical.id,
        moobd=worst.moobd,
        side=worst.side,
        spread=float(np.sqrt(squares.mean())),
        description=describe(worst),
        failure=worst,
        cause=cause,
    )


def _labels(vectors: FloatArray, moobds: FloatArray, threshold: float) -> IntArray:
    """(n,) number of the cluster of each of (n, m) vectors, from 0 and without a gap."""
    shapes, shape_of = np.unique(vectors + 0.0, axis=0, return_inverse=True)  # no negative zeros
    shape_of = shape_of.ravel()
    worst = np.full(len(shapes), np.inf)
    np.minimum.at(worst, shape_of, moobds)
    labels = np.full(len(shapes), -1, dtype=np.int64)
    waiting = np.argsort(worst, kind="stable")
    while len(waiting):
        # Sorted, so that ties do not depend on the given order.
        batch, waiting = np.sort(waiting[:BATCH]), waiting[BATCH:]
        first = labels.max() + 1
        linked = _link(shapes[batch], threshold)
        labels[batch] = first + linked
        nearest = _nearest_cluster(shapes[waiting], shapes[batch], linked, threshold)
        fits = nearest >= 0
        labels[waiting[fits]] = first + nearest[fits]
        waiting = waiting[~fits]
    found: IntArray = labels[shape_of]
    return found


def _link(shapes: FloatArray, threshold: float) -> IntArray:
    """(n,) number of the cluster of each of (n, m) different vectors, by average linkage."""
    from scipy.cluster.hierarchy import fcluster, linkage  # takes its time
    from scipy.spatial.distance import pdist

    if len(shapes) == 1:
        return np.zeros(1, dtype=np.int64)
    tree = linkage(pdist(shapes, "sqeuclidean"), "average")
    return fcluster(tree, threshold**2, "distance").astype(np.int64) - 1


def _nearest_cluster(
    vectors: FloatArray, shapes: FloatArray, labels: IntArray, threshold: float
) -> IntArray:
    """(k,) for each of (k, m) vectors the cluster it is nearest to; -1 beyond the threshold.

    The mean square difference from a cluster's members is that from their mean plus their variance.
    """
    counts = np.bincount(labels)
    means = np.zeros((len(counts), shapes.shape[1]))
    np.add.at(means, labels, shapes)
    means /= counts[:, None]
    variances = np.bincount(labels, ((shapes - means[labels]) ** 2).sum(axis=1)) / counts
    nearest = np.full(len(vectors), -1, dtype=np.int64)
    for i, vector in enumerate(vectors):
        squares = ((means - vector) ** 2).sum(axis=1) + variances
        least = int(squares.argmin())
        if squares[least] <= threshold**2:
            nearest[i] = least
    return nearest


# Describing a failure

_SLOWS: Final = 3.0  # [m/s] less at the place than before, to be mentioned


def describe_drive(segment: Segment, result: Result) -> str:
    """Description of a drive in one phrase, from its own road; empty unless it passed or failed.

    Args:
        segment: of the drive.
        result: the verdict on it.
    """
    if result.outcome is Outcome.PASS:
        return describe(Failure.of(segment, id=0, moobd=result.moobd or 0.0, is_near_miss=True))
    failure = Failure.of_segment(segment, result) if result.outcome is Outcome.FAIL else None
    return "" if failure is None else describe(failure)


def describe(failure: Failure) -> str:
    """Description in one phrase: ``leaves to the left 10 m behind a ..., at 41 km/h``."""
    if failure.fault is not None:
        return str(failure.fault)
    what = "fails in its lane" if failure.side is None else f"leaves to the {failure.side}"
    if failure.cause is not None and failure.cause.kind is Kind.EXCEEDS:
        what = in_words(Kind.EXCEEDS, None, failure.cause.criterion)
    if failure.criterion == EDGE_DISTANCE:
        what = f"comes too near to the {failure.side} edge"
    if failure.is_near_miss:
        beyond = "crosses" if failure.moobd < 0.0 else "comes nearest to"
        what = f"{beyond} the {failure.side} edge"
    # A car that has spun round may slide backwards.
    fastest, now = failure.speeds.max() * 3.6, max(failure.speeds[-1], 0.0) * 3.6
    how = f"at {now:.0f} km/h"
    if fastest - now > _SLOWS * 3.6:
        how = f"slowing from {fastest:.0f} to {now:.0f} km/h"
    where = place_in_words(failure.curvatures, failure.step, failure.place)
    return f"{what} {where}, {how}"
