"""Records of parts: class, options and version of a strategy, driver or simulator, and changes."""

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
from frenetic.parts.construction import Construction, arguments_of, options_of
from frenetic.parts.records import differences, innermost, other_version, over_each_other, part_name
from frenetic.parts.user_modules import USER_MODULE
from frenetic.parts.versions import version_of

# Imports inside functions below are too slow for help.

logger = logging.getLogger(__name__)

PARTS: Final = ("strategy", "driver", "simulator")
_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")
_DEEPEST: Final = 3  # most levels of nested arguments in a record, ours
_LONGEST: Final = 200  # most characters of an argument in a record, ours
_SHOWN_OPTIONS: Final = 6  # most options in a text; more are shown as ",…", ours
_OF_THE_CAMPAIGN: Final = ("seed", "map_size", "road_class", "domain", "wall_limit")
"""Options of parts that reports show as options of the campaign."""
_UNKNOWN: Final = object()
"""Value of an option that is not known."""


def describe(part: object, construction: Construction | None = None) -> dict[str, JSONValue]:
    """Return the record of a part: class, options, version, a driver's camera, the part under it.

    The options are the part's ``options`` if it has any, or the fields of a dataclass; for a part
    of your own also the other arguments of its constructor. See
    `frenetic.parts.versions` for the version.

    Args:
        part: the object.
        construction: call that made the part of its name; without it, the arguments are attributes
            of a part of your own (`frenetic.parts.construction.arguments_of`).
    """
    from frenetic.drivers.camera import Camera  # numpy takes its time
    from frenetic.drivers.driver import inner_driver  # numpy takes its time

    record: dict[str, JSONValue] = {"class": _class_name(type(part))}
    inner = inner_driver(part)
    arguments = _options_and_arguments(part, construction, has_inner=inner is not None)
    if arguments:
        record["options"] = {name: _plain(value) for name, value in arguments.items()}
    record["version"] = version_of(part, arguments, construction).text
    camera = getattr(part, "camera", None)
    if isinstance(camera, Camera):
        record["camera"] = asdict(camera)
    if inner is not None:
        record["driver"] = describe(inner)
    return record


def describe_terms() -> dict[str, str]:
    """Return the versions of the rules and of placing roads on the map, for a campaign's record."""
    from frenetic import road  # numba takes its time
    from frenetic.oracle import verdict  # numba takes its time

    return {"rules": f"version {verdict.BEHAVIOUR}", "map": f"version {road.BEHAVIOUR}"}


def sources_of(part: object, construction: Construction | None = None) -> dict[str, str]:
    """Return a user's sources of a part and of the parts under it: name of a file -> its text."""
    from frenetic.drivers.driver import inner_driver  # numpy takes its time

    inner = inner_driver(part)
    arguments = _options_and_arguments(part, construction, has_inner=inner is not None)
    under = {} if inner is None else sources_of(inner)
    return under | dict(version_of(part, arguments, construction).sources)


def _options_and_arguments(
    part: object, construction: Construction | None, *, has_inner: bool
) -> dict[str, Any]:
    """Return options and arguments of a part, without its rules and the driver under it."""
    try:
        options = options_of(part)
        if options is None and is_dataclass(part):
            options = {item.name: getattr(part, item.name, None) for item in fields(part)}
        values = {str(name): value for name, value in (options or {}).items()}
        if not is_built_in(part):
            arguments = arguments_of(part) if construction is None else construction.arguments
            values |= {k: v for k, v in arguments.items() if k not in values}
    except Exception as error:  # a foreign class may raise anything
        logger.warning("what %s was made with is unknown: %s", type(part), describe_error(error))
        return {}
    return {
        name: value
        for name, value in values.items()
        if not (has_inner and name == "driver") and type(value).__qualname__ != "Rules"
    }


def _class_name(kind: type) -> str:
    module = kind.__module__
    if module.startswith(USER_MODULE):
        module = Path(sys.modules[module].__file__ or module).name
    return f"{module}:{kind.__qualname__}"


def is_built_in(part: object) -> bool:
    """Return whether a part's class is built in."""
    return type(part).__module__.partition(".")[0] == "frenetic"


