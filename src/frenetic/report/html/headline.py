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
from frenetic.analysis.failure_stability import FailureStability
from frenetic.campaign.advice import how_to_resume
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
from frenetic.report.html.page import DataBlock, Tile, percent
from frenetic.rerun.campaigns import purpose_of
from frenetic.rerun.estimate import FailureRate
from frenetic.spec.part_text import recorded_part

_LATE_SHARE: Final = 0.8
"""Share of the candidates after which a distinct failure is seen late; our choice.

Many late failures mean that more drives would find more.
"""
_LATE_TEXT: Final = "first seen in the last fifth"
"""What the report says of late failures; its fraction is 1 - `_LATE_SHARE`."""


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
    warnings = [f"{capitalised(warning)}." for warning in _warnings(store)]
    return DataBlock(
        "headline",
        {
            "lead": _lead(store),
            "warning": " ".join([*warnings, trouble]),
            "tiles": list(_tiles(store, clusters, counts)),
            "facts": {label: text for label, text in _labelled_texts(store) if text},
        },
    )


def _lead(store: CampaignStore) -> str:
    """Return what drove where, and what for."""
    driver = recorded_part(store.config, "driver")
    simulator = recorded_part(store.config, "simulator")
    if purpose_of(store):
        return f"{driver} was measured in {simulator}: these drives are no search."
    strategy = recorded_part(store.config, "strategy")
    seed = store.config.get("seed")
    or_criterion = " or exceeds another criterion" if criteria_text(store) else ""
    return (
        f"{strategy} searched for roads on which {driver} leaves its lane{or_criterion}"
        f" in {simulator}, seed {'unknown' if seed is None else seed}."
    )


def _warnings(store: CampaignStore) -> Iterator[str]:
    """Yield warnings about a campaign: its early end first, then what limits its results."""
    facts = store.facts
    if facts.get("interrupted"):
        yield f"interrupted before its budget was spent; go on: {how_to_resume(store)}"
    elif "finished_at" not in facts:
        yield (
            "not finished: the campaign was still running, or was killed; if it was killed, go on:"
            f" {how_to_resume(store)}"
        )
    for warning in (not_repeatable(facts), str(facts.get("notice", "")), caution(store)):
        if warning:
            yield warning


def _labelled_texts(store: CampaignStore) -> Iterator[tuple[str, str]]:
    """Yield what was searched, with what and how: labels and texts, some of which are empty."""
    road_class, domain = store.setting.road_class, store.setting.domain
    failure_rate = None if domain is None else FailureRate.read(store.folder)
    driver = recorded_part(store.config, "driver")
    version = short_version(innermost(store.config.get("driver")))
    yield "campaign", str(store.folder)
    yield "roads", "" if road_class is None else road_class.as_text()
    yield "domain", "" if domain is None else domain.as_text()
    yield "conditions", as_text(store.setting.conditions)
    yield "how often it fails", "" if failure_rate is None else failure_rate.as_text()
    yield "criteria", criteria_text(store)
    yield "objective", objective_text(store)
    yield "starts from", "; ".join(map(str, earlier_of(store.config)))
    yield "known before", still_failing(store)
    stability = FailureStability.read(store.facts)
    yield "stability", "" if stability is None else stability.as_text()
    yield "search", facts_text(store.fact(SEARCH_FACTS))
    yield "driver", f"{driver}, {version}" if version else ""
    yield "finished", _date_and_time(store.fact("finished_at"))


def _tiles(store: CampaignStore, clusters: Clusters, counts: Counts) -> Iterator[Tile]:
    """Yield the numbers of the headline."""
    failures, min_moobd = counts.failures, counts.min_moobd
    seconds: Any = store.facts.get("seconds", store.elapsed())
    rate = rate_words(counts.tests / seconds) if counts.tests and seconds > 0.0 else ""
    yield Tile("simulations", str(counts.simulations), rate)
    note = f"{percent(failures / counts.simulations)} of simulations" if failures else ""
    if counts.failing_repeats:
        note += f", and {counted(counts.failing_repeats, 'repeat')}"
    yield Tile("failures", str(failures), note, role="fail" if failures else "")
    role = "fail" if len(clusters) else ""
    note = _distinct_note(store, clusters, counts)
    yield Tile("distinct failures", str(len(clusters)), note, role)
    yield Tile("causes", str(len(clusters.causes)), role=role)
    if min_moobd is not None:
        is_outside = min_moobd < 0.0
        name = "furthest outside" if is_outside else "nearest to the lane's edge"
        inside = oob_words(min_moobd, store.lane_width)
        value = f"{-min_moobd:.2f} m" if is_outside else inside
        yield Tile(name, value, f"MOOBD {signed(min_moobd)} m")
    if counts.invalid:
        note = f"{percent(counts.invalid / counts.tests)} of tests"
        yield Tile("invalid roads", str(counts.invalid), note)
    if counts.errors:
        yield Tile("errors", str(counts.errors), role="error")
    if counts.dropped:
        yield Tile("dropped", str(counts.dropped), "before they were driven")
    unit = "min:s" if seconds < 3600.0 else "h:min:s"
    yield Tile("wall time", format_duration(seconds), unit)


def _distinct_note(store: CampaignStore, clusters: Clusters, counts: Counts) -> str:
    """Return how many distinct failures are known or late, and whether failures are left out."""
    notes = [f"{clusters.known} known before"] if earlier_of(store.config) else []
    if len(clusters):
        # Candidates have ids from 1, also those that are dropped.
        last_early_id = _LATE_SHARE * counts.result_count
        first_ids = [cluster.ids[0] for cluster in clusters]
        late = sum(first_id > last_early_id for first_id in first_ids)
        notes.append(f"{late} of them {_LATE_TEXT}")
    if clusters.failures < counts.failures:
        notes.append(f"among the {clusters.failures} most severe")
    return ", ".join(notes)


def _date_and_time(value: object) -> str:
    """Return a time of ISO 8601 for people; empty for other values."""
    try:
        return f"{datetime.fromisoformat(str(value)):%Y-%m-%d %H:%M} UTC"
    except ValueError:
        return ""
