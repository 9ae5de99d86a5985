"""The headline of a campaign's report: title, numbers, facts and warnings."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Any, Final

from frenetic._support.words import (
    capitalised,
    counted,
    format_duration,
    oob_words,
    rate_words,
    signed,
)
from frenetic.analysis.caution import caution
from frenetic.analysis.clusters import Clusters
from frenetic.analysis.criteria import criteria_text
from frenetic.campaign.advice import resume_command
from frenetic.campaign.configuration import earlier_of
from frenetic.campaign.counts import Counts
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.campaign.objective_values import objective_text
from frenetic.campaign.second_drive import not_repeatable
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import facts_text
from frenetic.campaign.warm_start import still_failing
from frenetic.conditions.condition import as_text
from frenetic.parts.records import innermost, short_version
from frenetic.report.html.page import DataBlock, percent
from frenetic.rerun.estimate import FailureRate
from frenetic.spec.part_text import recorded_part
from frenetic.spec.parts import PARTS

_LATE_SHARE: Final = 0.8
"""Share of the tests after which failures are late; our choice.

Many late failures mean that more drives would find more.
"""


def title_of(clusters: Clusters, counts: Counts) -> str:
    """Return the title of a campaign's report: what it found in how many simulations."""
    if counts.errors and not counts.failed:
        return capitalised(counts.broken_text)
    text = "No failure"
    if counts.failed:
        distinct = counted(len(clusters), "distinct failure")
        least = "at least " if clusters.failures < counts.failures else ""
        text = f"{counted(len(clusters.causes), 'cause')} of {least}{distinct}"
    simulations = counted(counts.simulations, "simulation")
    broken_text = f"; {counts.broken_text}" if counts.errors else ""
    return f"{text} in {simulations}{broken_text}"


def headline(
    store: CampaignStore, clusters: Clusters, counts: Counts, trouble: str = ""
) -> DataBlock:
    """Return the block with the search and its results at a glance.

    Args:
        store: the campaign.
        clusters: the distinct failures.
        counts: counts of the tests.
        trouble: a further warning for the reader; empty without one.
    """
    config, facts = store.config, store.facts
    strategy, driver, simulator = (recorded_part(config, kind) for kind in PARTS)
    criteria, seed = criteria_text(store), config.get("seed")
    warnings = [not_repeatable(facts), str(facts.get("notice", "")), caution(store)]
    if facts.get("interrupted"):
        warnings.insert(
            0, f"interrupted before its budget was spent; go on: {resume_command(store)}"
        )
    elif "finished_at" not in facts:
        killed = f"if it was killed, go on: {resume_command(store)}"
        warnings.insert(0, f"not finished: the campaign was still running, or was killed; {killed}")
    road_class, domain = store.setting.road_class, store.setting.domain
    estimate = None if domain is None else FailureRate.read(store.folder)
    version = short_version(innermost(config.get("driver")))
    facts_shown = {
        "campaign": str(store.folder),
        "roads": "" if road_class is None else road_class.as_text(),
        "domain": "" if domain is None else domain.as_text(),
        "conditions": as_text(store.setting.conditions),
        "how often it fails": "" if estimate is None else estimate.as_text(),
        "criteria": criteria,
        "objective": objective_text(store),
        "starts from": "; ".join(map(str, earlier_of(config))),
        "known before": still_failing(store),
        "search": facts_text(facts.get(SEARCH_FACTS)),
        "driver": f"{driver}, {version}" if version else "",
        "finished": _date_and_time(facts.get("finished_at")),
    }
    return DataBlock(
        "headline",
        {
            "lead": f"{strategy} searched for roads on which {driver} leaves its lane"
            f"{' or exceeds another criterion' if criteria else ''} in {simulator},"
            f" seed {'unknown' if seed is None else seed}.",
            "warning": " ".join(
                [*(f"{capitalised(warning)}." for warning in warnings if warning), trouble]
            ),
            "tiles": list(_tiles(store, clusters, counts)),
            "facts": {name: value for name, value in facts_shown.items() if value},
        },
    )


def _tiles(
    store: CampaignStore, clusters: Clusters, counts: Counts
) -> Iterator[tuple[str, str, str, str]]:
    """Yield headline numbers: name, value, note, and the role of the colour or an empty text."""
    failures, tests, min_moobd = counts.failures, counts.tests, counts.min_moobd
    seconds: Any = store.facts.get("seconds", store.elapsed())
    rate = rate_words(tests / seconds) if tests and seconds > 0.0 else ""
    yield "simulations", str(counts.simulations), rate, ""
    note = f"{percent(failures / counts.simulations)} of simulations" if failures else ""
    if counts.failing_repeats:
        note += f", and {counted(counts.failing_repeats, 'repeat')}"
    yield "failures", str(failures), note, "fail" if failures else ""
    notes = [f"{clusters.known} known before"] if earlier_of(store.config) else []
    if len(clusters):
        late = sum(cluster.ids[0] > _LATE_SHARE * tests for cluster in clusters)
        notes.append(f"{late} of them first seen in the last fifth")
    if clusters.failures < failures:
        notes.append(f"among the {clusters.failures} most severe")
    role = "fail" if len(clusters) else ""
    yield "distinct failures", str(len(clusters)), ", ".join(notes), role
    yield "causes", str(len(clusters.causes)), "", role
    if min_moobd is not None:
        is_outside = min_moobd < 0.0
        name = "furthest outside" if is_outside else "nearest to the lane's edge"
        inside = oob_words(min_moobd, store.lane_width)
        value = f"{-min_moobd:.2f} m" if is_outside else inside
        yield name, value, f"MOOBD {signed(min_moobd)} m", ""
    if counts.invalid:
        note = f"{percent(counts.invalid / tests)} of tests"
        yield "invalid roads", str(counts.invalid), note, ""
    if counts.errors:
        yield "errors", str(counts.errors), "", "error"
    if counts.dropped:
        yield "dropped", str(counts.dropped), "before they were driven", ""
    yield "wall time", format_duration(seconds), "min:s" if seconds < 3600.0 else "h:min:s", ""


def _date_and_time(value: object) -> str:
    """Return a time of ISO 8601 for people; empty for other values."""
    try:
        return f"{datetime.fromisoformat(str(value)):%Y-%m-%d %H:%M} UTC"
    except ValueError:
        return ""
