"""Records of parts: their names, their versions, and how two records differ.

A campaign stores a record of each part, which `frenetic.spec.part_record.describe` makes. A reader
may meet damaged records, so any value is allowed where a record is expected.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from frenetic.parts.registry import DRIVERS, SIMULATORS, STRATEGIES

_MAX_OPTION_TEXT: Final = 60  # most characters of an option in a text for people; our choice


def part_name(record: object) -> str:
    """Return the name of a recorded part as the command line takes it.

    The name of a part made of a data file is the file's name; the name of another part of the
    user's own is its class's name.

    Args:
        record: record of the part, as `frenetic.spec.part_record.describe` makes it.
    """
    part = record if isinstance(record, Mapping) else {}
    module, _, class_name = str(part.get("class", "")).rpartition(":")

    def is_target(target: str) -> bool:
        package, _, attribute = target.partition(":")
        return class_name == attribute and f"{module}.".startswith(f"{package}.")

    for registry in (STRATEGIES, DRIVERS, SIMULATORS):
        for entry in registry.entries():
            if is_target(entry.target):
                return entry.name
        for suffix, target in registry.files.items():
            if is_target(target):
                options = part.get("options")
                texts = map(str, options.values()) if isinstance(options, Mapping) else ()
                files = (text for text in texts if text.lower().endswith(suffix))
                return re.split(r"[/\\]", next(files, class_name))[-1]
    return class_name or "unknown"


def over_each_other(record: object) -> Iterator[Mapping[str, Any]]:
    """Yield the record of a part and the records of the drivers under it, outermost first."""
    part = record if isinstance(record, Mapping) else {}
    yield part
    while isinstance(part.get("driver"), Mapping):
        part = part["driver"]
        yield part


def innermost(record: object) -> Mapping[str, Any]:
    """Return the record of the driver under all wrappers; of another part, its record."""
    *_, inner = over_each_other(record)
    return inner


def differences(kind: str, before: object, now: object) -> tuple[str, ...]:
    """Return a text about each difference of two records of a part and of the drivers under it.

    Args:
        kind: word for the part, such as ``driver``.
        before: the earlier record.
        now: the present record.
    """
    old, new = (record if isinstance(record, Mapping) else {} for record in (before, now))
    if old.get("class") != new.get("class"):
        return (f"{kind} is {part_name(new)}, it was {part_name(old)}",)
    old_options, new_options = old.get("options") or {}, new.get("options") or {}
    texts = [
        f"{name} is {_option_text(new_options.get(name))}, it was"
        f" {_option_text(old_options.get(name))}"
        for name in [*old_options, *(name for name in new_options if name not in old_options)]
        if old_options.get(name) != new_options.get(name)
    ]
    if old.get("version") != new.get("version"):
        texts.append(f"it is {new.get('version')}, it was {old.get('version')}")
    sentences = tuple(f"{kind} {part_name(new)}: {text}" for text in texts)
    if "driver" in old or "driver" in new:
        sentences += differences(kind, old.get("driver"), new.get("driver"))
    return sentences


def other_version(kind: str, before: object, now: object) -> str:
    """Return a sentence if two records of a part differ in its version alone.

    The sentence is empty for equal versions, for two different parts, and without a record. Options
    and wrappers are not compared.
    """
    old, new = (innermost(record) for record in (before, now))
    if old.get("class") != new.get("class") or old.get("version") == new.get("version"):
        return ""
    return (
        f"{kind} {part_name(new)} is another version than the campaign's: it is"
        f" {new.get('version')}, it was {old.get('version')}"
    )


def comparison_key(*records: object) -> str:
    """Return a text that is equal for equal records of parts."""
    return json.dumps(records, sort_keys=True)


def short_version(record: object) -> str:
    """Return the version in a part's record; empty if the record has none."""
    version = record.get("version") if isinstance(record, Mapping) else None
    return str(version or "")


def _option_text(value: object) -> str:
    """Return an option as JSON, cut to `_MAX_OPTION_TEXT` characters."""
    text = json.dumps(value)
    return text if len(text) <= _MAX_OPTION_TEXT else f"{text[: _MAX_OPTION_TEXT - 3]}..."
