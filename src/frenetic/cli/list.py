"""The command `list`, which lists the known parts, conditions, road classes and criteria."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic.cli import echo
from frenetic.cli.console import print_table
from frenetic.cli.options import json_option
from frenetic.conditions.condition import known_conditions
from frenetic.criteria.criterion import SIGNALS, criteria_sets, signal_named
from frenetic.errors import FreneticError
from frenetic.parts.registry import (
    DRIVERS,
    MANOEUVRES,
    OBJECTIVES,
    SIMULATORS,
    STRATEGIES,
    Registry,
)

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

CLASS_UNITS: Final = {
    "design_speed": "km/h",
    "speed_limit": "km/h",
    "lane_width": "m",
    "widening": "m²",
    "length": "m",
    "min_radius": "m",
    "max_superelevation": "%",
    "min_clothoid": "m",
    "min_arc": "m",
    "min_straight": "m",
    "max_grade": "%",
    "min_crest": "m",
    "min_sag": "m",
}
"""Rule of a road class -> unit in which it is printed; shares are printed in %."""
_REGISTRIES: Final = {
    "drivers": DRIVERS,
    "strategies": STRATEGIES,
    "simulators": SIMULATORS,
    "objectives": OBJECTIVES,
    "manoeuvres": MANOEUVRES,
}
"""Kind of a part -> its registry."""
_KINDS: Final = [*_REGISTRIES, "conditions", "roads", "criteria"]
"""Kinds that can be listed, in the order of the list."""


@click.command("list")
@click.argument("kind", type=click.Choice(_KINDS), required=False, metavar="[KIND]")
@json_option
def list_parts(kind: str | None, as_json: bool) -> None:
    """List drivers, strategies, simulators, objectives, conditions and more: of a KIND, or all.

    Conditions are for --with and 'frenetic rerun --vary', roads for --roads, criteria for
    --criteria. Packages can add to all kinds but the roads. Your own road class or criteria are a
    TOML file.
    """
    kinds = _KINDS if kind is None else [kind]
    if as_json:
        documents = {kind: _documents(kind) for kind in kinds}
        echo(json.dumps(documents if kind is None else documents[kind]))
        return
    for number, listed_kind in enumerate(kinds):
        if number:
            echo()
        _print(listed_kind, title=listed_kind.capitalize() if kind is None else None)


def _documents(kind: str) -> list[dict[str, Any]]:
    """Return the entries of a kind as JSON objects."""
    if kind == "roads":
        return [road_class.as_json() for road_class in _road_classes()]
    if kind == "criteria":
        return [criteria_set.as_json() for criteria_set in criteria_sets().values()]
    if kind != "conditions":
        registry = _REGISTRIES[kind]
        return [
            {
                **asdict(entry),
                "summary": registry.summary_of(entry),
                **({"lays": _supported_by(entry.name)} if registry is SIMULATORS else {}),
            }
            for entry in registry.entries()
        ]
    return [
        {
            "name": condition.name,
            "unit": condition.unit,
            "range": [condition.low, condition.high],
            "usual": list(condition.usual),
            "needs_camera": condition.needs_camera,
            "about": condition.about,
        }
        for condition in known_conditions().values()
    ]


def _supported_by(simulator: str) -> list[str] | None:
    """Return the conditions that drives in a simulator can have without a camera.

    The result is None if the simulator cannot be loaded.
    """
    from frenetic.spec import simulator_defaults

    try:
        defaults = simulator_defaults(simulator)
    except FreneticError:  # its package is broken
        return None
    return [
        condition.name
        for condition in known_conditions().values()
        if defaults.can_apply(condition) and not condition.needs_camera
    ]


def _road_classes() -> list[RoadClass]:
    """Return all known road classes."""
    from frenetic.road.classes import RoadClass, classes  # imports numba

    return [RoadClass.of(name) for name in classes()]


def _print_road_classes(title: str | None) -> None:
    """Print the road classes as columns and their rules as rows."""
    road_classes = _road_classes()
    rows = [
        (
            rule.replace("_", " "),
            *(
                f"{getattr(road_class, rule) * (100.0 if unit == '%' else 1.0):g}"
                for road_class in road_classes
            ),
            unit,
        )
        for rule, unit in CLASS_UNITS.items()
    ]
    print_table(("rule", *(road_class.name for road_class in road_classes), ""), rows, title=title)
    echo(
        "Where each comes from: frenetic list roads --json. Without --roads, the competition's own"
        " rules count alone."
    )


def _print_criteria(title: str | None) -> None:
    """Print the sets of criteria as columns and the limits of signals as rows."""
    sets = criteria_sets()
    limits = [
        {criterion.signal: criterion.limit for criterion in criteria_set.criteria}
        for criteria_set in sets.values()
    ]
    # A set may limit a signal that is not among the built-in ones.
    names = dict.fromkeys([*SIGNALS, *(name for set_limits in limits for name in set_limits)])
    rows = [
        (
            signal_named(name).words,
            *(f"{set_limits[name]:g}" if name in set_limits else None for set_limits in limits),
            signal_named(name).unit,
        )
        for name in names
    ]
    print_table(("limit", *sets, ""), rows, title=title)
    for name, criteria_set in sets.items():
        left_out = f" Left out: {criteria_set.left_out}." if criteria_set.left_out else ""
        echo(f"{name}: {criteria_set.about}.{left_out}")
    echo(
        "Each limit's clause and window: frenetic list criteria --json. Leaving the lane fails in"
        " all; limits of your own: --criteria after-un-r79,lateral_jerk=4."
    )


def _print(kind: str, title: str | None) -> None:
    """Print the entries of a kind as a table under a title."""
    if kind == "roads":
        _print_road_classes(title)
    elif kind == "criteria":
        _print_criteria(title)
    elif kind == "conditions":
        _print_conditions(title)
    else:
        _print_parts(_REGISTRIES[kind], title)


def _print_conditions(title: str | None) -> None:
    """Print the conditions with their ranges."""
    print_table(
        ("name", "allowed", "usual", "what it is"),
        [
            (
                condition.name,
                condition.allowed,
                f"{condition.usual[0]:g} to {condition.usual[1]:g}"
                f"{' times' if condition.is_relative else ''}",
                condition.about,
            )
            for condition in known_conditions().values()
        ],
        title=title,
    )


def _print_parts(registry: Registry, title: str | None) -> None:
    """Print the parts of a registry; of simulators also the conditions that each supports."""
    entries = registry.entries()
    headings = ["name", "from", "what it is"]
    rows = [[entry.name, entry.origin, registry.summary_of(entry)] for entry in entries]
    wrappers = [condition for condition in known_conditions().values() if condition.wrapper]
    if registry is SIMULATORS:
        headings.append("conditions")
        of_drivers = {condition.name for condition in wrappers}  # named once, below the table
        for row, entry in zip(rows, entries, strict=True):
            supported = _supported_by(entry.name) or ()
            row.append(", ".join(name for name in supported if name not in of_drivers))
    print_table(headings, rows, title=title)
    if registry is SIMULATORS:
        camera = [condition.name for condition in wrappers if condition.needs_camera]
        others = [condition.name for condition in wrappers if not condition.needs_camera]
        camera_text = f"; over one with a camera: {', '.join(camera)}" if camera else ""
        echo(f"Over the driver, in all of them: {', '.join(others)}{camera_text}.")
    echo(f"Your own: {registry.own_names} as --{registry.kind}.")
