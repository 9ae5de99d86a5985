"""The search and its results at a glance."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic._support.words import capitalised, counted, format_duration, rate_words, signed
from frenetic.analysis.failures import Clusters
from frenetic.campaign.asking import FACTS
from frenetic.campaign.counts import Counts
from frenetic.campaign.objective import in_words
from frenetic.campaign.repeat import not_repeatable
from frenetic.campaign.summary import facts_in_words
from frenetic.report.html.blocks import Fact, Headline, Tile, percent
from frenetic.spec import Budget, decode_budget, earlier_of, part_text
from frenetic.versions import innermost, short_version

_LATE: Final = 0.8
"""Share of the tests behind which failures are late: many late ones, and more drives find more."""


def headline(
    config: Mapping[str, JSONValue],
    facts: Mapping[str, JSONValue],
    counts: Counts,
    clusters: Clusters,
    *,
    folder: str,
    elapsed: float,
    roads: str = "",
    domain: str = "",
    criteria: str = "",
    known: str = "",
    objectives: Mapping[int, float] = MappingProxyType({}),
    caution: str = "",
    trouble: str = "",
) -> Headline:
    """The headline of a campaign.

    Args:
        config: of the campaign.
        facts: likewise.
        counts: likewise.
        clusters: its distinct failures.
        folder: of the campaign.
        elapsed: s of its spent time.
        known: what became of the failures of earlier campaigns.
        roads: their class, in words.
        domain: what conditions were searched, in words.
        criteria: what fails beside leaving the lane, in words.
        objectives: value of the objective by test, if it is not the MOOBD.
        caution: what the counts alone may lead to believe wrongly.
        trouble: other warnings for the reader.
    """
    failures, tests = counts.failed, counts.tests
    seconds: Any = facts.get("seconds")
    duration = float(seconds) if isinstance(seconds, int | float) else elapsed
    strategy, driver, simulator = (
        part_text(config.get(part)) for part in ("strategy", "driver", "simulator")
    )
    start_from, seed = earlier_of(config), config.get("seed")
    notes = [f"{clusters.known} known before"] if start_from else []
    late = sum(one.ids[0] > _LATE * tests for one in clusters)
    notes += [f"{late} of them first seen in the last fifth"] if len(clusters) else []
    if clusters.failures < failures:
        notes.append(f"among the {clusters.failures} most severe")
    share = f"{percent(failures / counts.simulations)} of simulations" if counts.simulations else ""
    least, invalid = counts.min_moobd, counts.invalid
    tiles = [
        Tile(
            "simulations",
            str(counts.simulations),
            rate_words(tests / duration) if tests and duration > 0.0 else "",
        ),
        Tile("failures", str(failures), share, "fail" if failures else None),
        Tile(
            "distinct failures",
            str(len(clusters)),
            ", ".join(notes),
            "fail" if len(clusters) else None,
        ),
        Tile("causes", str(len(clusters.causes)), "", "fail" if len(clusters) else None),
    ]
    if least is not None:
        where = "furthest outside the lane" if least < 0.0 else "nearest to the lane's edge"
        tiles.append(Tile(where, f"{abs(least):.2f} m", f"MOOBD {signed(least)} m"))
    if invalid:
        tiles.append(Tile("invalid roads", str(invalid), f"{percent(invalid / tests)} of tests"))
    if counts.errors:
        tiles.append(Tile("errors", str(counts.errors), "", "error"))
    if counts.dropped:
        tiles.append(Tile("dropped", str(counts.dropped), "before they were driven"))
    tiles.append(
        Tile("wall time", format_duration(duration), "min:s" if duration < 3600.0 else "h:min:s")
    )
    budget = _budget(config, facts)
    is_spent = budget is not None and budget.spent(counts.simulations, elapsed, failures) >= 1.0
    said = not_repeatable(facts), str(facts.get("notice", "")), caution
    sentences = (f"{capitalised(text)}." for text in said if text)
    warnings = _unfinished(facts, is_spent), *sentences, trouble
    version, versions = short_version(innermost(config.get("driver"))), config.get("versions")
    own = versions.items() if isinstance(versions, Mapping) else ()
    told = {
        "campaign": folder,
        "roads": roads,
        "domain": domain,
        "criteria": criteria,
        "budget": _limits(budget),
        "objective": in_words(config, objectives),
        "starts from": "; ".join(map(str, start_from)),
        "results": counts.in_words(),
        "known before": known,
        "search": facts_in_words(facts.get(FACTS)),
        "driver": f"{driver}, {version}" if version else "",
        "begun": _when(facts.get("created_at")),
        "finished": _when(facts.get("finished_at")),
        "versions": ", ".join(f"{name} {number}" for name, number in own) or "–",
    }
    return Headline(
        title=_title(clusters, counts),
        lead=f"{strategy} searched for roads on which {driver} leaves its lane"
        f"{' or breaks another criterion' if criteria else ''} in {simulator},"
        f" seed {'unknown' if seed is None else seed}.",
        warning=" ".join(filter(None, warnings)),
        tiles=tuple(tiles),
        facts=tuple(Fact(name, value) for name, value in told.items() if value),
    )


def _title(clusters: Clusters, counts: Counts) -> str:
    if counts.errors and not counts.failed:
        return counts.broken
    found = "No failure"
    if counts.failed:
        distinct = counted(len(clusters), "distinct failure")
        least = "at least " if clusters.failures < counts.failed else ""
        found = f"{counted(len(clusters.causes), 'cause')} of {least}{distinct}"
    broken = f"; {counts.broken}" if counts.errors else ""
    return f"{found} in {counted(counts.simulations, 'simulation')}{broken}"


def _budget(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> Budget | None:
    """The campaign's last budget; None without a usable one."""
    try:
        return decode_budget(facts.get("budget", config.get("budget")))
    except ValueError:
        return None


def _limits(budget: Budget | None) -> str:
    if budget is None:
        return "–"
    time = None if budget.time is None else f"{format_duration(budget.time)} of time"
    counts = [(budget.simulations, "simulations"), (budget.failures, "failures")]
    texts = [f"{number} {name}" for number, name in counts if number is not None]
    return ", ".join([*texts, *([time] if time else [])])


def _unfinished(facts: Mapping[str, JSONValue], is_spent: bool) -> str:
    if facts.get("interrupted"):
        return "Interrupted before its budget was spent; 'frenetic resume' goes on."
    if "finished_at" in facts:
        return ""
    if is_spent:
        return "Killed after its last result, so that all results are here."
    return "Not finished: the campaign was still running, or was killed."


def _when(value: object) -> str:
    try:
        return f"{datetime.fromisoformat(str(value)):%Y-%m-%d %H:%M} UTC"
    except ValueError:
        return "–"
