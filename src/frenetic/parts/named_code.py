"""Code that a file of the user's names: parts outside Frenetic, programs and files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from typing import Any, Final, TypeAlias

from frenetic._support.option_text import PROGRAM
from frenetic.parts.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES, Registry

Parts: TypeAlias = Mapping[str, tuple[str, Mapping[str, Any]]]
"""Kind of a part -> its name and options.

The kinds are the keys of `REGISTRIES`, ``generator`` for the road generator of a bench, and
``workers`` for the address of a cluster's scheduler. A number tells parts of one kind apart, as in
``strategy 2``.
"""
REGISTRIES: Final[Mapping[str, Registry]] = {
    registry.kind: registry for registry in (STRATEGIES, DRIVERS, SIMULATORS, OBJECTIVES)
}
"""Kind of a part -> registry of such parts."""
NOT_DRIVING: Final = ("strategy", "objective", "workers")
"""Kinds of parts that reruns of a campaign's roads do not make."""
_PROGRAM_OPTIONS: Final = frozenset({"home", "user", "python", "copy", "pipeline", "path", PROGRAM})
"""Options that name a program to start, or a folder of code, whatever their value looks like."""
_TEXT_OPTIONS: Final = frozenset({"host"})
"""Options whose values look like names of files but are not: names of computers have dots."""
_FILE_NAME: Final = re.compile(r"[/\\]|^[.~]|\.[A-Za-z]\w*$")
"""Pattern of a path, or of the name of a file such as ``net.onnx``."""


def named_code(parts: Parts) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return the parts that name code: kind -> name and the options that count.

    A part that is neither built in nor installed by an entry point names code, and all its options
    count. Another part names code only if an option is a program or a file; such options count.
    """
    code = {}
    for kind, (name, options) in parts.items():
        registry = REGISTRIES.get(without_number(kind))
        is_known = registry is not None and name in {entry.name for entry in registry.entries()}
        counting = {
            option: value
            for option, value in options.items()
            if not is_known or _starts_code(option, value)
        }
        if counting or not is_known:
            code[kind] = name, counting
    return code


def without_number(kind: str) -> str:
    """Return the kind of a part without the number of the part: ``strategy`` for ``strategy 2``."""
    return kind.partition(" ")[0]


def _starts_code(option: str, value: object) -> bool:
    """Return whether an option names a program or a file."""
    if option in _PROGRAM_OPTIONS:
        return value is not None
    return option not in _TEXT_OPTIONS and names_file(value)


def names_file(value: object) -> bool:
    """Return whether an option's value is the path of a file, or holds such a path."""
    if isinstance(value, os.PathLike):
        return True
    if isinstance(value, Mapping):
        return any(map(names_file, value.values()))
    if isinstance(value, (list, tuple)):
        return any(map(names_file, value))
    return isinstance(value, str) and _FILE_NAME.search(value) is not None
