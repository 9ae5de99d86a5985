"""The commands that list the known parts: drivers, strategies, simulators."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

from frenetic.cli.console import print_table
from frenetic.cli.options import json_option
from frenetic.registry import DRIVERS, SIMULATORS, STRATEGIES, Registry


def _listing(name: str, registry: Registry, summary: str) -> click.Command:
    @click.command(name, help=f"{summary} Others are installed as packages.")
    @json_option
    def listing(as_json: bool) -> None:
        entries = registry.entries()
        if as_json:
            click.echo(json.dumps([asdict(entry) for entry in entries]))
            return
        print_table(
            ("name", "from", "what it is"),
            [(entry.name, entry.origin, entry.summary or entry.target) for entry in entries],
        )
        files = "".join(f", or path/to/file{suffix}" for suffix in registry.files)
        click.echo(
            f"Your own: package.module:Class or path/to/file.py:Class{files} as --{registry.kind}."
        )

    return listing


drivers = _listing("drivers", DRIVERS, "List the drivers, the systems under test.")
strategies = _listing("strategies", STRATEGIES, "List the search strategies.")
simulators = _listing("simulators", SIMULATORS, "List the simulators.")
