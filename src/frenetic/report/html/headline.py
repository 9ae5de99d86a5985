"""The search and its results at a glance."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from types import MappingProxyType
from typing import Any

from frenetic._support.json_value import JSONValue
from frenetic._support.words import capitalised, counted, format_duration, rate_words, signed
from frenetic.analysis.failures import Clusters
from frenetic.campaign.asking import FACTS
from frenetic.campaign.counts import Counts
from frenetic.campaign.objective import in_words
from frenetic.campaign.summary import facts_in_words
from frenetic.quantities import quantities
from frenetic.registry import part_name
from frenetic.report.html.blocks import Fact, Headline, Tile, percent
from frenetic.spec import earlier_of
from frenetic.versions import innermost, short_version


def headline(
    config: Mapping[str, JSONValue],
    facts: Mapping[str, JSONValue],
    counts: Counts,
    clusters: Clusters,
    *,
    folder: str,
    elapsed: float,
    is_spent: bool = False,
    known: str = "",
    objectives: Mapping[int, float] = MappingProxyType({}),
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
        is_spent: whether its budget is.
        objectives: value of the objective by test, if it is not the MOOBD.
        known: what became of the failures of earlier campaigns.
        trouble: other warnings for the reader.
    """
    failures, tests = counts.failed, counts.tests
    seconds: Any = facts.get("seconds")
    notice = f"{capitalised(said)}." if (said := str(facts.get("notice", ""))) else ""
    duration = float(seconds) if isinstance(seconds, int | float) else elapsed
    strategy, driver, simulator = (
        _named(config, part) for part in ("strategy", "driver", "simulator")
    )
    seed = config.get("seed")
    lead = (
        f"{strategy} searched for roads on which {driver} leaves its lane in {simulator},"
        f" seed {'unknown' if seed is None else seed}."
    )
    most = f"among the {clusters.failures} most severe" if clusters.failures < failures else ""
    start_from = earlier_of(config)
    before = f"{clusters.known} known before" if start_from else ""
    share = f"{percent(failures / counts.simulations)} of simulations" if counts.simulations else ""
    rate = rate_words(tests / duration) if tests and duration > 0.0 else ""
    least, version = counts.min_moobd, short_version(innermost(config.get("driver")))
    tiles = [
        Tile("simulations", str(counts.simulations), rate),
        Tile("failures", str(failures), share, "fail" if failures else None),
        Tile(
            "distinct failures",
            str(len(clusters)),
            ", ".join(text for text in (before, most) if text),
            "fail" if len(clusters) else None,
        ),
        Tile("lowest MOOBD", "–" if least is None else f"{signed(least)} m"),
        Tile(
            "invalid roads",
            str(counts.invalid),
            f"{percent(counts.invalid / tests)} of tests" if tests else "",
        ),
        Tile("errors", str(counts.errors), "", "error" if counts.errors else None),
    ]
    if counts.dropped:
        tiles.append(Tile("dropped", str(counts.dropped), "before they were driven"))
    tiles.append(
        Tile("wall time", format_duration(duration), "min:s" if duration < 3600.0 else "h:min:s")
    )
    return Headline(
        title=_title(clusters, counts),
        lead=lead,
        warning=" ".join(text for text in (_unfinished(facts, is_spent), notice, trouble) if text),
        tiles=tuple(tiles),
        facts=(
            Fact("campaign", folder),
            Fact("budget", _budget(config, facts) or "–"),
            Fact("objective", in_words(config, objectives)),
            *(Fact("starts from", str(one)) for one in start_from),
            Fact("results", counts.in_words()),
            *([Fact("known before", known)] if known else []),
            *([Fact("search", told)] if (told := facts_in_words(facts.get(FACTS))) else []),
            *([Fact("driver", f"{driver}, {version}")] if version else []),
            Fact("begun", _when(facts.get("created_at"))),
            Fact("finished", _when(facts.get("finished_at"))),
            Fact("versions", _versions(config)),
        ),
    )


def _title(clusters: Clusters, counts: Counts) -> str:
    if counts.errors and not counts.failed:
        return counts.broken
    found = counted(len(clusters), "distinct failure") if counts.failed else "No failure"
    if clusters.failures < counts.failed:
        found = f"At least {found}"
    broken = f"; {counts.broken}" if counts.errors else ""
    return f"{found} in {counted(counts.simulations, 'simulation')}{broken}"


def _named(config: Mapping[str, JSONValue], part: str) -> str:
    """Name of a part on the command line, or its class, with its layers."""
    command = config.get("command")
    if isinstance(command, Mapping) and isinstance(command.get(part), str):
        text = str(command[part])
        if part == "driver":
            amounts, rows = command.get("layers"), quantities()
            layers = [
                rows[name].text(amount) if name in rows else f"{name} {amount}"
                for name, amount in (amounts.items() if isinstance(amounts, Mapping) else ())
                if isinstance(amount, int | float)
            ]
            text += f" with {', '.join(layers)}" if layers else ""
        return text
    described = config.get(part)
    if not isinstance(described, Mapping):
        return f"an unknown {part}"
    name = part_name(described)
    return f"{name} over {_named(described, 'driver')}" if "driver" in described else name


def _budget(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> str:
    budget = facts.get("budget", config.get("budget"))
    limits = budget if isinstance(budget, Mapping) else {}
    texts = [
        f"{format_duration(value)} of time" if name == "time" else f"{value} {name}"
        for name, value in limits.items()
        if isinstance(value, int | float)
    ]
    return ", ".join(texts)


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


def _versions(config: Mapping[str, JSONValue]) -> str:
    versions = config.get("versions")
    if not isinstance(versions, Mapping):
        return "–"
    return ", ".join(f"{name} {version}" for name, version in versions.items())
