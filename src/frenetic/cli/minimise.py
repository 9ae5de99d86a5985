"""The command that shortens failing roads: minimise."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import chdir
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli import complain, echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, print_facts, shell, this_command
from frenetic.cli.entries import part_options, trust_option
from frenetic.cli.options import (
    as_usage_error,
    count_option,
    file_option,
    json_option,
    source_arguments,
)
from frenetic.cli.rerun_options import (
    campaign_spec,
    chosen_tests,
    file_spec,
    interrupted,
    shown_driving,
)
from frenetic.conditions.condition import without
from frenetic.errors import CampaignGoneError, FreneticError
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester, Test
    from frenetic.report.minimised import MinimisedFiles
    from frenetic.rerun.minimise import Minimised
    from frenetic.road import Road

ENDINGS: Final = {
    "minimal": "nothing smaller was found to fail",
    "spent": "all drives are spent",
    "stopped": "interrupted",
}


@dataclass(frozen=True)
class Work:
    """A failing road to be minimised."""

    name: str
    road: Road
    files: MinimisedFiles
    test: Test | None = None
    """The test of a campaign; None for a road file."""


@click.command()
@source_arguments
@count_option("--top", "Minimise a campaign's N most telling failures. [default: the first]")
@count_option("--max-drives", "Drives to spend on each road at most.", default=500)
@file_option(
    "--out",
    "File for the road. [default: CAMPAIGN/minimised/test-ID.json, or test-ID-other.json if other"
    " parts than the campaign's drive it; beside ROAD with the suffix .min.json]",
)
@part_options
@trust_option
@json_option
@click.pass_context
def minimise(
    context: click.Context,
    /,
    source: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    max_drives: int,
    out: Path | None,
    as_json: bool,
    **_: Any,
) -> None:
    """Reduce failing roads to the shortest and plainest ones that still have the same failure.

    The tests of a CAMPAIGN are driven as it drove them unless options change that; a ROAD file is
    driven as by 'frenetic drive'. Each road becomes a file, beside a picture of its drive and one
    of before and after. The failure is the same if reason and cause are, and road, offsets and
    speeds before it differ by at most 2 m, as within one distinct failure. Ctrl-C keeps the
    smallest road found so far; the same command goes on with a campaign's test, and shows a
    complete one.
    """
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.rerun.rerun import campaign_tester

    options = CommandOptions.of(context)
    if source.is_dir():
        spec, folder, works = _of_campaign(options, source, test_ids, top, out)
        with CampaignStore.open(source) as store, chdir(folder):
            tester = campaign_tester(store, spec)
    elif test_ids or top is not None:
        raise click.UsageError(f"{source} is no folder: an ID or --top needs a campaign's folder")
    else:
        spec, folder, works = _of_file(options, source, out)
        with as_usage_error(), chdir(folder):
            tester = RoadTester.of(spec)
    for work in works:  # before hours are spent on what cannot be written
        work.files.prepare()

    drives_folder = None if out is None else out.parent
    log, documents, left, failed = Log(), [], list(works), False
    is_interrupted = False
    while left and not is_interrupted:
        work = left.pop(0)
        try:
            minimised = _minimise(work, tester, log, max_drives, source, drives_folder)
        except FreneticError as error:
            if len(works) == 1 or isinstance(error, CampaignGoneError):
                raise
            complain(f"{work.name}: {error}")
            failed = True
            continue
        is_interrupted = minimised.stop_reason == "stopped" and minimised.error is None
        if as_json:
            documents.append(_as_json(work, minimised))
        else:
            _print(work, minimised)
    if as_json:
        echo(json.dumps(documents))
    if is_interrupted:
        raise _interrupted(log, left, source)
    if failed:
        raise click.exceptions.Exit(2)


def _minimise(
    work: Work,
    tester: RoadTester,
    log: Log,
    max_drives: int,
    source: Path,
    drives_folder: Path | None,
) -> Minimised:
    """Minimise a failing road, and write the road and its pictures.

    Args:
        work: the road.
        tester: drives roads on the terms of the failure.
        log: the console for progress.
        max_drives: most drives to spend.
        source: folder of the campaign, or the road file.
        drives_folder: folder for the drives on a campaign's test; None for the default.
    """
    from frenetic.report.minimised import minimised_document, write_minimised
    from frenetic.rerun.minimise import minimise as minimise_road
    from frenetic.rerun.minimise import minimise_test

    test = work.test
    with shown_driving(log, f"Minimising {work.name}", max_drives) as on_event:
        if test is None:
            minimised = minimise_road(
                work.road, tester, max_drives=max_drives, isolate=True, on_event=on_event
            )
        else:
            minimised = minimise_test(
                source,
                test,
                tester,
                max_drives=max_drives,
                isolate=True,
                drives_folder=drives_folder,
                on_event=on_event,
            )
    document = minimised_document(minimised, tester, None if test is None else test.id)
    with log.status(f"Drawing {work.name}"):
        write_minimised(minimised, work.files, document, name=work.name)
    return minimised


def _interrupted(log: Log, left: Sequence[Work], source: Path) -> click.exceptions.Exit:
    """Print what is left to do after Ctrl-C, and which command goes on; return the exit."""
    if left:
        which = ", ".join(work.name.removeprefix("Test ") for work in left)
        return interrupted(log, f"{counted(len(left), 'failure')} not begun: {which}")
    if not source.is_dir():
        begin = f"the drives on a ROAD file are not kept; begin again: {this_command()}"
        log.print(f"Interrupted: {begin}", markup=False)
        return click.exceptions.Exit(130)
    return interrupted(log, "smaller roads may be found")


def _of_campaign(
    options: CommandOptions,
    folder: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    out: Path | None,
) -> tuple[Spec, Path, list[Work]]:
    """Return the spec of a campaign's drives, the folder of its code, and the roads to minimise."""
    from frenetic.campaign import CampaignStore
    from frenetic.oracle.outcome import Outcome
    from frenetic.report.minimised import MinimisedFiles, minimised_road

    if out is not None and (len(test_ids) > 1 or (top or 1) > 1):
        raise click.UsageError("--out is for one road: leave it out where there are several")
    with CampaignStore.open(folder) as store:
        spec, place = campaign_spec(store, options)
        chosen = chosen_tests(store, test_ids, top if test_ids else top or 1)
        works = []
        for record in [store.test(test_id) for test_id in chosen or ()]:
            if record.outcome is not Outcome.FAIL:
                raise click.UsageError(
                    f"test {record.id} is {record.outcome}: only a failing road can be minimised"
                )
            road = minimised_road(folder, record.id)
            if options:
                road = road.with_stem(f"{road.stem}-other")
            left = without(record.candidate.conditions, *options.conditions(spec))
            test = replace(record, candidate=replace(record.candidate, conditions=left))
            files = MinimisedFiles.beside(out or road)
            works.append(Work(f"Test {record.id}", record.road, files, test))
    if not works:
        raise click.UsageError(f"{folder} holds no failing road: there is nothing to minimise")
    return spec, place, works


