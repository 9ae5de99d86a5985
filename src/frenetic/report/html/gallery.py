"""Section of a page: the distinct failures, or the nearest misses, as pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

from frenetic._support.words import capitalised, counted
from frenetic.analysis.causes import as_text
from frenetic.analysis.clusters import Clusters
from frenetic.campaign.counts import Counts
from frenetic.report.html.page import DataBlock, Section, Table
from frenetic.report.html.tests import TestSummary
from frenetic.rerun.reruns import Rerun, rerun_name
from frenetic.rerun.stability import Repeats


def gallery_section(
    clusters: Clusters,
    tests: Sequence[TestSummary],
    drives: Sequence[Mapping[str, Any]],
    counts: Counts,
    repeats: Iterable[Repeats],
    reruns: Iterable[Rerun],
    config: Mapping[str, Any],
) -> Section:
    """Return the causes and pictures of failures, or the nearest misses if nothing failed.

    Args:
        clusters: the distinct failures, or misses; an example of each cause comes first.
        tests: all tests of the campaign.
        drives: drives in the page, see `drive_data`.
        counts: counts of all tests.
        repeats: failures that were driven again with the same parts.
        reruns: the reruns in other simulators.
        config: configuration of the campaign.
    """
    data = _cluster_data(clusters, tests, {drive["id"] for drive in drives})
    elsewhere = [
        {
            "test": test.id,
            "where": rerun_name(rerun, config),
            "text": f"{test.verdict}: {test.drives[0].reason}",
        }
        for rerun in reruns
        for test in rerun.tests
    ]
    blocks = {"clusters": data, "repeats": _repeat_data(repeats), "elsewhere": elsewhere}
    gallery = DataBlock("gallery", blocks)
    if counts.failed:
        has_causes = bool(clusters.causes)
        shown = (_causes(clusters, drives), gallery) if has_causes else (gallery,)
        return Section("failures", "Failures", shown, _lead(clusters, counts.failures, data))
    lead = f"{capitalised(counts.broken) or 'No failure was found'}."
    if not data:
        return Section("failures", "Failures", (), lead)
    lead += (
        " These tests passed and came nearest to failing, by MOOBD. Tests with the same problem are"
        " together."
    )
    return Section("failures", "Nearest misses", (gallery,), lead)


def _cluster_data(
    clusters: Clusters, tests: Sequence[TestSummary], shown: Set[int]
) -> list[dict[str, Any]]:
    """Return the clusters for the script, first those with an example of a cause.

    Args:
        clusters: the distinct failures, or misses.
        tests: all tests of the campaign.
        shown: ids of the tests whose drives are in the page.
    """
    moobds = {test.id: test.moobd or 0.0 for test in tests}
    causes = {cluster.ids: cause for cause in clusters.causes for cluster in cause.clusters}
    examples = [cause.example for cause in clusters.causes]

    def order(id: int) -> tuple[bool, float, int]:  # noqa: A002
        return id not in examples, moobds.get(id, 0.0), id

    first = [clusters.of(example) for example in examples]
    return [
        {
            "most_severe": cluster.most_severe,
            "size": len(cluster),
            "shown": sorted((i for i in cluster.ids if i in shown), key=order),
            "moobd": round(cluster.moobd, 3),
            "side": cluster.side,
            "first": min(cluster.ids),
            "group": causes[cluster.ids].words if cluster.ids in causes else "",
            "cause": "" if cluster.cause is None else as_text(*cluster.cause),
            "was_known": cluster.was_known is True,
        }
        for cluster in dict.fromkeys([*first, *clusters])
    ]


def _repeat_data(repeats: Iterable[Repeats]) -> list[dict[str, Any]]:
    """Return the judged repeats for the script."""
    return [
        {
            "test": repeat.id,
            "stability": repeat.stability,
            "share": repeat.share,
            "low": round(repeat.interval[0], 4),
            "high": round(repeat.interval[1], 4),
            "text": f"{repeat}; {repeat.variations_text}",
        }
        for repeat in repeats
        if repeat.stability is not None
    ]


def _causes(clusters: Clusters, drives: Sequence[Mapping[str, Any]]) -> Table:
    roads = {drive["id"]: _road(drive) for drive in drives}
    rows = tuple(
        (
            capitalised(cause.words),
            str(cause.failures),
            str(len(cause.clusters)),
            f"test {cause.example}{roads.get(cause.example, '')}",
        )
        for cause in clusters.causes
    )
    examples = [cause.example for cause in clusters.causes]
    links = tuple(f"#test-{i}" if i in roads else None for i in examples)
    return Table(("the driver", ">failures", ">distinct", "an example"), rows, links=links)


def _road(drive: Mapping[str, Any]) -> str:
    """Return the length of a drive's road, and to how much it was cut."""
    roads = [drive["road"], *([drive["minimised"]["drive"]["road"]] if drive["minimised"] else [])]
    return ": " + ", cut to ".join(
        f"{road['step'] * (len(road['curvatures']) - 1):.0f} m" for road in roads
    )


def _lead(clusters: Clusters, failures: int, data: Sequence[Mapping[str, Any]]) -> str:
    lead = (
        f"{counted(len(clusters), 'distinct failure')} among {clusters.failures}, and what the"
        " driver does wrong. Failures with the same problem are together."
    )
    for cluster, cluster_data in zip(clusters, data, strict=True):
        if cluster.fault is not None and not cluster_data["shown"]:
            lead += (
                f" The driver {cluster.fault} in {counted(len(cluster), 'drive')} that left no"
                f" record, such as test {cluster.most_severe}."
            )
    if clusters.failures < failures:
        lead += f" Only the {clusters.failures} most severe of {failures} were compared."
    here = sum(len(cluster_data["shown"]) for cluster_data in data)
    if here < failures:
        lead += (
            f" {here} of {failures} failures can be opened here; 'frenetic show' shows the others."
        )
    return lead
