"""Options and arguments with which parts are made, read from their factories and attributes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


def options_of(part: object) -> Mapping[str, Any] | None:
    """Return the options of a part; None if the part does not keep them."""
    options = getattr(part, "options", None)
    return options if isinstance(options, Mapping) else None


@dataclass(frozen=True)
class Construction:
    """The call that made a part from its name: a factory with its arguments."""

    factory: Callable[..., Any]
    """Class of the part, or a function."""
    arguments: Mapping[str, Any]
    """Name -> value of each argument, with defaults."""


def arguments_of(part: object) -> dict[str, Any]:
    """Return the arguments of an object's constructor, as far as its attributes keep them.

    The attribute of an argument has the argument's name, or this name after an underscore.
    """
    arguments = {}
    for parameter in named_parameters(type(part)):
        for attribute in (parameter.name, f"_{parameter.name}"):
            try:
                arguments[parameter.name] = getattr(part, attribute)
                break
            except Exception:  # noqa: S112  # a foreign attribute may raise anything
                continue
    return arguments


def named_parameters(factory: Callable[..., Any]) -> list[inspect.Parameter]:
    """Return the parameters of a factory that can be passed by keyword.

    The list is empty if the factory, such as a class in C, hides its signature.
    """
    try:
        parameters = inspect.signature(factory).parameters.values()
    except (TypeError, ValueError):
        return []
    return [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]


def option_names(factory: Callable[..., Any]) -> list[str] | None:
    """Return the names of a factory's options; None if it takes any name or hides its options."""
    try:
        parameters = inspect.signature(factory).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    return [p.name for p in named_parameters(factory)]


def required_options(factory: Callable[..., Any]) -> list[str]:
    """Return the names of a factory's options without a default, as far as it shows them."""
    return [p.name for p in named_parameters(factory) if p.default is p.empty]
