"""Tables of distinct failures, near misses and causes; their JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import TYPE_CHECKING, Any

from frenetic._support.words import capitalised, counted, oob_unit
from frenetic.cli import echo
from frenetic.cli.console import ResultsConsole, print_table

if TYPE_CHECKING:
    from frenetic.analysis import Cluster, Clusters
    from frenetic.analysis.explained import ExplainedCause
    from frenetic.campaign import CampaignStore, Test
    from frenetic.campaign.counts import Counts


def print_failures(clusters: Clusters, counts: Counts, listed: int, lane_width: float) -> None:
    """Print a table of distinct failures or, if nothing failed, of the nearest misses.

    `print_causes` prints before a table of failures how often the simulator broke, and how many
    failures were compared.

    Args:
        clusters: the distinct failures or near misses.
        counts: counts of the campaign; possibly with more failures than were compared.
        listed: number of clusters to print.
        lane_width: width of the lane, in m.
    """
    if counts.broken_text and not counts.failures:
        ResultsConsole().print(capitalised(counts.broken_text), style="bold", markup=False)
    if not clusters:
        return
    if counts.failures:
        heading = "what happens"
        title = counted(len(clusters), "distinct failure")
        if listed < len(clusters):
            title += f", the {listed} most severe"
    else:
        heading = "where the car came nearest to leaving its lane"
        title = f"The nearest {'miss' if len(clusters) == 1 else 'misses'}"
        if not counts.broken_text:
            title = f"Nothing failed; {title.lower()}"
    ResultsConsole().print(title, style="bold", markup=False)
    listed_clusters = clusters.clusters[:listed]
    distance_heading, sign = _distance_column(listed_clusters, lane_width)
    print_table(
        (">test", distance_heading, ">tests", heading),
        [
            (
                cluster.most_severe,
                # A drive that a fault ended has no MOOBD that says something of the driver.
                None if cluster.fault is not None else f"{sign * cluster.moobd:.2f}",
                len(cluster),
                f"{'known before: ' if cluster.was_known else ''}{cluster.description}",
            )
            for cluster in listed_clusters
        ],
    )


def _distance_column(clusters: Sequence[Cluster], lane_width: float) -> tuple[str, float]:
    """Return the heading of the column of MOOBDs, and the sign with which they are printed.

    Where all cars left the lane, the column shows how far they were outside, as a positive number.
    """
    are_outside = {cluster.moobd < 0.0 for cluster in clusters if cluster.fault is None}
    if are_outside <= {True}:
        return ">outside (m)", -1.0
    noun = "MOOBD" if True in are_outside else "inside"
    return f">{noun} ({oob_unit(lane_width)})", 1.0


def print_causes(
    causes: Sequence[ExplainedCause],
    clusters: Clusters,
    counts: Counts,
    minimised: Mapping[int, Test],
) -> None:
    """Print a table of the causes of failures, and what their examples and trials show.

    Args:
        causes: the causes of the distinct failures.
        clusters: the distinct failures.
        counts: counts of the campaign; possibly with more failures than were compared.
        minimised: ID of a test -> drive on its minimised road.
    """
    if counts.broken_text:
        ResultsConsole().print(capitalised(counts.broken_text), style="bold", markup=False)
    if not clusters:
        return
    title = f"{counted(len(clusters.causes), 'cause')} of "
    if clusters.failures < counts.failures:  # not all were compared
        title += f"the {clusters.failures} most severe of "
    title += f"{counted(counts.failures, 'failure')}, {len(clusters)} of them distinct"
    if clusters.known:
        title += f", {clusters.known} known before"
    ResultsConsole().print(title, style="bold", markup=False)
    print_table(
        (">failures", ">distinct", "what the driver does", "how sure", ">example", "its road"),
        [
            (
                cause.group.failures,
                len(cause.group.clusters),
                cause.group.words,
                cause.certainty,
                f"test {cause.group.example}",
                _minimised_text(minimised.get(cause.group.example)),
            )
            for cause in causes
        ],
    )
    for cause in causes:
        if text := cause.as_text():
            line = f"Test {cause.group.example} {text}."
            echo(fill(line, ResultsConsole().width, subsequent_indent="  "))


def _minimised_text(minimised: Test | None) -> str | None:
    """Return the length of a minimised road in words; None without a minimised road."""
    return None if minimised is None else f"cut to {minimised.road.length:.0f} m"


def first_error(store: CampaignStore) -> str:
    """Return the reason of the first test in which the simulator broke; empty if there is none."""
    from frenetic.oracle.outcome import Outcome

    return "".join(test.reason for test in store.tests(Outcome.ERROR, limit=1))


def clusters_json(clusters: Clusters) -> list[dict[str, Any]]:
    """Return distinct failures, or near misses, as JSON objects."""
    return [
        {
            "most_severe": cluster.most_severe,
            "moobd": cluster.moobd,
            "description": cluster.description,
            "tests": list(cluster.ids),
            **({} if cluster.was_known is None else {"was_known": cluster.was_known}),
        }
        for cluster in clusters
    ]


def causes_json(
    causes: Sequence[ExplainedCause], minimised: Mapping[int, Test]
) -> list[dict[str, Any]]:
    """Return causes of failures as JSON objects.

    Args:
        causes: the causes.
        minimised: ID of a test -> drive on its minimised road.
    """
    lengths = {test_id: test.road.length for test_id, test in minimised.items()}
    return [
        {**cause.as_json(), "minimised_length": lengths.get(cause.group.example)}
        for cause in causes
    ]
