"""What drivers and simulators are called in reports."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

_MOST_OPTIONS: Final = 3


def part_text(part: object, recorded: object = None) -> str:
    """A driver or simulator, such as ``Planner, delayed (seconds 0.05)``.

    Args:
        part: as a campaign describes it; the name is that of the driver under its layers.
        recorded: another one; options by which the part differs from it are added if both are of
            the same class.
    """
    *layers, inner = _layers(part)
    texts = [_class_of(inner)]
    *_, own = _layers(recorded)
    if _class_of(own) == _class_of(inner):
        theirs = dict(_options(own))
        texts += _told({k: v for k, v in _options(inner) if theirs.get(k) != v})
    for layer in layers:
        told = ", ".join(_told(dict(_options(layer))))
        texts.append(f"{_class_of(layer).lower()} ({told})" if told else _class_of(layer).lower())
    return ", ".join(texts)


def _layers(part: object) -> Iterator[Mapping[str, Any]]:
    """A part and all that it is laid over, from the outside."""
    while isinstance(part, Mapping):
        yield part
        if not isinstance(part.get("driver"), Mapping):
            return
        part = part["driver"]
    yield {}


def _class_of(part: Mapping[str, Any]) -> str:
    return str(part.get("class", "")).rpartition(":")[2] or "unknown"


def _options(part: Mapping[str, Any], name: str = "options") -> Iterator[tuple[str, object]]:
    """Names and values of its options, those within others, too."""
    value = part.get(name)
    if isinstance(value, Mapping):
        for inner in value:
            if isinstance(value[inner], Mapping):
                yield from _options(value, inner)
            else:
                yield str(inner), value[inner]


def _told(options: Mapping[str, object]) -> list[str]:
    told = [
        f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in options.items()
    ]
    return told if len(told) <= _MOST_OPTIONS else [*told[:_MOST_OPTIONS], "…"]
