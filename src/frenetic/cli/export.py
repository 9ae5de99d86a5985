"""The command `export`, which writes campaigns and roads for other tools."""

from __future__ import annotations

import hashlib
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.option_text import read_part
from frenetic.cli import echo
from frenetic.cli.console import Log, counted_progress, shell
from frenetic.cli.options import (
    as_usage_error,
    file_option,
    json_option,
    lane_option,
    road_option,
    source_arguments,
)
from frenetic.conditions.condition import as_text
from frenetic.oracle.outcome import Outcome
from frenetic.parts.registry import hint

if TYPE_CHECKING:
    from frenetic.export import ExportedRoad

# Copies of the formats in `frenetic.export`, which imports too slowly for --help.
TABLES: Final[Mapping[str, tuple[str, ...]]] = {
    "parquet": ("trajectories",),
    "csv": ("trajectories",),
    "json": ("trajectories",),
    "competition": ("trajectories",),
}
"""Format of a campaign -> its options."""
ROADS: Final[Mapping[str, tuple[str, ...]]] = {
    "opendrive": ("origin",),
    "competition": (),
    "csv": (),
    "json": (),
    "beamng": (),
}
"""Format of a road -> its options."""
_MAX_ROADS_IN_NAME: Final = 60
"""Largest number of characters of a map's road IDs in a file name; a digest follows a cut."""
TRACE: Final[Mapping[str, tuple[str, ...]]] = {"trace": ("file",)}
"""Format of a campaign's tests, a file each -> its options."""
EXPORTS: Final = "exports"
"""Folder for exported roads in a campaign's folder."""


@click.command()
@source_arguments()
@click.option(
    "--format",
    "form",
    metavar="FORMAT",
    help=f"For a campaign {', '.join(TABLES)}; for roads {', '.join(ROADS)}; for drives of a"
    " campaign or of IDs, trace. Options follow a comma: csv,trajectories=failures (or all, none),"
    " opendrive,origin=[49,8.4], trace,file=mcap (or csv). [default: for a road, what the suffix of"
    " --out says]",
)
@file_option(
    "--out",
    "Folder for a campaign or traces, file for a road, - for stdout. [default: in exports/ of the"
    " campaign, beside the road]",
    type=click.Path(path_type=Path, allow_dash=True),
)
@click.option(
    "--outcome",
    "outcomes",
    type=click.Choice([str(outcome) for outcome in Outcome], case_sensitive=False),
    multiple=True,
    help="For a campaign: only tests with this outcome; may be repeated. [default: all]",
)
@lane_option
@road_option
@json_option
def export(
    source: Path,
    test_ids: tuple[int, ...],
    form: str | None,
    out: Path | None,
    outcomes: tuple[str, ...],
    lane: int | None,
    map_roads: str | None,
    as_json: bool,
) -> None:
    """Write a campaign, single roads or drives for other tools.

    A CAMPAIGN without IDs, or a folder of several, such as a bench's, becomes a folder of tables,
    for pandas, DuckDB and others (Parquet needs the extra 'tables'), or of the competition's files.
    The road of a test ID, as it lay on the map, or of a ROAD file becomes a file of its own. As a
    trace, a drive becomes a file with all its signals, for PlotJuggler, Foxglove (extra 'mcap') and
    spreadsheets. Each file is written completely or not at all, and its path is printed.
    """
    name, options = _read_format(form)
    has_drives = name in TRACE and not source.is_file()
    is_campaign = has_drives or (source.is_dir() and not test_ids)
    formats = {**TABLES, **TRACE} if is_campaign else ROADS
    if is_campaign and (lane is not None or map_roads is not None or str(out) == "-"):
        raise click.UsageError("--lane, --road and --out - are for a road: name the ID of a test")
    if outcomes and (test_ids or not is_campaign):
        raise click.UsageError("--outcome is for a whole campaign: leave out the ID of a test")
    if name is None:
        name = _format_by_suffix(out, is_campaign=is_campaign)
    if name not in formats:
        raise click.BadParameter(
            f"{name!r} is no format of {'a campaign' if is_campaign else 'a road'}: choose from"
            f" {', '.join(formats)}",
            param_hint="'--format'",
        )
    for option in options:
        if option not in formats[name]:
            known = ", ".join(formats[name]) or "none"
            raise click.BadParameter(
                f"{name} has no option {option!r}{hint(option, formats[name])} It has: {known}",
                param_hint="'--format'",
            )
    if name in TRACE:
        _export_traces(source, test_ids, options, out, outcomes, as_json)
    elif is_campaign:
        _export_campaign(source, name, options, out, outcomes, as_json)
    else:
        _export_roads(source, test_ids, name, options, out, as_json, lane=lane, roads=map_roads)


def _read_format(form: str | None) -> tuple[str | None, dict[str, Any]]:
    """Return name and options of ``--format``; no name without the option.

    Raises:
        click.BadParameter: the text is not NAME,OPTION=VALUE.
    """
    try:
        return (None, {}) if form is None else read_part(form)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="'--format'") from None


def _format_by_suffix(out: Path | None, *, is_campaign: bool) -> str:
    """Return the name of a road's format, by the suffix of ``--out``.

    Raises:
        click.UsageError: there is no suffix, or a campaign is exported, which is no file.
    """
    from frenetic.export import format_of

    if is_campaign or out is None or str(out) == "-":
        formats = ", ".join([*TABLES, *TRACE] if is_campaign else ROADS)
        also = "" if is_campaign else ", or say it by the suffix of --out"
        raise click.UsageError(f"Missing option '--format': choose from {formats}{also}")
    return format_of(out).name


