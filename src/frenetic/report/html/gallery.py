"""Section of a page: the distinct failures, or the nearest misses, as pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any

from frenetic._support.words import capitalised, counted
from frenetic.analysis.clusters import Clusters
from frenetic.analysis.explained import ExplainedCause, explained_causes
from frenetic.campaign.counts import Counts
from frenetic.campaign.store import CampaignStore
from frenetic.report.html.page import DataBlock, Section, Table
from frenetic.report.html.tests import TestSummary
from frenetic.rerun.reruns import Rerun, in_other_simulators, own_repeats, rerun_name
from frenetic.rerun.stability import Repeats
from frenetic.segments.causes import as_text
from frenetic.segments.passing import PassingDrives


def gallery_section(
    store: CampaignStore,
    clusters: Clusters,
    tests: Sequence[TestSummary],
    drives: Sequence[Mapping[str, Any]],
    counts: Counts,
    reruns: Sequence[Rerun],
    passing: PassingDrives | None,
) -> Section:
    """Return the section with causes and pictures of failures, or nearest misses if nothing failed.

    Args:
        store: the campaign.
        clusters: the distinct failures, or the nearest misses.
        tests: all tests of the campaign.
        drives: data of the drives in the page, see `drive_data`.
        counts: counts of all tests.
        reruns: the reruns of the campaign's tests.
        passing: passing drives with which mistakes are compared.
    """
    config = store.config
    data = _cluster_data(clusters, tests, {drive["id"] for drive in drives})
    elsewhere = [
        {
            "test": test.id,
            "where": rerun_name(rerun, config),
            "text": f"{test.verdict}: {test.drives[0].reason}",
        }
        for rerun in in_other_simulators(reruns, config)
        for test in rerun.tests
    ]
    gallery = DataBlock(
        "gallery",
        {"clusters": data, "repeats": _repeat_data(own_repeats(reruns)), "elsewhere": elsewhere},
    )
    if counts.failed:
        causes = explained_causes(store, clusters, passing)
        blocks = (_causes(causes, drives), gallery) if causes else (gallery,)
        return Section("failures", "Failures", blocks, _lead(clusters, counts.failures, data))
    lead = f"{capitalised(counts.broken_text) or 'No failure was found'}."
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
    """Return the clusters for the script, first the clusters with an example of a cause.

    Args:
        clusters: the distinct failures, or the nearest misses.
        tests: all tests of the campaign.
        shown: ids of the tests whose drives are in the page.
    """
    moobds = {test.id: test.moobd or 0.0 for test in tests}
    causes = {cluster.ids: cause for cause in clusters.causes for cluster in cause.clusters}
    examples = [cause.example for cause in clusters.causes]

    def order(id: int) -> tuple[bool, float, int]:  # noqa: A002
        return id not in examples, moobds.get(id, 0.0), id

    with_examples = [clusters.of(example) for example in examples]
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
        for cluster in dict.fromkeys([*with_examples, *clusters])
    ]


def _repeat_data(repeats: Iterable[Repeats]) -> list[dict[str, Any]]:
    """Return how often failures failed again, for the script."""
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


def _causes(causes: Sequence[ExplainedCause], drives: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of causes, each with an example that opens if its drive is in the page."""
    road_texts = {drive["id"]: _road_text(drive) for drive in drives}
    rows = tuple(
        (
            capitalised(cause.group.words),
            "" if cause.certainty is None else str(cause.certainty),
            str(cause.group.failures),
            str(len(cause.group.clusters)),
            capitalised(cause.as_text()),
            f"test {cause.group.example}{road_texts.get(cause.group.example, '')}",
        )
        for cause in causes
    )
    examples = [cause.group.example for cause in causes]
    links = tuple(f"#test-{i}" if i in road_texts else None for i in examples)
    heads = ("the driver", "how sure", ">failures", ">distinct", "in an example", "the example")
    return Table(heads, rows, links=links)


def _road_text(drive: Mapping[str, Any]) -> str:
    """Return the lengths of a road and its minimised road, such as ``: 240 m, cut to 80 m``."""
    roads = [drive["road"]]
    if drive["minimised"]:
        roads.append(drive["minimised"]["drive"]["road"])
    return ": " + ", cut to ".join(
        f"{road['step'] * (len(road['curvatures']) - 1):.0f} m" for road in roads
    )


def _lead(clusters: Clusters, failures: int, data: Sequence[Mapping[str, Any]]) -> str:
    """Return the text above the failures.

    Args:
        clusters: the distinct failures.
        failures: number of all failures.
        data: the clusters for the script.
    """
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
    shown = sum(len(cluster_data["shown"]) for cluster_data in data)
    if shown < failures:
        lead += (
            f" {shown} of {failures} failures can be opened here; 'frenetic show' shows the others."
        )
    return lead
