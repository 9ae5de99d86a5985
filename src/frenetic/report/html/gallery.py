"""The distinct failures, or the nearest misses, as pictures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from frenetic._support.words import counted
from frenetic.again import verdicts
from frenetic.analysis.failures import Cluster, Clusters
from frenetic.campaign.counts import Counts
from frenetic.report.html.blocks import Part, Section


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
    there = sum(len(cluster["shown"]) for cluster in data)
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
        {
            "test": one.id,
            "stability": str(one.stability),
            "share": one.share,
            "low": round(one.interval[0], 4),
            "high": round(one.interval[1], 4),
            "text": f"{one}; {one.what_varied}",
        }
        for one in again
        if one.stability is not None
    )
    return Section("failures", "Failures", (_gallery(data, repeats),), lead)


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
    return Section("failures", "Nearest misses", (_gallery(data, ()),), lead)


def _gallery(clusters: Sequence[Mapping[str, Any]], repeats: Sequence[Mapping[str, Any]]) -> Part:
    return Part("gallery", {"clusters": tuple(clusters), "repeats": tuple(repeats)})


def _cluster_data(
    cluster: Cluster, moobds: Mapping[int, float], shown: Collection[int]
) -> dict[str, Any]:
    """Failures that are the same problem, those with a drive in the page the most severe first."""
    members = sorted((i for i in cluster.ids if i in shown), key=lambda i: (moobds.get(i, 0.0), i))
    known = ", known before" if cluster.was_known else ""
    return {
        "most_severe": cluster.most_severe,
        "typical": cluster.typical,
        "size": len(cluster),
        "shown": tuple(members),
        "moobd": round(cluster.moobd, 3),
        "side": cluster.side,
        "first": min(cluster.ids),
        "description": f"{cluster.description}{known}",
    }
