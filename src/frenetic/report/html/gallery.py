"""The distinct failures, or the nearest misses, as pictures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from frenetic._support.words import capitalised, counted
from frenetic.analysis.causes import in_words
from frenetic.analysis.clusters import Clusters
from frenetic.campaign.counts import Counts
from frenetic.report.html.page import Part, Section, Table
from frenetic.report.html.tests import TestSummary
from frenetic.rerun.rerun import Rerun, rerun_name
from frenetic.rerun.stability import Repeats


def gallery_section(
    clusters: Clusters,
    tests: Sequence[TestSummary],
    drives: Sequence[Mapping[str, Any]],
    counts: Counts,
    again: Iterable[Repeats],
    there: Iterable[Rerun],
    config: Mapping[str, Any],
) -> Section:
    """The causes of failures, and the failures as pictures; the nearest misses without any.

    Args:
        clusters: the distinct failures, or misses; an example of each cause comes first.
        tests: all of the campaign.
        drives: in the page, see `drive_data`.
        counts: of all tests.
        again: those failures that were driven again with the same parts.
        there: the reruns in other simulators.
        config: of the campaign.
    """
    shown = {drive["id"] for drive in drives}
    moobds = {test.id: test.moobd or 0.0 for test in tests}
    causes = {one.ids: cause for cause in clusters.causes for one in cause.clusters}
    examples = [cause.example for cause in clusters.causes]

    def order(id: int) -> tuple[bool, float, int]:  # noqa: A002
        return id not in examples, moobds.get(id, 0.0), id

    first = [clusters.of(example) for example in examples]
    data: list[dict[str, Any]] = [
        {
            "most_severe": one.most_severe,
            "size": len(one),
            "shown": sorted((i for i in one.ids if i in shown), key=order),
            "moobd": round(one.moobd, 3),
            "side": one.side,
            "first": min(one.ids),
            "group": causes[one.ids].words if one.ids in causes else "",
            "cause": "" if one.cause is None else in_words(*one.cause),
            "was_known": one.was_known is True,
        }
        for one in dict.fromkeys([*first, *clusters])
    ]
    repeats = [
        {
            "test": one.id,
            "stability": one.stability,
            "share": one.share,
            "low": round(one.interval[0], 4),
            "high": round(one.interval[1], 4),
            "text": f"{one}; {one.variations_text}",
        }
        for one in again
        if one.stability is not None
    ]
    elsewhere = [
        {
            "test": test.id,
            "where": rerun_name(rerun, config),
            "text": f"{test.verdict}: {test.drives[0].reason}",
        }
        for rerun in there
        for test in rerun.tests
    ]
    gallery = Part("gallery", {"clusters": data, "repeats": repeats, "elsewhere": elsewhere})
    if counts.failed:
        blocks = (_causes(clusters, drives), gallery) if examples else (gallery,)
        return Section("failures", "Failures", blocks, _lead(clusters, counts.failures, data))
    lead = f"{capitalised(counts.broken) or 'No failure was found'}."
    if not data:
        return Section("failures", "Failures", (), lead)
    lead += (
        " These tests passed and came nearest to failing, by MOOBD. Those that would be the same"
        " problem are together."
    )
    return Section("failures", "Nearest misses", (gallery,), lead)


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
    """How long the road of a drive was, and is."""
    roads = [drive["road"], *([drive["minimised"]["drive"]["road"]] if drive["minimised"] else [])]
    return ": " + ", cut to ".join(
        f"{road['step'] * (len(road['curvatures']) - 1):.0f} m" for road in roads
    )


def _lead(clusters: Clusters, failures: int, data: Sequence[Mapping[str, Any]]) -> str:
    lead = (
        f"{counted(len(clusters), 'distinct failure')} among {clusters.failures}, and what the"
        " driver does wrong. Failures that are the same problem are together."
    )
    for cluster, one in zip(clusters, data, strict=True):
        if cluster.fault is not None and not one["shown"]:
            lead += (
                f" The driver {cluster.fault} in {counted(len(cluster), 'drive')} that left no"
                f" record, such as test {cluster.most_severe}."
            )
    if clusters.failures < failures:
        lead += f" Compared were the {clusters.failures} most severe of {failures}."
    there = sum(len(one["shown"]) for one in data)
    if there < failures:
        lead += (
            f" {there} of {failures} failures can be opened here; 'frenetic show' shows any other."
        )
    return lead
