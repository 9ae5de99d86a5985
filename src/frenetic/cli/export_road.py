"""The command that writes one road for other tools: export-road."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from frenetic.cli.options import file_option, json_option, lane_option

if TYPE_CHECKING:
    from frenetic.export import ExportedRoad

# `frenetic.export.FORMATS`, which takes longer to import than help may.
FORMATS: Final = ("opendrive", "competition", "csv", "json", "beamng")
EXPORTS: Final = "exports"
"""Folder in a campaign's folder for its exported roads."""


@click.command("export-road")
@click.argument("source", type=click.Path(path_type=Path), metavar="CAMPAIGN|ROAD")
@click.argument("test_id", type=int, required=False, metavar="[ID]")
@click.option(
    "--format",
    "name",
    type=click.Choice(FORMATS),
    help="What to write. [default: what the suffix of --out says]",
)
@file_option(
    "--out",
    "Where to write it, - for stdout. [default: in the campaign's folder, beside the road]",
    type=click.Path(path_type=Path, allow_dash=True),
)
@click.option(
    "--origin",
    type=float,
    nargs=2,
    metavar="LATITUDE LONGITUDE",
    help="OpenDRIVE: where on the globe x = y = 0 lies, in degrees. [default: 49 8.4]",
)
@lane_option
@json_option
def export_road(
    source: Path,
    test_id: int | None,
    name: str | None,
    out: Path | None,
    origin: tuple[float, float] | None,
    lane: int | None,
    as_json: bool,
) -> None:
    """Write the road of a CAMPAIGN's test, or of a ROAD file, for other tools.

    A campaign is its folder and needs the ID of a test. Prints the file's name.
    """
    from frenetic.export import format_of, road_format, write_road

    if as_json and str(out) == "-":
        raise click.UsageError("--json and --out - exclude each other: both write to stdout")
    if name is None:
        if out is None or str(out) == "-":
            raise click.UsageError(
                f"Missing option '--format': choose from {', '.join(FORMATS)}, or say it by the"
                " suffix of --out"
            )
        name = format_of(out).name
    if origin is not None and name != "opendrive":
        raise click.UsageError(f"--origin is for --format opendrive, not {name}")
    if lane is not None and test_id is not None:
        raise click.UsageError("--lane is for an OpenDRIVE file, not for a campaign's test")
    exported, default = _exported(source, test_id, lane)
    exported = replace(exported, origin=origin or exported.origin)
    the_format = road_format(name)
    if out is not None and str(out) == "-":
        # As bytes, so that every platform writes the same.
        sys.stdout.buffer.write(the_format.render(exported).encode("utf-8"))
        sys.stdout.buffer.flush()
        return
    path = default.with_name(default.name + the_format.suffix) if out is None else out
    if path.exists() and source.exists() and path.samefile(source):
        raise click.UsageError(f"{path} is the road itself: choose another file with --out")
    write_road(exported, name, path)
    click.echo(json.dumps({"file": str(path), "format": name}) if as_json else path)


def _exported(source: Path, test_id: int | None, lane: int | None) -> tuple[ExportedRoad, Path]:
    """The road, and the path of its file without the suffix."""
    from frenetic.export import ExportedRoad

    if test_id is None:
        from frenetic.road.files import read_road

        if source.is_dir():
            raise click.UsageError(
                f"{source} is a folder: say which test of the campaign, or name a road file"
            )
        road = read_road(source, lane=lane).road()
        return ExportedRoad(road, source.stem), source.with_suffix("")
    from frenetic.campaign import CampaignStore
    from frenetic.report.failures import file_stem
    from frenetic.simulators import Rules

    with CampaignStore.open(source) as store:
        test = store.test(test_id)
        speed_limit = Rules(**store.config["rules"]).speed_limit  # type: ignore[arg-type]
    stem = file_stem(test_id)
    exported = ExportedRoad(test.road, stem, speed_limit, test=test)
    return exported, source / EXPORTS / stem
