"""Texts about recorded parts, with their options as the command line writes them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib import import_module
from inspect import signature
from typing import Any, Final

from frenetic._support.option_text import part_word
from frenetic.parts.records import innermost, over_each_other, part_name
from frenetic.spec.part_record import describe

_MAX_OPTIONS: Final = 6
"""Largest number of options in a text; more are shown as "…" (our choice)."""
_CAMPAIGN_OPTIONS: Final = ("seed", "map_size", "road_class", "domain", "wall_limit")
"""Options of parts that follow from the campaign, which reports show beside its parts."""
_UNKNOWN: Final = object()
"""Value of an option that is not recorded."""


def part_text(part: object, recorded: object = None, *, word: object = None) -> str:
    """Return a part with its options as the command line writes it: ``planner,aggression=1.2``.

    Wrappers around a driver follow, as in ``planner, delayed (seconds 0.05)``. The text leaves out
    defaults of built-in parts and options that follow from the campaign.

    Args:
        part: record of the part, see `frenetic.spec.part_record.describe`.
        recorded: record with which the part is compared: an option that differs there is named
            even if it is a default.
        word: text with which the user named the part, if it is known.
    """
    *wrappers, inner = over_each_other(part)
    texts = [word if isinstance(word, str) else _command_text(inner, innermost(recorded))]
    for wrapper in wrappers:
        options = ", ".join(_option_texts(dict(_options_of(wrapper))))
        name = part_name(wrapper).lower()
        texts.append(f"{name} ({options})" if options else name)
    return ", ".join(texts)


def recorded_part(config: Mapping[str, Any], kind: str) -> str:
    """Return the `part_text` of a part in a campaign's configuration.

    Args:
        config: the configuration.
        kind: ``strategy``, ``driver`` or ``simulator``.
    """
    spec = config.get("spec")
    return part_text(config.get(kind), word=spec.get(kind) if isinstance(spec, Mapping) else None)


def _command_text(part: Mapping[str, Any], recorded: Mapping[str, Any]) -> str:
    """Return name and options of a part without wrappers, as the command line writes them.

    An option is named if it differs from the default or from the recorded part of the same name.
    """
    name, options = part_name(part), dict(_options_of(part))
    defaults = _default_options(str(part.get("class", "")))
    has_same_name = part_name(recorded) == name
    other_options = dict(_options_of(recorded)) if has_same_name else defaults
    differing = {
        option: value
        for option, value in options.items()
        if option not in _CAMPAIGN_OPTIONS
        and (
            defaults.get(option, _UNKNOWN) != value or other_options.get(option, _UNKNOWN) != value
        )
        # A part made of a file has the file's name, so its option with the path says no more.
        and not (isinstance(value, str) and re.split(r"[/\\]", value)[-1] == name)
    }
    first_options = dict(list(differing.items())[:_MAX_OPTIONS])
    return part_word(name, first_options) + (",…" if len(differing) > _MAX_OPTIONS else "")


@cache
def _default_options(class_name: str) -> Mapping[str, object]:
    """Return the default options of a built-in part; empty for others."""
    module, _, name = class_name.partition(":")
    if module.partition(".")[0] != "frenetic":
        return {}
    with suppress(Exception):  # an extra is not installed
        part_class = getattr(import_module(module), name)
        for arguments in ({}, {"seed": 0}):  # strategies need a seed
            with suppress(Exception):  # the class needs other arguments
                return dict(_options_of(describe(part_class(**arguments))))
        parameters = signature(part_class).parameters.values()
        return {item.name: item.default for item in parameters if item.default is not item.empty}
    return {}


def _options_of(record: Mapping[str, Any], key: str = "options") -> Iterator[tuple[str, object]]:
    """Yield names and values of the options under a key of a record, nested ones included."""
    options = record.get(key)
    if isinstance(options, Mapping):
        for name, value in options.items():
            if isinstance(value, Mapping):
                yield from _options_of(options, name)
            else:
                yield str(name), value


def _option_texts(options: Mapping[str, object]) -> list[str]:
    """Return a text about each option, such as ``seconds 0.05``, up to `_MAX_OPTIONS`."""
    texts = [
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in options.items()
    ]
    return texts if len(texts) <= _MAX_OPTIONS else [*texts[:_MAX_OPTIONS], "…"]
