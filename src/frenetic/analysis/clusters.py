"""Distinct failures: clusters of failures that are the same problem.

Failures on different sides of the lane, or by different criteria, are different problems. Other
failures are clustered by average linkage (UPGMA) on the square of their difference, see
`frenetic.analysis.failures`. Clusters are joined while the root mean square difference between
their members is at most 2 m, half a lane. Equal failures count once, so order and repetitions of
the failures do not matter.

Faults of the driver, such as exceptions, are the same problem if the same line raised, whatever the
road. They come first.

A distinct failure has the most frequent *cause* of its members, see `frenetic.segments.causes`.

The nearest misses are the passing tests of lowest MOOBD, clustered in the same way, relative to the
place where the car came nearest to its lane's edge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import counted, lane_words
from frenetic.analysis.failures import Failure, describe, failures_of
from frenetic.analysis.linkage import link
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.warm_start import read_earlier
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Side
from frenetic.search.approach import ALIKE, SIZE, is_near
from frenetic.search.archive import SIDES, critical_places
from frenetic.search.records import Evaluation
from frenetic.segments.causes import Cause, as_text

THRESHOLD: Final = ALIKE
"""Largest root mean square difference at which two clusters are joined, in m."""
COMPARED: Final = 10_000
"""Largest number of a campaign's failures that are compared, the most severe first."""
LISTED: Final = 10
"""Default number of representative failures that are listed and drawn."""
NEAR_MISSES: Final = 5
"""Default number of distinct near misses that are listed and drawn."""

_MOST: Final = 0.75
"""Least share of a cause's failures in bends to one side for "mostly" (our choice)."""
_NEARLY_ALL: Final = 0.95
"""Share above which the text names the side without "mostly" (our choice)."""
_PASSES_COMPARED: Final = 500, COMPARED
"""Numbers of passing tests that are compared: the second if the first gives too few near misses."""
_SAME_SQUARE: Final = 1e-9
"""Difference of two square distances that a rounding error can make, in m²."""


@dataclass(frozen=True)
class Cluster:
    """Cluster of failures that are the same problem."""

    ids: tuple[int, ...]
    """Ids of the tests, ascending."""
    most_severe: int
    """Id of the failure with the lowest MOOBD."""
    typical: int
    """Id of the failure nearest to the cluster's mean, among those with the most frequent cause."""
    moobd: float
    """Lowest MOOBD, in m."""
    side: Side | None
    """Side of the lane on which the car left; None if it failed without leaving."""
    spread: float
    """Root mean square difference of the failures from their mean, in m."""
    description: str
    """Description of the most severe failure, in one phrase."""
    was_known: bool | None = None
    """Whether an earlier campaign, from which the campaign started, holds a failure like one of
    these; None if the campaign started afresh."""
    failure: Failure | None = field(default=None, repr=False, compare=False)
    """Most severe failure, for its picture."""
    cause: Cause | None = None
    """Most frequent cause of the failures; None for a fault or a near miss."""

    @property
    def fault(self) -> Fault | None:
        """Fault of the driver that ended all of the drives, at one line of its code."""
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
    """Distinct failures with the same cause."""

    words: str
    """Cause without a subject: ``brakes too late into right-hand bends``."""
    clusters: tuple[Cluster, ...]
    """Distinct failures, the most severe first."""

    @property
    def fault(self) -> Fault | None:
        """Fault of the driver that is the cause; None for another cause."""
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
    """Distinct failures among many, the most severe first."""

    clusters: tuple[Cluster, ...]
    threshold: float
    """Largest root mean square difference at which clusters were joined, in m."""

    def __len__(self) -> int:
        return len(self.clusters)

    def __repr__(self) -> str:
        """Return the numbers of distinct failures and failures."""
        distinct = counted(len(self), "distinct failure")
        return f"<Clusters: {distinct} among {counted(self.failures, 'failure')}>"

    def __iter__(self) -> Iterator[Cluster]:
        return iter(self.clusters)

    def __getitem__(self, index: int) -> Cluster:
        return self.clusters[index]

    @property
    def failures(self) -> int:
        """Number of failures in all clusters."""
        return sum(map(len, self.clusters))

    @cached_property
    def causes(self) -> tuple[CauseGroup, ...]:
        """Causes of the failures: faults of the driver first, then by number of failures."""
        groups: dict[Cause | Fault, list[Cluster]] = {}
        for cluster in self.clusters:
            # Left-hand and right-hand bends are one cause; the text says which.
            cause = cluster.cause._replace(bend_side=None) if cluster.cause else cluster.fault
            if cause:
                groups.setdefault(cause, []).append(cluster)
        causes = [CauseGroup(_cause_words(group), tuple(group)) for group in groups.values()]
        return tuple(sorted(causes, key=lambda cause: (cause.fault is None, -cause.failures)))

    @property
    def known(self) -> int:
        """Number of clusters with a failure that an earlier campaign holds, too."""
        return sum(cluster.was_known is True for cluster in self.clusters)

    def of(self, id: int) -> Cluster:  # noqa: A002
        """Return the cluster of a test.

        Raises:
            KeyError: no failure has this id.
        """
        for cluster in self.clusters:
            if id in cluster.ids:
                return cluster
        raise KeyError(f"no failure has the id {id}")


