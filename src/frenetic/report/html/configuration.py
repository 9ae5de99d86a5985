"""Section of a page: the configuration of a campaign."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from frenetic._support.json_value import JSONValue, plain
from frenetic._support.words import capitalised
from frenetic.campaign.configuration import OWNER, SPEC
from frenetic.report.html.page import Facts, Paragraph, Section, command
from frenetic.spec import SPEC_FILE


def configuration_section(
    folder: Path, config: Mapping[str, JSONValue], facts: Mapping[str, JSONValue]
) -> Section:
    """Return the section with a campaign's configuration and the command that repeats it.

    Args:
        folder: folder of the campaign.
        config: configuration of the campaign.
        facts: facts of the campaign, which may hold a later budget.
    """
    entries = {**config, "budget": facts.get("budget", config.get("budget"))}
    groups = {name: value for name, value in entries.items() if isinstance(value, Mapping)}
    others = {name: value for name, value in entries.items() if name not in groups}
    repeatability = Paragraph(_repeatability(entries))
    repeating = command(
        f"frenetic run {shell_path(folder / SPEC_FILE)}", "Repeats it, in a new folder:"
    )
    is_named = isinstance(config.get(SPEC), Mapping) and config.get(OWNER) is None
    return Section(
        "configuration",
        "Configuration",
        (
            *([repeating] if is_named else []),
            repeatability,
            *(
                Facts(dict(_flat(value)), capitalised(name), folded=True)
                for name, value in [*groups.items(), ("others", others)]
            ),
        ),
    )


def _repeatability(config: Mapping[str, Any]) -> str:
    """Return a text about whether the campaign repeats exactly, and if not, why."""
    text = "The same seed gives the same campaign, on the same machine with the same versions."
    budget = config["budget"]
    if isinstance(budget, Mapping) and budget.get("time") is not None:
        text += " Its budget is wall time, so the number of tests depends on the machine's speed."
    if not isinstance(config.get(SPEC), Mapping):
        text += " It was started from Python, so there is no command that repeats it."
    return text


def _flat(value: object, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield the path and the text of each entry in nested objects, without empty values.

    Args:
        value: an object or a value in it.
        name: path of the value, with dots.
    """
    if isinstance(value, Mapping) and value:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key))
    elif value not in (None, "", [], {}):
        text = value if isinstance(value, str) else json.dumps(value, default=plain)
        yield name.removeprefix("options."), text


def shell_path(path: Path) -> str:
    """Return a path as text for pasting into a shell."""
    text = str(path).encode("utf-8", "replace").decode()  # some names have no encoding
    return f'"{text}"' if sys.platform == "win32" else shlex.quote(text)
