"""A campaign's configuration, and the command that repeats it."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from typing import Any, Final

from frenetic.campaign.configuration import BUDGET, command_faults
from frenetic.campaign.store import JSONValue
from frenetic.report.html.blocks import Block, Command, Fact, Facts, Paragraph, Section

_NUMBERS: Final = ("noise", "delay", "view", "speed_limit", "oob_tolerance", "wall_limit")


def repeat_section(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> Section:
    """The configuration, and how to repeat the campaign."""
    blocks: list[Block] = []
    command = repeat_command(config, facts)
    if command is not None:
        blocks.append(Command(command, "Repeats the campaign, in a new folder:"))
    blocks.append(Paragraph(repeatability(config, facts)))
    blocks += [
        Facts(tuple(_flat(config.get(name))), title, folded=True)
        for name, title in (
            ("strategy", "Strategy"),
            ("driver", "Driver"),
            ("simulator", "Simulator"),
            ("rules", "Rules"),
            ("car", "Car"),
            ("versions", "Versions"),
        )
        if isinstance(config.get(name), Mapping)
    ]
    rest = {
        name: config.get(name)
        for name in ("map_size", "margin", "lane_width", "workers", "cluster", "lookahead", "seed")
    }
    blocks.append(Facts(tuple(_flat(rest)), "Map, lanes, workers", folded=True))
    return Section("configuration", "Configuration", tuple(blocks))


def repeat_command(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> str | None:
    """The command line that repeats a campaign, quoted for a POSIX shell.

    None if the campaign was started from Python, or does not record its command.
    """
    command = _command(config)
    budget: Any = facts.get("budget", config.get("budget"))
    if command is None or BUDGET(budget):
        return None
    if (entrant := _generator(config)) is not None:
        return shlex.join(_bench_words(entrant, command, config))
    words = ["frenetic", "run"]
    for name in ("simulations", "time", "failures"):
        if budget[name] is not None:
            words += [f"--{name}", _number(budget[name])]
    words += _part_words(command, "strategy")
    words += drive_words(command, config.get("map_size"))
    lookahead = config.get("lookahead")
    words += ["--unordered"] if lookahead is None else ["--ordered", "--lookahead", str(lookahead)]
    if isinstance(config.get("cluster"), str):
        words += ["--cluster", str(config["cluster"])]
    elif isinstance(config.get("workers"), int):
        words += ["--workers", str(config["workers"])]
    if config.get("seed") is not None:
        words += ["--seed", str(config["seed"])]
    return shlex.join(words)


def drive_options(config: Mapping[str, JSONValue]) -> str | None:
    """The options of `frenetic drive` that drive a campaign's roads as they were driven.

    None if the campaign was started from Python, or does not record its command.
    """
    command = _command(config)
    return None if command is None else shlex.join(drive_words(command, config.get("map_size")))


def _command(config: Mapping[str, JSONValue]) -> Mapping[str, Any] | None:
    command: Any = config.get("command")
    return command if isinstance(command, Mapping) and not command_faults(config) else None


def _generator(config: Mapping[str, JSONValue]) -> Mapping[str, Any] | None:
    """The generator of a bench's run; None for other campaigns."""
    entrant: Any = config.get("entrant")
    if not isinstance(entrant, Mapping) or entrant.get("is_strategy") is not False:
        return None
    is_whole = isinstance(entrant.get("spec"), str) and isinstance(entrant.get("budget"), Mapping)
    return entrant if is_whole else None


def _bench_words(
    entrant: Mapping[str, Any], command: Mapping[str, Any], config: Mapping[str, JSONValue]
) -> list[str]:
    words = ["frenetic", "bench", "--generator", entrant["spec"]]
    for name in ("path", "python"):
        words += [f"--{name}", str(entrant[name])] if entrant.get(name) else []
    for name, value in entrant["budget"].items():
        words += [f"--{name.replace('_', '-')}", _number(value)]
    words += ["--repeats", "1", "--seed", str(config.get("seed"))]
    return words + drive_words(command, config.get("map_size"))


def drive_words(command: Mapping[str, Any], map_size: object) -> list[str]:
    """The options of a command line that choose driver, simulator, rules and map."""
    words = [*_part_words(command, "driver"), *_part_words(command, "simulator")]
    for name in _NUMBERS:
        if command.get(name) is not None:
            words += [f"--{name.replace('_', '-')}", _number(command[name])]
    return [*words, "--map-size", _number(map_size)]


def _part_words(command: Mapping[str, Any], part: str) -> list[str]:
    words = [f"--{part}", command[part]]
    for name, value in command[f"{part}_options"].items():
        words += [f"--{part}-option", f"{name}={_setting(value)}"]
    return words


def repeatability(config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]) -> str:
    """Whether the campaign repeats exactly, and if not, why."""
    sentences = []
    if not isinstance(config.get("command"), Mapping):
        sentences.append(
            "The campaign was started from Python, so there is no command that repeats it; its"
            " parts and their options are listed below."
        )
    elif repeat_command(config, facts) is None:
        sentences.append("What is recorded of its command is damaged, so it cannot be shown.")
    many = config.get("cluster") is not None or config.get("workers", 1) != 1
    if config.get("lookahead") is not None:
        sentences.append(
            "Results were used in the order of the proposals, so the same seed gives the same"
            " campaign with any number of workers."
        )
    elif many:
        sentences.append(
            "Several workers drove, and results were used as they came, so it is not exactly"
            " repeatable: another run proposes other roads. With --ordered it would be."
        )
    else:
        sentences.append("One worker drove, so the same seed gives the same campaign.")
    if _generator(config) is not None:
        sentences.append(
            "The seed reaches the generator through Python's random and numpy's global generator:"
            " one that draws from elsewhere proposes other roads."
        )
    if config.get("seed") is None:
        sentences.append("No seed is recorded, so its random numbers cannot be drawn again.")
    budget = facts.get("budget", config.get("budget"))
    if isinstance(budget, Mapping) and budget.get("time") is not None:
        sentences.append(
            "Its budget is of wall time, so how far it comes depends on the machine's speed."
        )
    sentences.append(
        "To the last bit this holds on the same machine with the same versions, and for drivers and"
        " simulators that are repeatable themselves."
    )
    return " ".join(sentences)


def _setting(value: object) -> str:
    """An option's value for the command line: JSON, or else a text."""
    if isinstance(value, str):
        try:
            json.loads(value)
        except ValueError:
            try:
                float(value)
            except ValueError:
                return value
        return json.dumps(value)
    return json.dumps(value, default=_plain)


def _plain(value: object) -> object:
    return dict(value) if isinstance(value, Mapping) else list(value)  # type: ignore[call-overload]


def _number(value: object) -> str:
    return str(value).removesuffix(".0")


def _flat(value: object, name: str = "") -> Iterator[Fact]:
    """The values in nested objects, each with the path to it."""
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    else:
        text = value if isinstance(value, str) else json.dumps(value, default=_plain)
        yield Fact(name.removeprefix("options."), text)
