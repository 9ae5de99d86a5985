"""The place of a simulator: options that say where it is and change no drive."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import click
from msgspec import structs

from frenetic._support.option_text import part_word
from frenetic.cli.entries import entry_option
from frenetic.parts.registry import SIMULATORS
from frenetic.spec import Spec, simulator_defaults

place_option: Final = entry_option(
    "simulator",
    "Where the simulator is now, if it has moved: host=pc,port=25252 or home=/opt/b.",
    parameter="place_options",
)


def without_place(spec: Spec) -> Spec:
    """Return the spec without the options that say where its simulator is.

    The class of a user's own simulator is not loaded, so its options stay.
    """
    simulator = spec.part("simulator")
    if not simulator.options or SIMULATORS.is_own(simulator.name):
        return spec
    return _with_place(spec, {})


def moved(recorded: Spec, place_options: Spec | None) -> Spec:
    """Return the spec of a campaign with its simulator where `place_option` says.

    Args:
        recorded: the campaign's spec.
        place_options: value of the option; None without the option.

    Raises:
        click.UsageError: the option says more than a place, or names another simulator.
    """
    if place_options is None:
        return recorded
    name = recorded.part("simulator").name
    known_options = simulator_defaults(name).place_options
    place = Spec.of({"simulator": name}, place_options).part("simulator")
    if place.name != name or not place.options.keys() <= {*known_options}:
        only = f"can only say where {name} is ({', '.join(known_options)})"
        raise click.UsageError(
            f"--simulator {only if known_options else f'is for one that moves, unlike {name}'}:"
            " all else would be another campaign"
        )
    return _with_place(recorded, place.options)


def _with_place(spec: Spec, place: Mapping[str, Any]) -> Spec:
    """Return the spec with these options that say where its simulator is, and no others."""
    name, options = spec.part("simulator")
    known_options = simulator_defaults(name).place_options
    others = {option: value for option, value in options.items() if option not in known_options}
    return structs.replace(spec, simulator=part_word(name, {**others, **place}))