def _cause_words(clusters: list[Cluster]) -> str:
    """Return the cause in words of clusters with the same fault or kind of cause."""
    first = clusters[0]
    if first.cause is None:
        return str(first.fault)
    kind, criterion = first.cause.kind, first.cause.criterion
    failures_by_side = Counter[Side | None]()
    for cluster in clusters:
        failures_by_side[cluster.cause and cluster.cause.bend_side] += len(cluster)
    side, failures = failures_by_side.most_common(1)[0]
    share = failures / failures_by_side.total()
    if side is None or share < _MOST:
        return as_text(kind, None, criterion)
    if share > _NEARLY_ALL:
        return as_text(kind, side, criterion)
    return f"{as_text(kind, None, criterion)}, mostly {side}-hand"


def distinct_failures(store: CampaignStore, limit: int | None = COMPARED) -> Clusters:
    """Return the distinct failures of a campaign.

    If the campaign started from earlier campaigns, a distinct failure was known if one of its
    failures differs by less than `THRESHOLD` from a failure of the earlier campaigns.

    Args:
        store: the campaign.
        limit: number of failures to compare, the most severe first; None for all.

    Raises:
        CampaignError: the campaign is damaged.
    """
    return distinct_among(store, failures_of(store, limit))


def distinct_among(store: CampaignStore, failures: Sequence[Failure]) -> Clusters:
    """Return the distinct failures among some failures of a campaign, see `distinct_failures`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    clusters = cluster_failures(failures)
    moobd = Objective.load(MOOBD)
    earlier = [
        evaluation_of(test, partial(store.earlier_trajectory, test.id), moobd)
        for test in read_earlier(store)
        if test.outcome is Outcome.FAIL
    ]
    return _mark_known(clusters, failures, earlier) if earlier else clusters


def _mark_known(
    clusters: Clusters, failures: Iterable[Failure], earlier: Iterable[Evaluation]
) -> Clusters:
    """Return clusters marked whether one of their failures is near an earlier failure.

    Args:
        clusters: clusters of the failures.
        failures: failures of the campaign.
        earlier: failed tests of earlier campaigns.
    """
    # The first critical place is where the drive failed; its severity does not matter here.
    places = [critical_places(evaluation, evaluation.candidate, 0.0)[0] for evaluation in earlier]
    earlier_vectors = {
        side: np.array([place.vector for place in places if place.side == number]).reshape(-1, SIZE)
        for side, number in SIDES.items()
    }
    known = {
        failure.id
        for failure in failures
        if is_near(earlier_vectors[failure.side], failure.vector(), THRESHOLD**2)
    }
    marked = (replace(cluster, was_known=not known.isdisjoint(cluster.ids)) for cluster in clusters)
    return Clusters(tuple(marked), clusters.threshold)


def nearest_misses(store: CampaignStore, number: int = NEAR_MISSES) -> Clusters:
    """Return the distinct near misses of a campaign: passing tests, by lowest MOOBD.

    The 500 passing tests of lowest MOOBD are clustered as failures are. If they give fewer than
    `number` clusters, the 10 000 passing tests of lowest MOOBD are clustered.

    Args:
        store: the campaign.
        number: most near misses to return.

    Raises:
        CampaignError: the campaign is damaged.
    """
    clusters = Clusters((), THRESHOLD)
    for limit in _PASSES_COMPARED:
        passes = store.tests(Outcome.PASS, "moobd", limit, with_segments=True, with_repeats=False)
        misses = map(Failure.of_driven, passes)
        clusters = cluster_failures(miss for miss in misses if miss is not None)
        if len(clusters) >= number or clusters.failures < limit:
            break
    return Clusters(clusters.clusters[:number], THRESHOLD)


def representative_failures(
    store: CampaignStore, number: int = LISTED, *, clusters: Clusters | None = None
) -> list[Test]:
    """Return representative failures: a typical failure of each cause, then the most severe ones.

    The latter are the most severe failures of the distinct failures that have no typical failure
    in the list, the worst first. The tests come without their trajectories.

    Args:
        store: the campaign.
        number: most failures to return.
        clusters: distinct failures or near misses of the campaign; by default its distinct
            failures.

    Raises:
        CampaignError: the campaign is damaged.
    """
    clusters = distinct_failures(store) if clusters is None else clusters
    examples = [cause.example for cause in clusters.causes]
    with_example = [clusters.of(example) for example in examples]
    others = [cluster.most_severe for cluster in clusters if cluster not in with_example]
    ids = [*examples, *others][:number]
    return [store.test(test_id, with_trajectory=False) for test_id in ids]


def cluster_failures(failures: Iterable[Failure], *, threshold: float = THRESHOLD) -> Clusters:
    """Return the distinct failures, by the rules in this module's docstring.

    The most severe failures are linked first if there are too many for one batch, see
    `frenetic.analysis.linkage`.

    Args:
        failures: failures in any order, each id once.
        threshold: largest root mean square difference at which clusters are joined, in m.

    Raises:
        ValueError: the threshold is not a positive number, or two failures have the same id.
    """
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise ValueError(f"threshold is {threshold}: a positive number of metres is needed")
    listed = sorted(failures, key=lambda failure: failure.id)
    for failure, following in pairwise(listed):
        if failure.id == following.id:
            raise ValueError(f"failure {failure.id} is there twice: give each failure once")
    # Only failures of one group can be the same problem.
    groups: dict[tuple[Side | None, Fault | None, str | None], list[Failure]] = {}
    for failure in listed:
        groups.setdefault((failure.side, failure.fault, failure.criterion), []).append(failure)
    clusters: list[Cluster] = []
    for (_, fault, _), members in groups.items():
        vectors = np.array([failure.vector() for failure in members])
        moobds = np.array([failure.moobd for failure in members])
        labels = link(vectors, moobds, threshold) if fault is None else np.zeros_like(moobds)
        for label in np.unique(labels):
            indices = np.flatnonzero(labels == label)
            clusters.append(_cluster([members[i] for i in indices], vectors[indices]))
    clusters.sort(key=lambda cluster: (cluster.fault is None, cluster.moobd, cluster.most_severe))
    return Clusters(tuple(clusters), threshold)


def _cluster(members: list[Failure], vectors: FloatArray) -> Cluster:
    """Return the cluster of some failures with their (n, 64) vectors."""
    squares = ((vectors - vectors.mean(axis=0)) ** 2).sum(axis=1)
    cause = Counter(failure.cause for failure in members).most_common(1)[0][0]
    has_cause = np.array([failure.cause == cause for failure in members])
    # Squares of mirror images or doubles differ by rounding errors: the first of them is typical.
    is_nearest = squares <= squares[has_cause].min() + _SAME_SQUARE
    typical = members[int(np.flatnonzero(is_nearest & has_cause)[0])]
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
