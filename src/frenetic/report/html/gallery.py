"""The distinct failures, or the nearest misses, as pictures."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from frenetic._support.words import counted
from frenetic.again.verdicts import Repeats
from frenetic.analysis.failures import Clusters
from frenetic.report.html.blocks import Part, Section


def gallery_section(
    clusters: Clusters,
    moobds: Mapping[int, float],
    shown: Collection[int],
    again: Iterable[Repeats],
    failures: int,
    broken: str,
) -> Section:
    """The failures as pictures; the nearest misses where nothing failed.

    Args:
        clusters: the distinct failures, or misses.
        moobds: m, of each of their tests.
        shown: ids of the tests with a drive in the page.
        again: those failures that were driven again with the same parts.
        failures: number of all failures.
        broken: what is wrong where every drive ended with an error; mostly empty.
    """
    data: list[dict[str, Any]] = [
        {
            "most_severe": one.most_severe,
            "size": len(one),
            "shown": sorted(
                (i for i in one.ids if i in shown), key=lambda i: (moobds.get(i, 0.0), i)
            ),
            "moobd": round(one.moobd, 3),
            "side": one.side,
            "first": min(one.ids),
            "description": f"{one.description}{', known before' if one.was_known else ''}",
        }
        for one in clusters
    ]
    repeats = [
        {
            "test": one.id,
            "stability": one.stability,
            "share": one.share,
            "low": round(one.interval[0], 4),
            "high": round(one.interval[1], 4),
            "text": f"{one}; {one.what_varied}",
        }
        for one in again
        if one.stability is not None
    ]
    if failures:
        title, lead = "Failures", _lead(clusters, failures, data)
    else:
        title, lead = "Nearest misses", f"{broken or 'No failure was found'}."
        if not data:
            return Section("failures", "Failures", (), lead)
        lead += (
            " These tests passed and came nearest to failing, by MOOBD. Those that would be the"
            " same problem are together."
        )
    return Section(
        "failures", title, (Part("gallery", {"clusters": data, "repeats": repeats}),), lead
    )


def _lead(clusters: Clusters, failures: int, data: Sequence[Mapping[str, Any]]) -> str:
    lead = (
        f"{counted(len(clusters), 'distinct failure')} among {clusters.failures}: failures that are"
        " the same problem are together, by their most severe."
    )
    for cluster, one in zip(clusters, data, strict=True):
        if cluster.fault is not None and not one["shown"]:
            lead += (
                f" The driver {cluster.fault} in {counted(len(cluster), 'drive')} that left no"
                f" record, such as test {cluster.most_severe}."
            )
    if clusters.known:
        lead += f" {clusters.known} of them were known from the earlier campaign."
    if clusters.failures < failures:
        lead += f" Compared were the {clusters.failures} most severe of {failures}."
    there = sum(len(one["shown"]) for one in data)
    if there < failures:
        lead += (
            f" {there} of {failures} failures can be opened here; 'frenetic show' shows any other."
        )
    return lead
