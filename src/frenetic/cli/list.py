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
from frenetic.parts.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES

if TYPE_CHECKING:
    from frenetic.road.classes import RoadClass

UNITS: Final = {
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
"""Rule of a road class -> unit."""
_REGISTRIES: Final = {
    "drivers": DRIVERS,
    "strategies": STRATEGIES,
    "simulators": SIMULATORS,
    "objectives": OBJECTIVES,
}


_KINDS: Final = [*_REGISTRIES, "conditions", "roads", "criteria"]
"""Kinds in the order in which they are listed."""


@click.command("list")
@click.argument("kind", type=click.Choice(_KINDS), required=False, metavar="[KIND]")
@json_option
def list_parts(kind: str | None, as_json: bool) -> None:
    """List drivers, strategies, simulators, objectives, conditions and more: of a KIND, or all.

    Conditions are for --with and 'frenetic rerun --vary', roads for --roads, criteria for
    --criteria. Packages add to all but the roads; a class of your own is a TOML file, and so are
    criteria.
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
    if kind == "roads":
        return [road_class.as_json() for road_class in _classes()]
    if kind == "criteria":
        return [criteria_set.as_json() for criteria_set in criteria_sets().values()]
    if kind != "conditions":
        registry = _REGISTRIES[kind]
        return [
            {
                **asdict(entry),
                "summary": registry.about(entry),
                **({"lays": _laid_by(entry.name)} if registry is SIMULATORS else {}),
            }
            for entry in registry.entries()
        ]
    return [
        {
            "name": row.name,
            "unit": row.unit,
            "range": [row.low, row.high],
            "usual": list(row.usual),
            "needs_camera": row.needs_camera,
            "about": row.about,
        }
        for row in known_conditions().values()
    ]


def _laid_by(simulator: str) -> list[str] | None:
    """Return the conditions that a simulator lays without a camera; None if unknown."""
    from frenetic.spec import simulator_defaults

    try:
        usual = simulator_defaults(simulator)
    except FreneticError:  # its package is broken
        return None
    rows = known_conditions().values()
    return [row.name for row in rows if usual.lays(row) and not row.needs_camera]


def _classes() -> list[RoadClass]:
    from frenetic.road.classes import RoadClass, classes  # numba takes its time

    return [RoadClass.of(name) for name in classes()]


def _print_classes(title: str | None) -> None:
    """Print the road classes side by side, a rule in each row."""
    road_classes = _classes()
    rows = [
        (
            rule.replace("_", " "),
            *(
                f"{getattr(road_class, rule) * (100.0 if unit == '%' else 1.0):g}"
                for road_class in road_classes
            ),
            unit,
        )
        for rule, unit in UNITS.items()
    ]
    print_table(("rule", *(road_class.name for road_class in road_classes), ""), rows, title=title)
    echo(
        "Where each comes from: frenetic list roads --json. Without --roads, the competition's own"
        " rules count alone."
    )


def _print_criteria(title: str | None) -> None:
    """Print the sets of criteria side by side, a signal in each row."""
    sets = criteria_sets()
    limits = {
        name: {c.signal: c for c in criteria_set.criteria} for name, criteria_set in sets.items()
    }
    names = dict.fromkeys(
        [*SIGNALS, *(name for set_limits in limits.values() for name in set_limits)]
    )
    rows = [
        (
            signal_named(name).words,
            *(
                None if name not in set_limits else f"{set_limits[name].limit:g}"
                for set_limits in limits.values()
            ),
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
    if kind == "roads":
        _print_classes(title)
        return
    if kind == "criteria":
        _print_criteria(title)
        return
    if kind == "conditions":
        print_table(
            ("name", "allowed", "usual", "what it is"),
            [
                (
                    row.name,
                    row.allowed,
                    f"{row.usual[0]:g} to {row.usual[1]:g}{' times' if row.is_relative else ''}",
                    row.about,
                )
                for row in known_conditions().values()
            ],
            title=title,
        )
        return
    registry = _REGISTRIES[kind]
    entries = registry.entries()
    laid, wrappers = [], [row for row in known_conditions().values() if row.wrapper]
    if registry is SIMULATORS:
        over = [row.name for row in wrappers]
        laid = [", ".join(n for n in _laid_by(e.name) or () if n not in over) for e in entries]
    print_table(
        ("name", "from", "what it is", *(["conditions"] if laid else [])),
        [
            (entry.name, entry.origin, registry.about(entry), *laid[i : i + 1])
            for i, entry in enumerate(entries)
        ],
        title=title,
    )
    if laid:
        others, camera = ([r.name for r in wrappers if r.needs_camera is n] for n in (False, True))
        camera_text = f"; over one with a camera: {', '.join(camera)}" if camera else ""
        echo(f"Over the driver, in all of them: {', '.join(others)}{camera_text}.")
    files = "".join(f", or path/to/file{suffix}" for suffix in registry.files)
    word = registry.target.capitalize()
    echo(f"Your own: package.module:{word} or path/to/file.py:{word}{files} as --{registry.kind}.")
