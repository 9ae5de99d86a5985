"""The command that shortens failing roads: minimise."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import chdir
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli import complain, echo
from frenetic.cli.console import Log, print_facts, shell, this_command
from frenetic.cli.entries import CommandOptions, part_options, trust_option
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
    from frenetic.campaign import Event, Test
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
    """The campaign's test, if it is one's."""


@click.command()
@source_arguments
@count_option("--top", "Minimise a campaign's N most telling failures. [default: the first]")
@count_option("--max-drives", "Drives to spend on each road at most.", default=500)
@file_option(
    "--out",
    "Where the road goes. [default: CAMPAIGN/minimised/test-ID.json, or test-ID-other.json if other"
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
    from frenetic.report.minimised import minimised_document, write_minimised
    from frenetic.rerun.minimise import minimise as minimised_road
    from frenetic.rerun.minimise import minimise_test
    from frenetic.rerun.rerun import campaign_tester

    options = CommandOptions.of(context)
    if source.is_dir():
        spec, folder, works = _of_campaign(options, source, test_ids, top, out)
        with CampaignStore.open(source) as store, chdir(folder):
            tester = campaign_tester(store, spec)
    elif test_ids or top is not None:
        raise click.UsageError(f"{source} is no folder: an ID or --top needs that of a campaign")
    else:
        spec, folder, works = _of_file(options, source, out)
        with as_usage_error(), chdir(folder):
            tester = RoadTester.of(spec)
    for work in works:  # before hours are spent on what cannot be written
        work.files.prepare()

    how: dict[str, Any] = {"max_drives": max_drives, "isolate": True}

    def minimised_of(work: Work, on_event: Callable[[Event], None]) -> Minimised:
        if work.test is None:
            return minimised_road(work.road, tester, **how, on_event=on_event)
        kept = None if out is None else out.parent
        return minimise_test(
            source, work.test, tester, **how, drives_folder=kept, on_event=on_event
        )

    log, documents, left, failed = Log(), [], list(works), False
    is_interrupted = False
    while left and not is_interrupted:
        work = left.pop(0)
        test_id = None if work.test is None else work.test.id
        try:
            with shown_driving(log, f"Minimising {work.name}", max_drives) as on_event:
                minimised = minimised_of(work, on_event)
            document = minimised_document(minimised, tester, test_id)
            with log.status(f"Drawing {work.name}"):
                write_minimised(minimised, work.files, document, name=work.name)
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
    if is_interrupted and left:
        which = ", ".join(work.name.removeprefix("Test ") for work in left)
        raise interrupted(log, f"{counted(len(left), 'failure')} not begun: {which}")
    if is_interrupted and not source.is_dir():
        begin = f"the drives on a ROAD file are not kept; begin again: {this_command()}"
        log.print(f"Interrupted: {begin}", markup=False)
        raise click.exceptions.Exit(130)
    if is_interrupted:
        raise interrupted(log, "smaller roads may be found")
    if failed:
        raise click.exceptions.Exit(2)


def _of_campaign(
    options: CommandOptions,
    folder: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    out: Path | None,
) -> tuple[Spec, Path, list[Work]]:
    """Terms of a campaign's drives, the folder of its code, and the tests to minimise."""
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
            left = without(record.candidate.conditions, *options.quantities(spec))
            test = replace(record, candidate=replace(record.candidate, conditions=left))
            files = MinimisedFiles.beside(out or road)
            works.append(Work(f"Test {record.id}", record.road, files, test))
    if not works:
        raise click.UsageError(f"{folder} holds no failing road: there is nothing to minimise")
    return spec, place, works


def _of_file(
    options: CommandOptions, path: Path, out: Path | None
) -> tuple[Spec, Path, list[Work]]:
    """The same for a road file and the options given with it."""
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
    """Drives that the command made, and those of earlier commands for the same road."""
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
