"""Records of parts: class, options and version, and what differs between two records."""

from __future__ import annotations

import hashlib
import logging
import math
import re
import sys
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path, PurePath
from types import FunctionType
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic.errors import describe_error
from frenetic.parts.construction import Construction, arguments_of, options_of
from frenetic.parts.records import differences, other_version
from frenetic.parts.user_modules import USER_MODULE
from frenetic.parts.versions import version_of
from frenetic.spec.parts import PARTS

# Modules that would slow down --help are imported inside functions.

logger = logging.getLogger(__name__)

_ADDRESS: Final = re.compile(r" at 0x[0-9a-fA-F]+")
"""Address of an object in memory, within its repr."""
_MAX_DEPTH: Final = 3
"""Largest number of levels of nested arguments in a record (our choice)."""
_MAX_ITEMS: Final = 100
"""Largest number of items of a list in a record; a longer list is recorded as repr (our choice)."""
_MAX_TEXT: Final = 200
"""Largest number of characters of an argument's repr in a record (our choice).

A digest stands for the rest.
"""


def describe(part: object, construction: Construction | None = None) -> dict[str, JSONValue]:
    """Return the record of a part: class, options, version, camera, and the driver under a wrapper.

    The options are the part's ``options`` if it has any, or the fields of a dataclass; for a part
    of your own also the other arguments of its constructor. `frenetic.parts.versions` says what
    the version is.

    Args:
        part: a strategy, driver or simulator.
        construction: the call that made the part. Without it the arguments of your own part are
            read from its attributes (`frenetic.parts.construction.arguments_of`).
    """
    from frenetic.drivers.camera import Camera  # imports numpy
    from frenetic.drivers.stack import inner_driver  # imports numpy

    record: dict[str, JSONValue] = {"class": _class_name(type(part))}
    inner = inner_driver(part)
    arguments = _options_and_arguments(part, construction, has_inner=inner is not None)
    if arguments:
        record["options"] = {name: _as_json(value) for name, value in arguments.items()}
    record["version"] = version_of(part, arguments, construction).text
    camera = getattr(part, "camera", None)
    if isinstance(camera, Camera):
        record["camera"] = asdict(camera)
    if inner is not None:
        record["driver"] = describe(inner)
    return record


def behaviour_versions() -> dict[str, str]:
    """Return the versions of the rules and of placing roads on the map, for a campaign's record."""
    from frenetic import road  # imports numba
    from frenetic.oracle import verdict  # imports numba

    return {"rules": f"version {verdict.BEHAVIOUR}", "map": f"version {road.BEHAVIOUR}"}


def sources_of(part: object, construction: Construction | None = None) -> dict[str, str]:
    """Return the user's source files of a part and of the driver under a wrapper: name -> text."""
    from frenetic.drivers.stack import inner_driver  # imports numpy

    inner = inner_driver(part)
    arguments = _options_and_arguments(part, construction, has_inner=inner is not None)
    inner_sources = {} if inner is None else sources_of(inner)
    return inner_sources | dict(version_of(part, arguments, construction).sources)


def _options_and_arguments(
    part: object, construction: Construction | None, *, has_inner: bool
) -> dict[str, Any]:
    """Return the options and arguments of a part, without its rules and a wrapper's driver."""
    try:
        options = options_of(part)
        if options is None and is_dataclass(part):
            options = {item.name: getattr(part, item.name, None) for item in fields(part)}
        values = {str(name): value for name, value in (options or {}).items()}
        if not is_built_in(part):
            arguments = arguments_of(part) if construction is None else construction.arguments
            values |= {name: value for name, value in arguments.items() if name not in values}
    except Exception as error:  # a foreign class may raise anything
        logger.warning("the options of %s are unknown: %s", type(part), describe_error(error))
        return {}
    return {
        name: value
        for name, value in values.items()
        if not (has_inner and name == "driver") and type(value).__qualname__ != "Rules"
    }


def _class_name(kind: type) -> str:
    """Return ``module:Class``; for a class in a user's file the file's name is the module."""
    module = kind.__module__
    if module.startswith(USER_MODULE):
        module = Path(sys.modules[module].__file__ or module).name
    return f"{module}:{kind.__qualname__}"


def is_built_in(part: object) -> bool:
    """Return whether a part's class is built in."""
    return type(part).__module__.partition(".")[0] == "frenetic"


def _as_json(value: object, depth: int = 0) -> JSONValue:
    """Return a value for JSON: sets as ordered lists, other objects as class and options or repr.

    Args:
        value: an argument of a part, or a value within it.
        depth: number of levels above the value.
    """
    if isinstance(value, (set, frozenset)):
        value = sorted(value, key=repr)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return value
    if isinstance(value, Mapping) and depth < _MAX_DEPTH:
        return {str(name): _as_json(item, depth + 1) for name, item in value.items()}
    if isinstance(value, (list, tuple)) and len(value) <= _MAX_ITEMS and depth < _MAX_DEPTH:
        return [_as_json(item, depth + 1) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, (type, FunctionType)):
        return f"{value.__module__}:{value.__qualname__}"
    try:
        text = repr(value)
    except Exception:
        text = f"<{_class_name(type(value))}>"
    if _ADDRESS.search(text):
        arguments = {} if depth == _MAX_DEPTH else arguments_of(value)
        inner = {name: _as_json(item, depth + 1) for name, item in arguments.items()}
        return {"class": _class_name(type(value)), "options": inner}
    digest = ""
    if len(text) > _MAX_TEXT or "..." in text:
        # The repr of a large array has "..." in place of most numbers.
        data = value.tobytes() if hasattr(value, "tobytes") else text.encode(errors="replace")
        digest = f" SHA-256 {hashlib.sha256(data).hexdigest()[:16]}"
    return text[:_MAX_TEXT] + digest


# Changes


def changed_parts(before: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return what differs in two configurations: kind of a part -> a text about each change.

    The key ``version`` stands for rules, map and objective.
    """
    changes = {kind: list(differences(kind, before.get(kind), now.get(kind))) for kind in PARTS}
    old_versions, new_versions = before.get("behaviours", {}), now.get("behaviours", {})
    changes["version"] = [
        f"{name}: it is {new_versions.get(name)}, it was {old_versions.get(name)}"
        for name in sorted({*old_versions, *new_versions})
        if old_versions.get(name) != new_versions.get(name)
    ]
    return {kind: texts for kind, texts in changes.items() if texts}


def version_notes(config: Mapping[str, JSONValue], parts: Mapping[str, JSONValue]) -> list[str]:
    """Return a text about each part whose version differs from the recorded one.

    Args:
        config: configuration of a campaign, which holds the recorded parts.
        parts: kind, such as ``driver`` -> record of the present part, see `describe`.
    """
    notes = [other_version(kind, config.get(kind), part) for kind, part in parts.items()]
    return [note for note in notes if note]
