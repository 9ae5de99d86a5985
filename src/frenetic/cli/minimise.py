"""The command `minimise`, which shortens failing roads."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import chdir
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli import INTERRUPTED, complain, echo
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
"""Reason why minimising stopped -> words."""


@dataclass(frozen=True)
class RoadToMinimise:
    """A failing road to be minimised."""

    name: str
    """Text that names the road for the user, such as ``Test 12`` or ``road.json``."""
    road: Road
    files: MinimisedFiles
    """Paths of the minimised road and its pictures."""
    test: Test | None = None
    """The test of a campaign; None for a road file."""


@click.command()
@source_arguments()
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

    The tests of a CAMPAIGN are driven as the campaign drove them unless options change that; a ROAD
    file is driven as by 'frenetic drive'. Each minimised road becomes a file, beside a picture of
    its drive and a picture of the road before and after. A failure is the same if its reason and
    cause are, and if road, offsets and speeds before it differ by at most 2 m, as within one
    distinct failure. Ctrl-C keeps the smallest road so far. For a campaign's test the same command
    continues after Ctrl-C, and shows the result once it is complete.
    """
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.rerun.rerun import campaign_tester

    options = CommandOptions.of(context)
    if source.is_dir():
        spec, code_folder, targets = _roads_of_campaign(options, source, test_ids, top, out)
        with CampaignStore.open(source) as store, chdir(code_folder):
            tester = campaign_tester(store, spec)
    elif test_ids or top is not None:
        raise click.UsageError(f"{source} is no folder: an ID or --top needs a campaign's folder")
    else:
        spec, code_folder, targets = _road_of_file(options, source, out)
        with as_usage_error(), chdir(code_folder):
            tester = RoadTester.of(spec)
    for target in targets:  # a file that cannot be written is refused before hours of drives
        target.files.prepare()

    drives_folder = None if out is None else out.parent
    log, documents, remaining = Log(), [], list(targets)
    has_error = is_interrupted = False
    while remaining and not is_interrupted:
        target = remaining.pop(0)
        try:
            minimised = _minimise(target, tester, log, max_drives, source, drives_folder)
        except FreneticError as error:
            if len(targets) == 1 or isinstance(error, CampaignGoneError):
                raise
            complain(f"{target.name}: {error}")
            has_error = True
            continue
        is_interrupted = minimised.stop_reason == "stopped" and minimised.error is None
        if as_json:
            documents.append(_as_json(target, minimised))
        else:
            _print(target, minimised)
    if as_json:
        echo(json.dumps(documents))
    if is_interrupted:
        raise _interrupted(log, remaining, source)
    if has_error:
        raise click.exceptions.Exit(2)


