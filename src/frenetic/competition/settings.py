"""Settings beyond the pipeline's command line: seed and options of the strategy.

They share no code with `frenetic.spec`, which the pipeline's Python 3.9 cannot import.
"""

from __future__ import annotations

import difflib
import inspect
import json
import os
import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np

from frenetic.errors import FreneticError
from frenetic.search import Strategy

SEED = "FRENETIC_SEED"
"""Environment variable: a whole number of at least 0."""
OPTIONS = "FRENETIC_STRATEGY_OPTIONS"
"""Environment variable: NAME=VALUE, several separated by blanks."""


def read_seed(default: int | None, environment: Mapping[str, str] = os.environ) -> int:
    """Return the seed of the environment, else the default, else a new one.

    Raises:
        FreneticError: It is not a whole number of at least 0.

    """
    text = environment.get(SEED, "").strip()
    if not text:
        return (
            default if default is not None else int(np.random.SeedSequence().generate_state(1)[0])
        )
    if not text.isdecimal():
        raise FreneticError(f"{SEED} is {text!r}: a whole number of at least 0 is needed")
    return int(text)


def read_options(
    default: Mapping[str, Any], environment: Mapping[str, str] = os.environ
) -> dict[str, Any]:
    """Return the default options, overridden by those of the environment.

    A value is read as ``frenetic run --strategy-option`` reads it: as JSON or a number if it is
    one, otherwise as text.

    Raises:
        FreneticError: An option is not NAME=VALUE.

    """
    options = dict(default)
    text = environment.get(OPTIONS, "")
    try:
        settings = shlex.split(text)
    except ValueError as error:
        raise FreneticError(f"{OPTIONS} is {text!r}: {error}") from None
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not (name and equals):
            raise FreneticError(
                f"{OPTIONS} holds {setting!r}: NAME=VALUE is needed, several separated by blanks"
            )
        options[name] = _read(value)
    return options


def _read(text: str) -> Any:
    for read in (json.loads, float):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def make_strategy(
    kind: type[Any], *, seed: int, map_size: float, options: Mapping[str, Any]
) -> Strategy:
    """Return a strategy; seed and map size are passed to a class that takes them.

    Raises:
        FreneticError: There is no such option, or its value is out of range.

    """
    parameters = inspect.signature(kind).parameters.values()
    takes_any = any(p.kind is p.VAR_KEYWORD for p in parameters)
    names = [p.name for p in parameters if p.kind is not p.VAR_KEYWORD]
    given = {"seed": seed, "map_size": map_size}
    for name in options:
        if name in given:
            raise FreneticError(
                f"{name} is no option of the strategy here: it comes from"
                f" {'--map-size' if name == 'map_size' else SEED}"
            )
        if not takes_any and name not in names:
            close = difflib.get_close_matches(name, names, n=1)
            hint = f", did you mean {close[0]!r}?" if close else "."
            has = ", ".join(n for n in names if n not in given) or "none"
            raise FreneticError(f"{kind.__name__} has no option {name!r}{hint} It has: {has}")
    taken = {name: value for name, value in given.items() if takes_any or name in names}
    try:
        strategy: Strategy = kind(**taken, **options)
    except (TypeError, ValueError) as error:
        raise FreneticError(f"{kind.__name__}: {error}") from error
    return strategy
