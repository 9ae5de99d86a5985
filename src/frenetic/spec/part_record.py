"""Parts in records and reports: what a strategy, driver or simulator is, and how two differ."""

from __future__ import annotations

import hashlib
import logging
import math
import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass
from functools import cache
from importlib import import_module
from pathlib import Path, PurePath
from types import FunctionType
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic._support.words import part_word
from frenetic.errors import describe_error
from frenetic.parts.registry import Made, arguments_of, options_of, part_name
from frenetic.parts.user_modules import USER_MODULE
from frenetic.parts.versions import (
    differences,
    innermost,
    other_version,
    over_each_other,
    version_of,
)

# Imports inside functions below are too slow for help.

logger = logging.getLogger(__name__)

PARTS: Final = ("strategy", "driver", "simulator")
_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")
_DEEPEST: Final = 3  # nesting of arguments in a record
_LONGEST: Final = 200  # characters of an argument in a record
_SHOWN_OPTIONS: Final = 6  # of a part; the others are shown as ",…"
_OF_THE_CAMPAIGN: Final = ("seed", "map_size", "road_class", "domain", "wall_limit")
"""Options of parts that are shown as those of their campaign."""
_UNKNOWN: Final = object()
"""Stands for the value of an option that is not known."""


def describe(part: object, made: Made | None = None) -> dict[str, JSONValue]:
    """A part of a campaign for its record: class, options, version, and the part under it.

    A driver's camera is there, too. The options are the part's ``options`` if it has any, or the
    fields of a dataclass; of a part of your own also the other arguments of its constructor. See
    `frenetic.parts.versions` for the version.

    Args:
        part: the object.
        made: how it was made by its name; without it, the arguments are those that a part of your
            own keeps as attributes (`frenetic.parts.registry.arguments_of`).
    """
    from frenetic.drivers.camera import Camera  # numpy takes its time
    from frenetic.drivers.driver import inner_driver  # likewise

    described: dict[str, JSONValue] = {"class": _class_name(type(part))}
    inner = inner_driver(part)
    arguments = _options_and_arguments(part, made, without="" if inner is None else "driver")
    if arguments:
        described["options"] = {name: _plain(value) for name, value in arguments.items()}
    described["version"] = version_of(part, arguments, made).text
    camera = getattr(part, "camera", None)
    if isinstance(camera, Camera):
        described["camera"] = asdict(camera)
    if inner is not None:
        described["driver"] = describe(inner)
    return described


def describe_terms() -> dict[str, str]:
    """The versions of the rules and of placing roads on the map, for a campaign's record."""
    from frenetic import road  # numba takes its time
    from frenetic.oracle import verdict  # numba takes its time

    return {"rules": f"version {verdict.BEHAVIOUR}", "map": f"version {road.BEHAVIOUR}"}


def sources_of(part: object, made: Made | None = None) -> dict[str, str]:
    """The user's own source of a part and of those under it: name of a file -> its text."""
    from frenetic.drivers.driver import inner_driver  # numpy takes its time

    inner = inner_driver(part)
    arguments = _options_and_arguments(part, made, without="" if inner is None else "driver")
    under = {} if inner is None else sources_of(inner)
    return under | dict(version_of(part, arguments, made).sources)


def _options_and_arguments(part: object, made: Made | None, *, without: str) -> dict[str, Any]:
    try:
        options = options_of(part)
        if options is None and is_dataclass(part):
            options = {item.name: getattr(part, item.name, None) for item in fields(part)}
        found = {str(name): value for name, value in (options or {}).items()}
        if not is_built_in(part):
            arguments = arguments_of(part) if made is None else made.arguments
            found |= {k: v for k, v in arguments.items() if k not in found}
    except Exception as error:  # a foreign class may raise anything
        logger.warning("what %s was made with is unknown: %s", type(part), describe_error(error))
        return {}
    # The rules are a part of their own.
    return {k: v for k, v in found.items() if k != without and type(v).__qualname__ != "Rules"}


def _class_name(kind: type) -> str:
    module = kind.__module__
    if module.startswith(USER_MODULE):
        module = Path(sys.modules[module].__file__ or module).name
    return f"{module}:{kind.__qualname__}"


def is_built_in(part: object) -> bool:
    """Whether a part's class is one of ours."""
    return type(part).__module__.partition(".")[0] == "frenetic"


