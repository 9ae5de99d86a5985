"""The command that judges roads without driving them: validate."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from frenetic.cli import complain
from frenetic.cli.options import check_map_size, json_option, lane_option
from frenetic.errors import FreneticError


@click.command()
@click.argument(
    "files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE..."
)
@click.option(
    "--map-size", type=float, default=200.0, show_default=True, help="m, side of the map."
)
@lane_option
@json_option
def validate(files: tuple[Path, ...], map_size: float, lane: int | None, as_json: bool) -> None:
    """Say for each road file whether it is valid by the competition's rules.

    Points are judged where they lie, curvatures where they fit the map. The exit code is 1 if any
    road is invalid, 2 if a file cannot be read; the other files are still judged.
    """
    from frenetic.road.files import read_road

    check_map_size(map_size)
    verdicts: list[dict[str, Any]] = []
    unreadable = []
    for path in files:
        try:
            verdict = read_road(path, lane=lane).check_validity(map_size)
        except FreneticError as error:
            unreadable.append(str(error))
            continue
        verdicts.append({"file": str(path), "valid": verdict.valid, "message": verdict.message})
        if not as_json:
            click.echo(f"{path}: {'valid' if verdict.valid else 'INVALID  ' + verdict.message}")
    if as_json:
        click.echo(json.dumps(verdicts))
    if unreadable:
        for message in unreadable:
            complain(message)
        raise click.exceptions.Exit(2)
    if not all(verdict["valid"] for verdict in verdicts):
        raise click.exceptions.Exit(1)