def _plain(value: object, depth: int = 0) -> JSONValue:
    """Return a value as JSON, or else its repr without addresses; a set as a list in order."""
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

    Wrappers over a driver follow in words, as in ``planner, delayed (seconds 0.05)``. Defaults of
    built-in parts are left out, and so are a strategy's options that its campaign has.

    Args:
        part: record of the part, see `describe`; the text names the driver under its wrappers.
        recorded: record of another part of the same class, whose differing options are added.
        word: word of the command line for the part, if it is known.
    """
    *wrappers, inner = over_each_other(part)
    texts = [word if isinstance(word, str) else _part_word(inner, innermost(recorded))]
    for wrapper in wrappers:
        options = ", ".join(_in_words(dict(_options_of(wrapper))))
        name = part_name(wrapper).lower()
        texts.append(f"{name} ({options})" if options else name)
    return ", ".join(texts)


def recorded_part(config: Mapping[str, Any], kind: str) -> str:
    """Return a part of a campaign's configuration as `part_text` gives it.

    Args:
        config: the configuration.
        kind: ``strategy``, ``driver`` or ``simulator``.
    """
    spec = config.get("spec")
    return part_text(config.get(kind), word=spec.get(kind) if isinstance(spec, Mapping) else None)


def _part_word(part: Mapping[str, Any], recorded: Mapping[str, Any]) -> str:
    """Return name and options of a part without wrappers, as on a command line."""
    name, options = part_name(part), dict(_options_of(part))
    defaults = _default_options(str(part.get("class", "")))
    is_alike = part_name(recorded) == name
    other_options = dict(_options_of(recorded)) if is_alike else defaults
    differing = {
        option: value
        for option, value in options.items()
        if option not in _OF_THE_CAMPAIGN
        and (
            defaults.get(option, _UNKNOWN) != value or other_options.get(option, _UNKNOWN) != value
        )
        and not (isinstance(value, str) and re.split(r"[/\\]", value)[-1] == name)
    }
    shown = dict(list(differing.items())[:_SHOWN_OPTIONS])
    return part_word(name, shown) + (",…" if len(differing) > len(shown) else "")


@cache
def _default_options(class_name: str) -> Mapping[str, object]:
    """Return the default options of a built-in part; empty for others."""
    module, _, name = class_name.partition(":")
    if module.partition(".")[0] != "frenetic":
        return {}
    for arguments in ({}, {"seed": 0}):  # strategies need the seed
        with suppress(Exception):  # an extra that is not installed, or other needed arguments
            return dict(_options_of(describe(getattr(import_module(module), name)(**arguments))))
    return {}


def _options_of(part: Mapping[str, Any], name: str = "options") -> Iterator[tuple[str, object]]:
    """Yield names and values of a part's options, nested ones included."""
    value = part.get(name)
    if isinstance(value, Mapping):
        for inner in value:
            if isinstance(value[inner], Mapping):
                yield from _options_of(value, inner)
            else:
                yield str(inner), value[inner]


def _in_words(options: Mapping[str, object]) -> list[str]:
    """Return a text about each option, up to `_SHOWN_OPTIONS`."""
    texts = [
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in options.items()
    ]
    return texts if len(texts) <= _SHOWN_OPTIONS else [*texts[:_SHOWN_OPTIONS], "…"]


# Changes


def changed_parts(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the parts that differ in two configurations: kind -> a text about each change."""
    changes = {kind: list(differences(kind, before.get(kind), now.get(kind))) for kind in PARTS}
    old, new = before.get("behaviours", {}), now.get("behaviours", {})
    changes["version"] = [
        f"{name}: it is {new.get(name)}, it was {old.get(name)}"
        for name in sorted({*old, *new})
        if old.get(name) != new.get(name)
    ]
    return {kind: texts for kind, texts in changes.items() if texts}


def version_notes(config: Mapping[str, JSONValue], parts: Mapping[str, JSONValue]) -> list[str]:
    """Return a text about each part that is another version than in a configuration.

    Args:
        config: the configuration.
        parts: kind, such as ``driver`` -> record of the present part, see `describe`.
    """
    notes = [other_version(kind, config.get(kind), part) for kind, part in parts.items()]
    return [note for note in notes if note]