def _export_campaign(
    source: Path,
    name: Any,
    options: dict[str, Any],
    out: Path | None,
    outcomes: tuple[str, ...],
    as_json: bool,
) -> None:
    """Export the campaigns in a folder in the format of a name; print the new folder."""
    from frenetic.analysis.groups import find_campaigns
    from frenetic.campaign import CampaignStore
    from frenetic.export import export_campaign

    log = Log()
    with as_usage_error(), counted_progress(log, "Exporting") as show:
        folder = export_campaign(source, name, out, outcomes=outcomes, on_progress=show, **options)
    for campaign in find_campaigns(source) if name == "competition" else ():
        with CampaignStore.open(campaign) as store:
            domain = store.setting.domain
        if domain is not None and domain.conditions:
            log.print(
                f"Note: the competition's files do not say in which conditions of {domain.name}"
                " each test was driven; the other formats do",
                markup=False,
            )
            break
    document = {"folder": str(folder), "format": name, "outcomes": list(outcomes)}
    echo(json.dumps(document) if as_json else folder)


def _export_traces(
    source: Path,
    test_ids: tuple[int, ...],
    options: dict[str, Any],
    out: Path | None,
    outcomes: tuple[str, ...],
    as_json: bool,
) -> None:
    """Export the drives of a campaign's tests as traces; print their folder."""
    from frenetic.export import export_traces

    form = str(options.get("file", "csv"))
    with as_usage_error(), counted_progress(Log(), "Exporting") as show:
        folder = export_traces(
            source, out, form=form, tests=test_ids, outcomes=outcomes, on_progress=show
        )
    document = {"folder": str(folder), "format": "trace", "outcomes": list(outcomes)}
    echo(json.dumps(document) if as_json else folder)


def _export_roads(
    source: Path,
    test_ids: tuple[int, ...],
    name: str,
    options: dict[str, Any],
    out: Path | None,
    as_json: bool,
    *,
    lane: int | None,
    roads: str | None,
) -> None:
    """Export single roads in the format of a name; print the path of each file."""
    from frenetic.export import road_format, write_road

    if as_json and str(out) == "-":
        raise click.UsageError("--json and --out - exclude each other: both write to stdout")
    if test_ids and (lane is not None or roads is not None):
        raise click.UsageError("--lane and --road are for OpenDRIVE, not for a campaign's test")
    if out is not None and len(test_ids) > 1:
        raise click.UsageError("--out is for one road: leave it out where there are several")
    road_writer = road_format(name)
    with as_usage_error():
        exported_roads = [
            _exported(source, test_id, options, lane=lane, roads=roads)
            for test_id in test_ids or (None,)
        ]
    for exported, _ in exported_roads:
        test = exported.test
        if test is not None and (conditions := as_text(test.candidate.conditions)):
            Log().print(
                f"Note: test {test.id} was driven with {conditions}, which the file does not say;"
                f" 'frenetic show {shell(source)} {test.id}' does",
                markup=False,
            )
    documents = []
    for exported, default_stem in exported_roads:
        if out is not None and str(out) == "-":
            # As bytes, since Windows would write other ends of lines.
            sys.stdout.buffer.write(road_writer.render(exported).encode("utf-8"))
            sys.stdout.buffer.flush()
            return
        path = out
        if path is None:
            path = default_stem.with_name(default_stem.name + road_writer.suffix)
        if path.exists() and source.exists() and path.samefile(source):
            raise click.UsageError(f"{path} is the road itself: choose another place with --out")
        write_road(exported, name, path)
        documents.append({"file": str(path), "format": name})
    if as_json:
        echo(json.dumps(documents if len(test_ids) > 1 else documents[0]))
    for document in () if as_json else documents:
        echo(document["file"])


def _name_of_roads(roads: str) -> str:
    """Return IDs of a map's roads for a file's name, other roads with another text."""
    name = re.sub(r"[^\w.]+", "-", roads)
    if '"' not in roads and len(name) <= _MAX_ROADS_IN_NAME:
        return name
    digest = hashlib.sha256(roads.encode()).hexdigest()[:8]
    return f"{name[:_MAX_ROADS_IN_NAME].strip('-')}-{digest}"


def _exported(
    source: Path,
    test_id: int | None,
    options: dict[str, Any],
    *,
    lane: int | None,
    roads: str | None,
) -> tuple[ExportedRoad, Path]:
    """Return a road for export, and the default path of its file without the suffix.

    Args:
        source: folder of a campaign, or a road file.
        test_id: ID of a campaign's test, or of a test in the file; None for the file's only road.
        options: options of the format.
        lane: ID of an OpenDRIVE lane; None for the usual lane.
        roads: IDs of roads of a map, as ``--road`` takes them; None for other files.
    """
    from frenetic.export import ExportedRoad

    if test_id is None or source.is_file():
        from frenetic.road.files import read_road

        file = read_road(source, lane=lane, roads=roads, test=test_id)
        for note in file.notes:
            Log().print(f"Note: {note}", markup=False)
        name = source.stem
        if roads is not None:
            name += f"-{_name_of_roads(roads)}"
        if test_id is not None:
            name += f"-{test_id}"
        return ExportedRoad(file.road(), name, **options), source.with_name(name)
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.record import file_stem
    from frenetic.simulators.conditions import rules_in

    with CampaignStore.open(source) as store:
        test = store.test(test_id)
        rules = rules_in(test.candidate.conditions, store.setting.rules)
    stem = file_stem(test_id)
    exported = ExportedRoad(test.road, stem, rules, test=test, **options)
    return exported, source / EXPORTS / stem