def _minimise(
    target: RoadToMinimise,
    tester: RoadTester,
    log: Log,
    max_drives: int,
    source: Path,
    drives_folder: Path | None,
) -> Minimised:
    """Minimise a failing road, and write the road and its pictures.

    Args:
        target: the road.
        tester: drives roads on the terms of the failure.
        log: the console for progress.
        max_drives: most drives to spend.
        source: folder of the campaign, or the road file.
        drives_folder: folder for the drives on a campaign's test; None for the default.
    """
    from frenetic.report.minimised import minimised_document, write_minimised
    from frenetic.rerun.minimise import minimise as minimise_road
    from frenetic.rerun.minimise import minimise_test

    test = target.test
    with shown_driving(log, f"Minimising {target.name}", max_drives) as on_event:
        if test is None:
            minimised = minimise_road(
                target.road, tester, max_drives=max_drives, isolate=True, on_event=on_event
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
    with log.status(f"Drawing {target.name}"):
        write_minimised(minimised, target.files, document, name=target.name)
    return minimised


def _interrupted(
    log: Log, remaining: Sequence[RoadToMinimise], source: Path
) -> click.exceptions.Exit:
    """Print what is left to do after Ctrl-C, and which command continues; return the exit."""
    if remaining:
        test_ids = ", ".join(target.name.removeprefix("Test ") for target in remaining)
        return interrupted(log, f"{counted(len(remaining), 'failure')} not begun: {test_ids}")
    if not source.is_dir():
        text = f"the drives on a ROAD file are not kept; begin again: {this_command()}"
        log.print(f"Interrupted: {text}", markup=False)
        return click.exceptions.Exit(INTERRUPTED)
    return interrupted(log, "smaller roads may be found")


def _roads_of_campaign(
    options: CommandOptions,
    folder: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    out: Path | None,
) -> tuple[Spec, Path, list[RoadToMinimise]]:
    """Return the spec of a campaign's drives, the folder of its code, and the roads to minimise.

    Raises:
        click.UsageError: a test did not fail, or ``--out`` is for one of several roads.
        CampaignError: the campaign cannot be read, or holds no such test.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.oracle.outcome import Outcome
    from frenetic.report.minimised import MinimisedFiles
    from frenetic.rerun.minimised_roads import minimised_road

    if out is not None and (len(test_ids) > 1 or (top or 1) > 1):
        raise click.UsageError("--out is for one road: leave it out where there are several")
    with CampaignStore.open(folder) as store:
        spec, code_folder = campaign_spec(store, options)
        chosen = chosen_tests(store, test_ids, top if test_ids else top or 1)
        targets = []
        for recorded in [store.test(test_id) for test_id in chosen or ()]:
            if recorded.outcome is not Outcome.FAIL:
                raise click.UsageError(
                    f"test {recorded.id} is {recorded.outcome}: only a failing road can be"
                    " minimised"
                )
            path = minimised_road(folder, recorded.id)
            if options:  # the failure may be another than the campaign's
                path = path.with_stem(f"{path.stem}-other")
            conditions = without(
                recorded.candidate.conditions, *options.overridden_conditions(spec)
            )
            test = replace(recorded, candidate=replace(recorded.candidate, conditions=conditions))
            files = MinimisedFiles.beside(out or path)
            targets.append(RoadToMinimise(f"Test {test.id}", test.road, files, test))
    if not targets:
        raise click.UsageError(f"{folder} holds no failing road: there is nothing to minimise")
    return spec, code_folder, targets


def _road_of_file(
    options: CommandOptions, path: Path, out: Path | None
) -> tuple[Spec, Path, list[RoadToMinimise]]:
    """Return the spec of a road file's drives, the folder of its code, and the only road.

    Raises:
        click.UsageError: ``--out`` names the road file itself.
        RoadError: the file holds no road.
    """
    from frenetic.report.minimised import MinimisedFiles
    from frenetic.road.files import read_road

    file = read_road(path)
    (spec, code_folder), road = file_spec(options, file), file.road()
    new_file = out or path.with_name(f"{path.name.removesuffix('.json')}.min.json")
    if new_file.exists() and new_file.samefile(path):
        raise click.UsageError(f"{new_file} is the road itself: choose another place with --out")
    targets = [RoadToMinimise(path.name, road, MinimisedFiles.beside(new_file))]
    return Spec.of(spec, {"lane_width": road.lane_width}), code_folder, targets


def _print(target: RoadToMinimise, minimised: Minimised) -> None:
    """Print how much shorter a road became, why it fails, and how to drive it."""
    from frenetic.campaign.second_drive import Match

    before, after = minimised.shapes
    ending = ENDINGS[minimised.stop_reason]
    if minimised.error is not None:
        ending = f"gave up: {minimised.error}"
    echo(
        f"{target.name}: {before.length:.0f} m -> {after.length:.0f} m,"
        f" {counted(before.curves, 'curve')} -> {after.curves},"
        f" {_drives_text(minimised)}, {ending}"
    )
    notes = []
    if minimised.match not in (None, Match.SAME, Match.SAME_PLACE):
        notes.append(f"it is not the failure that the campaign recorded: {minimised.match}")
    if not minimised.is_guarded:
        notes.append("a slight change makes it pass: all curvatures 2 % smaller or larger")
    print_facts(
        [
            ("fails", minimised.smallest.reason),
            ("conditions", minimised.conditions_text()),
            *(("note", note) for note in notes),
            ("curvatures", " ".join(f"{value:g}" for value in after.values)),
            ("compared", str(target.files.comparison)),
            ("repeat", f"frenetic drive {shell(target.files.road)}"),
        ]
    )


def _drives_text(minimised: Minimised) -> str:
    """Return how many drives this command made, and how many earlier commands made."""
    text = counted(minimised.new_drives, "drive")
    earlier = minimised.drives - minimised.new_drives
    return f"{text} now, {earlier} before" if earlier else text


def _as_json(target: RoadToMinimise, minimised: Minimised) -> dict[str, Any]:
    """Return a minimised road as a JSON object."""
    before, after = minimised.shapes
    return {
        "name": target.name,
        "test": None if target.test is None else target.test.id,
        "reason": str(minimised.reason),
        "length_before": before.length,
        "length": after.length,
        "drives": minimised.drives,
        "new_drives": minimised.new_drives,
        "ending": str(minimised.stop_reason),
        "trouble": minimised.error,
        "match": minimised.match,
        "conditions": dict(minimised.conditions),
        "road": str(target.files.road),
    }