def _of_file(
    options: CommandOptions, path: Path, out: Path | None
) -> tuple[Spec, Path, list[Work]]:
    """Return the spec of a road file's drives, the folder of its code, and the road to minimise."""
    from frenetic.report.minimised import MinimisedFiles
    from frenetic.road.files import read_road

    file = read_road(path)
    (spec, folder), road = file_spec(options, file), file.road()
    target = out or path.with_name(f"{path.name.removesuffix('.json')}.min.json")
    if target.exists() and target.samefile(path):
        raise click.UsageError(f"{target} is the road itself: choose another place with --out")
    works = [Work(path.name, road, MinimisedFiles.beside(target))]
    return Spec.of(spec, {"lane_width": road.lane_width}), folder, works


def _print(work: Work, minimised: Minimised) -> None:
    from frenetic.campaign.second_drive import Match

    before, after = minimised.shapes
    trouble = minimised.error
    echo(
        f"{work.name}: {before.length:.0f} m -> {after.length:.0f} m,"
        f" {counted(before.curves, 'curve')} -> {after.curves},"
        f" {_drives(minimised)},"
        f" {ENDINGS[minimised.stop_reason] if trouble is None else f'gave up: {trouble}'}"
    )
    match = minimised.match
    notes = {
        f"it is not the failure that the campaign recorded: {match}": match
        not in (None, Match.SAME, Match.SAME_PLACE),
        "a slight change makes it pass: all curvatures 2 % smaller or larger": (
            not minimised.is_guarded
        ),
    }
    conditions = minimised.conditions_text()
    print_facts(
        [
            ("fails", minimised.smallest.reason),
            *([("conditions", conditions)] if conditions else []),
            *(("note", text) for text, is_so in notes.items() if is_so),
            ("curvatures", " ".join(f"{v:g}" for v in after.values)),
            ("compared", str(work.files.comparison)),
            ("repeat", f"frenetic drive {shell(work.files.road)}"),
        ]
    )


def _drives(minimised: Minimised) -> str:
    """Say how many drives this command made, and how many earlier commands made for the road."""
    text = counted(minimised.new_drives, "drive")
    earlier = minimised.drives - minimised.new_drives
    return f"{text} now, {earlier} before" if earlier else text


def _as_json(work: Work, minimised: Minimised) -> dict[str, Any]:
    before, after = minimised.shapes
    return {
        "name": work.name,
        "test": None if work.test is None else work.test.id,
        "reason": str(minimised.reason),
        "length_before": before.length,
        "length": after.length,
        "drives": minimised.drives,
        "new_drives": minimised.new_drives,
        "ending": str(minimised.stop_reason),
        "trouble": minimised.error,
        "match": minimised.match,
        "conditions": dict(minimised.conditions),
        "road": str(work.files.road),
    }