def _plain(value: object, depth: int = 0) -> JSONValue:
    """A value as JSON, or else its repr without addresses; a set is a list in order."""
    if isinstance(value, (set, frozenset)):
        value = sorted(value, key=repr)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    if isinstance(value, Mapping) and depth < _DEEPEST:
        return {str(name): _plain(item, depth + 1) for name, item in value.items()}
    if isinstance(value, (list, tuple)) and len(value) <= 100 and depth < _DEEPEST:
        return [_plain(item, depth + 1) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, (type, FunctionType)):
        return f"{value.__module__}:{value.__qualname__}"
    try:
        text = repr(value)
    except Exception:
        text = f"<{_class_name(type(value))}>"
    if _ADDRESS.search(text):
        arguments = {} if depth == _DEEPEST else arguments_of(value)
        inner = {name: _plain(item, depth + 1) for name, item in arguments.items()}
        return {"class": _class_name(type(value)), "options": inner}
    digest = ""
    if len(text) > _LONGEST or "..." in text:
        # Arrays are shown in part.
        data = value.tobytes() if hasattr(value, "tobytes") else text.encode(errors="replace")
        digest = f" SHA-256 {hashlib.sha256(data).hexdigest()[:16]}"
    return text[:_LONGEST] + digest


def part_text(part: object, recorded: object = None, *, word: object = None) -> str:
    """Return a part with its options as the command line writes it: ``planner,aggression=1.2``.

    Layers over a driver follow in words, as in ``planner, delayed (seconds 0.05)``. Options that a
    built-in part has unasked are left out, and those of a strategy that its campaign says.

    Args:
        part: as `describe` gives it; the name is that of the driver under its layers.
        recorded: another part of the same class, whose differing options are added.
        word: how the command line wrote it, if it is known.
    """
    *layers, inner = over_each_other(part)
    texts = [word if isinstance(word, str) else _part_word(inner, innermost(recorded))]
    for layer in layers:
        options = ", ".join(_in_words(dict(_options_of(layer))))
        name = part_name(layer).lower()
        texts.append(f"{name} ({options})" if options else name)
    return ", ".join(texts)


def recorded_part(config: Mapping[str, Any], kind: str) -> str:
    """Return a part of a campaign's configuration as `part_text` gives it.

    Args:
        config: the configuration.
        kind: ``strategy``, ``driver`` or ``simulator``.
    """
    said = config.get("spec")
    return part_text(config.get(kind), word=said.get(kind) if isinstance(said, Mapping) else None)


def _part_word(part: Mapping[str, Any], recorded: Mapping[str, Any]) -> str:
    """Name and options of a part without layers, as on a command line."""
    name, options = part_name(part), dict(_options_of(part))
    unasked = _unasked_options(str(part.get("class", "")))
    is_alike = part_name(recorded) == name
    other_options = dict(_options_of(recorded)) if is_alike else unasked
    named = {
        option: value
        for option, value in options.items()
        if option not in _OF_THE_CAMPAIGN
        and (unasked.get(option, _UNKNOWN) != value or other_options.get(option, _UNKNOWN) != value)
        and not (isinstance(value, str) and re.split(r"[/\\]", value)[-1] == name)
    }
    shown = dict(list(named.items())[:_SHOWN_OPTIONS])
    return part_word(name, shown) + (",…" if len(named) > len(shown) else "")


@cache
def _unasked_options(class_name: str) -> Mapping[str, object]:
    """Options with which a built-in part is made unasked; empty for others."""
    module, _, name = class_name.partition(":")
    if module.partition(".")[0] != "frenetic":
        return {}
    for arguments in ({}, {"seed": 0}):  # strategies need the seed
        with suppress(Exception):  # an extra that is not installed, or other needed arguments
            return dict(_options_of(describe(getattr(import_module(module), name)(**arguments))))
    return {}


def _options_of(part: Mapping[str, Any], name: str = "options") -> Iterator[tuple[str, object]]:
    """Names and values of its options, including nested ones."""
    value = part.get(name)
    if isinstance(value, Mapping):
        for inner in value:
            if isinstance(value[inner], Mapping):
                yield from _options_of(value, inner)
            else:
                yield str(inner), value[inner]


def _in_words(options: Mapping[str, object]) -> list[str]:
    told = [
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in options.items()
    ]
    return told if len(told) <= _SHOWN_OPTIONS else [*told[:_SHOWN_OPTIONS], "…"]


# How two differ


def changed_parts(recorded: Mapping[str, Any], ours: Mapping[str, Any]) -> dict[str, list[str]]:
    """Name of a part of two configurations -> how ours differs, each in words."""
    found = {kind: list(differences(kind, recorded.get(kind), ours.get(kind))) for kind in PARTS}
    theirs, mine = recorded.get("behaviours", {}), ours.get("behaviours", {})
    found["version"] = [
        f"{name}: it is {mine.get(name)}, it was {theirs.get(name)}"
        for name in sorted({*theirs, *mine})
        if theirs.get(name) != mine.get(name)
    ]
    return {kind: texts for kind, texts in found.items() if texts}


def version_notes(
    recorded: Mapping[str, JSONValue], described: Mapping[str, JSONValue]
) -> list[str]:
    """Which parts are other versions of those in a configuration, each in words.

    Args:
        recorded: the configuration.
        described: kind -> part as `describe` gives it: ``simulator``, ``driver``.
    """
    notes = [other_version(kind, recorded.get(kind), part) for kind, part in described.items()]
    return [note for note in notes if note]
