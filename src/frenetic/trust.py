"""Which code a file may name: what this user has run before, or names in the command.

A campaign, a road's file or a profile names its driver, simulator and strategy, and whoever made it
may be a stranger. Built-in parts and installed entry points are made unasked. Any other is made
only if the command names it, or if this user has run that very source before: its digest lies in
the file ``trusted`` of the user's own folder, `FOLDER`.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import sys
from collections.abc import Collection, Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from frenetic._support.words import part_word
from frenetic.errors import FreneticError
from frenetic.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES, Registry
from frenetic.versions import digest_of_file, sources_named

VARIABLE: Final = "FRENETIC_HOME"
"""Environment variable with another folder for what belongs to the user."""
REGISTRIES: Final[Mapping[str, Registry]] = {
    one.kind: one for one in (STRATEGIES, DRIVERS, SIMULATORS, OBJECTIVES)
}
NOT_DRIVING: Final = ("strategy", "objective")
"""Kinds of parts that driving a campaign's roads again does not make."""
_STARTING: Final = ("home", "user")
"""Options of a built-in simulator that name a program to start."""


def folder() -> Path:
    """The user's own folder."""
    if given := os.environ.get(VARIABLE):
        return Path(given)
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", "~")).expanduser() / "frenetic"
    if sys.platform == "darwin":
        return Path("~/Library/Application Support/frenetic").expanduser()
    return Path(os.environ.get("XDG_DATA_HOME") or "~/.local/share").expanduser() / "frenetic"


def remember(kind: str, name: str, options: Mapping[str, Any]) -> None:
    """Notes that the user has made a part; where that cannot be written, it will be asked again."""
    key = _key(kind, name, options)
    if not key or key in _known():
        return
    with suppress(OSError):
        path = folder() / "trusted"
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("a", encoding="utf-8") as file:
            file.write(f"{key} {kind} {json.dumps(name)}\n")


def require(
    parts: Mapping[str, tuple[str, Mapping[str, Any]]],
    source: object,
    named: Collection[str] = (),
    remedy: str = "if you trust it, name it yourself:",
    started_in: str = "",
) -> None:
    """Checks that recorded parts may be made.

    Args:
        parts: kind -> name and options.
        source: the file or folder that names them.
        named: kinds that the command names itself.
        remedy: what to do, before the words of a command line that name the part.
        started_in: the folder from which a campaign was started, if known.

    Raises:
        FreneticError: one may not.
    """
    known = _known()
    for kind, (name, options) in parts.items():
        if kind in named:
            continue
        key = _key(kind, name, options)
        if key is not None and key not in known:
            if started_in and _is_missing(name):
                raise FreneticError(
                    f"the {kind} {name!r} of {source} is not found here: go to the folder from"
                    f" which it was started, {started_in}"
                )
            starting = {
                option: options[option]
                for option in _STARTING
                if kind == "simulator" and option in options
            }
            words = [f"--{kind}", part_word(name, starting)]
            raise FreneticError(
                f"{source} names the {kind} {name!r}, code that you have not run as it is on this"
                f" computer: {remedy} {shlex.join(words)}"
            )


def _key(kind: str, name: str, options: Mapping[str, Any]) -> str | None:
    """Digest of the code that making a part runs; None for what is made unasked.

    Empty for code that cannot be read, which is never remembered.
    """
    registry = REGISTRIES.get(kind)
    if registry is None:  # a bench's generator: its options are its source
        return _digest([name, dict(options)]) if all(options.values()) else ""
    started = {k: str(options[k]) for k in _STARTING if kind == "simulator" and k in options}
    place = name.rpartition(":")[0] or name
    code: object = place
    try:
        if name in {entry.name for entry in registry.entries()}:
            code = None
        elif Path(place).suffix.lower() in registry.files:
            code = digest_of_file(Path(place))
        elif sources := sources_named(name):
            code = sources
    except (OSError, ValueError, RuntimeError):
        return ""
    return _digest([code, started]) if code or started else None


def _is_missing(name: str) -> bool:
    """Whether a file or module is not where a name says; nothing is imported."""
    place, separator, _ = name.rpartition(":")
    if separator and not place.endswith(".py"):
        return not sources_named(name) and find_spec(place.partition(".")[0]) is None
    return not Path(place or name).expanduser().is_file()


def _digest(what: Any) -> str:
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


def _known() -> frozenset[str]:
    try:
        text = (folder() / "trusted").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return frozenset()
    return frozenset(line.partition(" ")[0] for line in text.splitlines())
