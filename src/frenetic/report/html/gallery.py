"""The distinct failures, or the nearest misses, and their ancestors."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from frenetic._support.words import counted
from frenetic.again import verdicts
from frenetic.analysis.failures import Cluster, Clusters
from frenetic.campaign.counts import Counts
from frenetic.oracle import Side
from frenetic.report.html.blocks import Section


@dataclass(frozen=True)
class Repeats:
    """Share of a failure's drives that fail again."""

    test: int
    stability: str
    share: float | None
    """Share of the drives that failed, 0..1."""
    low: float
    """Ends of the share's 95 % interval."""
    high: float
    text: str


@dataclass(frozen=True)
class ClusterData:
    """Failures that are the same problem."""

    most_severe: int
    typical: int
    size: int
    shown: tuple[int, ...]
    """Ids of the failures with a drive in the page, the most severe first."""
    moobd: float
    """Moobd in m, the lowest."""
    side: Side | None
    first: int
    """Id of the first one found."""
    description: str


@dataclass(frozen=True)
class Gallery:
    """Pictures of failures, by cluster."""

    kind: ClassVar[str] = "gallery"
    clusters: tuple[ClusterData, ...]
    repeats: tuple[Repeats, ...]


@dataclass(frozen=True)
class Family:
    """Operators that led to a failure: a tree for the chosen one."""

    kind: ClassVar[str] = "family"
    ids: tuple[int, ...]
    """Ids of the tests to choose from."""


def gallery_section(
    clusters: Clusters,
    moobds: Mapping[int, float],
    shown: Collection[int],
    again: Iterable[verdicts.Repeats],
    failures: int,
) -> Section:
    """The failures as pictures.

    Args:
        clusters: the distinct failures.
        moobds: m, of each of their tests.
        shown: ids of the tests with a drive in the page.
        again: those failures that were driven again with the same parts.
        failures: number of all failures.
    """
    data = tuple(_cluster_data(cluster, moobds, shown) for cluster in clusters if cluster.ids)
    there = sum(len(cluster.shown) for cluster in data)
    lead = (
        f"{counted(len(data), 'distinct failure')} among {clusters.failures}: failures that are"
        " the same problem are together, by their most severe."
    )
    if clusters.known:
        lead += f" {clusters.known} of them were known from the earlier campaign."
    if clusters.failures < failures:
        lead += f" Compared were the {clusters.failures} most severe of {failures}."
    if there < failures:
        lead += (
            f" {there} of {failures} failures can be opened here; 'frenetic show' shows any other."
        )
    repeats = tuple(
        Repeats(
            one.id,
            str(one.stability),
            one.share,
            round(one.interval[0], 4),
            round(one.interval[1], 4),
            f"{one}; {one.what_varied}",
        )
        for one in again
        if one.stability is not None
    )
    return Section("failures", "Failures", (Gallery(data, repeats),), lead)


def misses_section(
    misses: Clusters, counts: Counts, moobds: Mapping[int, float], shown: Collection[int]
) -> Section:
    """The nearest misses as pictures, where nothing failed; for its arguments see above."""
    lead = f"{counts.broken or 'No failure was found'}."
    if not misses:
        return Section("failures", "Failures", (), lead)
    lead += (
        " These tests passed and came nearest to failing, by MOOBD. Those that would be the same"
        " problem are together."
    )
    data = tuple(_cluster_data(cluster, moobds, shown) for cluster in misses)
    return Section("failures", "Nearest misses", (Gallery(data, ()),), lead)


def family_section(clusters: Clusters, shown: Collection[int]) -> Section:
    """The ancestors of a failure, or of a near miss."""
    ids = tuple(cluster.most_severe for cluster in clusters if cluster.most_severe in shown)
    lead = (
        "Which roads a test descends from, and by which operators. A road that can be opened"
        " here is a button."
    )
    if not ids:
        return Section("family", "Family tree", (), "No test failed or passed.")
    return Section("family", "Family tree", (Family(ids),), lead)


def _cluster_data(
    cluster: Cluster, moobds: Mapping[int, float], shown: Collection[int]
) -> ClusterData:
    members = sorted((i for i in cluster.ids if i in shown), key=lambda i: (moobds.get(i, 0.0), i))
    return ClusterData(
        most_severe=cluster.most_severe,
        typical=cluster.typical,
        size=len(cluster),
        shown=tuple(members),
        moobd=round(cluster.moobd, 3),
        side=cluster.side,
        first=min(cluster.ids),
        description=f"{cluster.description}, known before"
        if cluster.was_known
        else cluster.description,
    )
