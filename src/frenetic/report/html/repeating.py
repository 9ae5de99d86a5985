"""A campaign's configuration, and the command that repeats it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from typing import Any, Final

from frenetic._support.json_value import JSONValue, plain
from frenetic._support.words import capitalised, part_word
from frenetic.errors import CampaignError
from frenetic.report.html.blocks import Block, Fact, Facts, Paragraph, Section, command
from frenetic.run_file import NAME
from frenetic.spec import Spec

_ORDERED: Final = (
    "Results were used in the order of the proposals, so the same seed gives the same campaign with"
    " any number of workers."
)


def repeat_section(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> Section:
    """The configuration, and how to repeat the campaign."""
    blocks: list[Block] = []
    if (line := repeat_command(config, facts)) is not None:
        blocks.append(command(line, "Repeats the campaign, in a new folder, from its own:"))
    blocks.append(Paragraph(repeatability(config, facts)))
    blocks += [
        Facts(tuple(_flat(config.get(name))), capitalised(name), folded=True)
        for name in ("strategy", "driver", "simulator", "rules", "car", "versions")
        if isinstance(config.get(name), Mapping)
    ]
    rest = {
        name: config.get(name)
        for name in (
            "map_size",
            "margin",
            "lane_width",
            "road_class",
            "workers",
            "cluster",
            "lookahead",
            "seed",
        )
    }
    blocks.append(Facts(tuple(_flat(rest)), "Map, lanes, workers", folded=True))
    return Section("configuration", "Configuration", tuple(blocks))


def repeat_command(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> str | None:
    """The command line that repeats a campaign, quoted for a POSIX shell.

    None if the campaign was started from Python, or does not record its command.
    """
    spec = _spec({**config, **{k: v for k, v in facts.items() if k == "budget"}})
    if spec is None:
        return None
    entrant = _generator(config)
    return f"frenetic run {NAME}" if entrant is None else shlex.join(_bench_words(entrant, spec))


def _spec(config: Mapping[str, JSONValue]) -> Spec | None:
    """The spec of the campaign; None if its parts have no names, or the record is damaged."""
    try:
        spec = Spec.from_json(config, source="")
    except CampaignError:
        return None
    return None if spec.driver.name is None else spec


def _generator(config: Mapping[str, JSONValue]) -> Mapping[str, Any] | None:
    """The generator of a bench's run; None for other campaigns."""
    entrant: Any = config.get("entrant")
    if not isinstance(entrant, Mapping) or entrant.get("is_strategy") is not False:
        return None
    is_whole = isinstance(entrant.get("spec"), str) and isinstance(entrant.get("budget"), Mapping)
    return entrant if is_whole else None


def _bench_words(entrant: Mapping[str, Any], spec: Spec) -> list[str]:
    """A command beside the file of the bench."""
    places = {
        name: entrant[name] for name in ("path", "copy", "pipeline", "python") if entrant.get(name)
    }
    generator = part_word(entrant["spec"], places)
    words = ["frenetic", "bench", "../../bench.toml", "--generator", generator]
    return [*words, "--repeats", "1", "--seed", str(spec.seed)]


def repeatability(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> str:
    """Whether the campaign repeats exactly, and if not, why."""
    budget = facts.get("budget", config.get("budget"))
    is_recorded = isinstance(config.get("command"), Mapping)
    told = {
        "The campaign was started from Python, so there is no command that repeats it; its parts"
        " and their options are listed below.": not is_recorded,
        "What is recorded of its command is damaged, so it cannot be shown.": is_recorded
        and repeat_command(config, facts) is None,
        _ORDERED: True,
        "The seed reaches the generator through Python's random and numpy's global generator: one"
        " that draws from elsewhere proposes other roads.": _generator(config) is not None,
        "No seed is recorded, so its random numbers cannot be drawn again.": config.get("seed")
        is None,
        "Its budget is of wall time, so how far it comes depends on the machine's speed.": (
            isinstance(budget, Mapping) and budget.get("time") is not None
        ),
        "To the last bit this holds on the same machine with the same versions, and for drivers and"
        " simulators that are repeatable themselves.": True,
    }
    return " ".join(sentence for sentence, is_so in told.items() if is_so)


def _flat(value: object, name: str = "") -> Iterator[Fact]:
    """The values in nested objects, each with the path to it."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    else:
        text = value if isinstance(value, str) else json.dumps(value, default=plain)
        yield Fact(name.removeprefix("options."), text)
