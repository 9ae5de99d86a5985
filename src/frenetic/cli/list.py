"""The command that lists the known parts and quantities: list."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, Final

import click

from frenetic.cli.console import print_table
from frenetic.cli.options import json_option
from frenetic.quantities import quantities
from frenetic.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES

_REGISTRIES: Final = {
    "drivers": DRIVERS,
    "strategies": STRATEGIES,
    "simulators": SIMULATORS,
    "objectives": OBJECTIVES,
}


@click.command("list")
@click.argument("kind", type=click.Choice([*_REGISTRIES, "quantities"]), required=False)
@json_option
def list_parts(kind: str | None, as_json: bool) -> None:
    """List drivers, strategies, simulators, objectives and quantities: those of a KIND, or all.

    Quantities are for --with and 'frenetic rerun --vary'. Packages add to all of them.
    """
    kinds = [*_REGISTRIES, "quantities"] if kind is None else [kind]
    if as_json:
        documents = {kind: _documents(kind) for kind in kinds}
        click.echo(json.dumps(documents if kind is None else documents[kind]))
        return
    for number, one in enumerate(kinds):
        if number:
            click.echo()
        _print(one, title=one.capitalize() if kind is None else None)


def _documents(kind: str) -> list[dict[str, Any]]:
    if kind != "quantities":
        registry = _REGISTRIES[kind]
        return [{**asdict(one), "summary": registry.about(one)} for one in registry.entries()]
    return [
        {
            "name": row.name,
            "unit": row.unit,
            "range": [row.low, row.high],
            "usual": list(row.usual),
            "about": row.about,
        }
        for row in quantities().values()
    ]


def _print(kind: str, title: str | None) -> None:
    if kind == "quantities":
        print_table(
            ("name", "allowed", "usual", "what it is"),
            [
                (
                    row.name,
                    row.allowed,
                    f"{row.usual[0]:g} to {row.usual[1]:g}{' times' if row.is_relative else ''}",
                    row.about,
                )
                for row in quantities().values()
            ],
            title=title,
        )
        return
    registry = _REGISTRIES[kind]
    entries = registry.entries()
    print_table(
        ("name", "from", "what it is"),
        [(entry.name, entry.origin, registry.about(entry)) for entry in entries],
        title=title,
    )
    files = "".join(f", or path/to/file{suffix}" for suffix in registry.files)
    word = registry.target.capitalize()
    click.echo(
        f"Your own: package.module:{word} or path/to/file.py:{word}{files} as --{registry.kind}."
    )
