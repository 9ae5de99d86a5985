"""The command that shortens failing roads: minimise."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import click

from frenetic._support.words import counted
from frenetic.cli import complain
from frenetic.cli.again import chosen_tests, file_spec, interrupted, recorded_spec
from frenetic.cli.console import (
    Log,
    announced_compilation,
    live_line,
    print_facts,
    print_table,
    shell,
)
from frenetic.cli.options import (
    as_usage_error,
    count_option,
    file_option,
    json_option,
    source_arguments,
)
from frenetic.cli.parts import given_options, given_quantities, part_options
from frenetic.errors import FreneticError
from frenetic.quantities import without
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.again.minimise import Minimised
    from frenetic.campaign import Event, RoadTester, Test
    from frenetic.report.minimised import MinimisedFiles
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

    @property
    def test_id(self) -> int | None:
        """Id of the test; None for a road file."""
        return None if self.test is None else self.test.id

    @property
    def repeat(self) -> str:
        """The command line that drives the minimised road again."""
        return f"frenetic drive {shell(self.files.road)}"


Done: TypeAlias = tuple[Work, "Minimised"]


@click.command()
@source_arguments
@count_option("--top", "Minimise a campaign's N most telling failures. [default: the first]")
@count_option("--max-drives", "Drives to spend on each road at most.", default=500)
@click.option(
    "--guard",
    type=click.FloatRange(0.0, 1.0, max_open=True),
    default=0.02,
    show_default=True,
    metavar="SHARE",
    help="Keep a road only if it fails with all curvatures this much smaller and larger, too, once"
    " one does; 0 is no such guard.",
)
@file_option(
    "--out",
    "Where the road goes. [default: CAMPAIGN/minimised/test-ID.json, or test-ID-other.json if other"
    " parts than the campaign's drive it; beside ROAD with the suffix .min.json]",
)
@part_options
@json_option
@click.pass_context
def minimise(
    context: click.Context,
    /,
    source: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    max_drives: int,
    guard: float,
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
    from frenetic.again.rerun import campaign_tester
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.report.minimised import minimised_document, write_minimised

    if source.is_dir():
        spec, works = _of_campaign(context, source, test_ids, top, out)
    elif test_ids or top is not None:
        raise click.UsageError(f"{source} is no folder: an ID or --top needs that of a campaign")
    else:
        spec, works = _of_file(context, source, out)
    driver, simulator = spec.make_parts(isolate=True)
    if source.is_dir():
        with CampaignStore.open(source) as store:
            tester = campaign_tester(store, simulator, driver)
    else:
        with as_usage_error():
            tester = RoadTester.on(spec, simulator, driver)
    for work in works:  # before hours are spent on what cannot be written
        work.files.prepare()

    done: list[Done] = []
    left = works
    failed = is_interrupted = False
    log = Log()
    with announced_compilation(log) as compiled:
        for number, work in enumerate(works, start=1):
            try:
                how = {"max_drives": max_drives, "guard": guard}
                kept = None if out is None else out.parent
                minimised = _minimise(work, tester, source, kept, how, log, compiled)
                document = minimised_document(minimised, tester, spec, work.test_id)
                with log.status(f"Drawing {work.name}"):
                    write_minimised(minimised, work.files, document, name=work.name)
            except FreneticError as error:
                if len(works) == 1:
                    raise
                complain(f"{work.name}: {error}")
                failed = True
            else:
                done.append((work, minimised))
                is_interrupted = minimised.ending == "stopped" and minimised.trouble is None
            left = works[number:]
            if is_interrupted:
                break
    if as_json:
        click.echo(json.dumps([_as_json(*item) for item in done]))
    elif len(works) == 1:
        _print_one(*done[0])
    elif done:
        _print_many(done)
    if is_interrupted:
        if left:
            which = ", ".join(str(work.test_id) for work in left)
            raise interrupted(log, f"{counted(len(left), 'failure')} not begun: {which}")
        raise click.exceptions.Exit(130)
    if failed:
        raise click.exceptions.Exit(2)


def _of_campaign(
    context: click.Context,
    folder: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    out: Path | None,
) -> tuple[Spec, list[Work]]:
    """Terms of a campaign's drives, and the tests to minimise."""
    from frenetic.campaign import CampaignStore
    from frenetic.outcome import Outcome
    from frenetic.report.minimised import MinimisedFiles, minimised_road

    given = given_options(context)
    if out is not None and (len(test_ids) > 1 or (top or 1) > 1):
        raise click.UsageError("--out is for one road: leave it out where there are several")
    with CampaignStore.open(folder) as store:
        spec = recorded_spec(store, given)
        chosen = chosen_tests(store, test_ids, top if test_ids else top or 1)
        records = [store.test(test_id) for test_id in chosen or ()]
        works = []
        for record in records:
            number = record.candidate.id
            if record.outcome is not Outcome.FAIL:
                raise click.UsageError(
                    f"test {number} is {record.outcome}: only a failing road can be minimised"
                )
            road = minimised_road(folder, number)
            if given:
                road = road.with_stem(f"{road.stem}-other")
            files = MinimisedFiles.beside(out or road)
            left = without(record.candidate.conditions, *given_quantities(spec, given))
            test = replace(record, candidate=replace(record.candidate, conditions=left))
            works.append(Work(f"Test {number}", record.road, files, test))
    if not works:
        raise click.UsageError(f"{folder} holds no failing road: there is nothing to minimise")
    return spec, works


def _of_file(context: click.Context, path: Path, out: Path | None) -> tuple[Spec, list[Work]]:
    """The same for a road file and the options given with it."""
    from frenetic.report.minimised import MinimisedFiles
    from frenetic.road.files import read_road

    file = read_road(path)
    spec, road = file_spec(context, file), file.road()
    target = out or path.with_name(f"{path.name.removesuffix('.json')}.min.json")
    if target.exists() and target.samefile(path):
        raise click.UsageError(f"{target} is the road itself: choose another place with --out")
    works = [Work(path.name, road, MinimisedFiles.beside(target))]
    return replace(spec, lane_width=road.lane_width), works


def _minimise(
    work: Work,
    tester: RoadTester,
    source: Path,
    kept: Path | None,
    how: dict[str, Any],
    log: Log,
    compiled: Callable[[], None],
) -> Minimised:
    """Minimises one road and shows the progress."""
    from frenetic.again.minimise import minimise, minimise_test

    with _live(log, work, how["max_drives"]) as show, as_usage_error():

        def on_event(event: Event) -> None:
            if event.kind == "started":
                compiled()
            elif event.kind == "interrupted":
                log.print("Stopping after this drive; press Ctrl-C again to leave at once.")
            else:
                show(event)

        if work.test is None:
            return minimise(work.road, tester, **how, on_event=on_event)
        minimised = minimise_test(source, work.test, tester, kept=kept, **how, on_event=on_event)
    if is_another(minimised):
        log.print(
            f"{work.name} is a different failure than recorded ({minimised.match}):"
            f" {minimised.original.reason}, not: {work.test.reason}",
            markup=False,
        )
    return minimised


@contextmanager
def _live(log: Log, work: Work, max_drives: int) -> Iterator[Callable[[Event], None]]:
    """Shows the progress of a road."""

    def text(event: Event) -> str:
        notes = {} if event.test is None else event.test.candidate.notes
        smaller = (
            f", {work.road.length:.0f} m -> {notes['length']:.0f} m, curves {notes['curves']},"
            f" {notes['pass']}"
            if notes
            else ""
        )
        drives = event.summary.simulations
        return f"{work.name}: drive {drives} of at most {max_drives}{smaller}"

    with live_line(log) as show:
        yield lambda event: show(event.summary.budget_spent, lambda: text(event))


def is_another(minimised: Minimised) -> bool:
    """Whether the original now has another failure than its campaign recorded."""
    from frenetic.campaign.repeat import Match

    return minimised.match not in (None, Match.SAME, Match.SAME_PLACE)


def _ending(minimised: Minimised) -> str:
    """Reason for the end of minimising, for people."""
    trouble = minimised.trouble
    return ENDINGS[minimised.ending] if trouble is None else f"gave up: {trouble}"


def _print_one(work: Work, minimised: Minimised) -> None:
    before, after = minimised.shapes
    click.echo(
        f"{work.name}: {before.length:.0f} m -> {after.length:.0f} m,"
        f" {counted(before.curves, 'curve')} -> {after.curves},"
        f" {counted(minimised.drives, 'drive')}, {_ending(minimised)}"
    )
    if minimised.note:
        click.echo(minimised.note)
    print_facts(
        [
            ("fails", minimised.smallest.reason),
            *([("conditions", text)] if (text := minimised.conditions_in_words()) else []),
            ("failure", _failure(minimised)),
            ("curvatures", " ".join(f"{v:g}" for v in after.values)),
            ("road", str(work.files.road)),
            ("picture", str(work.files.picture)),
            ("compared", str(work.files.comparison)),
            ("repeat", work.repeat),
        ]
    )


def _failure(minimised: Minimised) -> str:
    """How the failure of the smallest road is like that of the original, in words."""
    from frenetic.analysis.failures import THRESHOLD

    if (fault := minimised.smallest.result.fault) is not None:
        return f"the original's: the driver {fault}"
    text = f"the original's, {minimised.difference:.1f} m different; {THRESHOLD:g} m are allowed"
    if is_another(minimised):
        text += f"; not the one recorded: {minimised.match}"
    return text


def _print_many(done: list[Done]) -> None:
    rows = []
    for work, minimised in done:
        before, after = minimised.shapes
        rows.append(
            (
                work.test_id,
                f"{before.length:.0f} -> {after.length:.0f}",
                f"{before.curves} -> {after.curves}",
                minimised.drives,
                minimised.reason,
                f"{minimised.difference:.1f}",
                minimised.match,
                "yes" if minimised.ending == "minimal" else f"no, {_ending(minimised)}",
            )
        )
    numbers = (">test", ">length (m)", ">curves", ">drives", "reason", ">difference (m)")
    print_table((*numbers, "recorded", "minimal"), rows)
    different = len({(minimised.reason, minimised.shapes[1]) for _, minimised in done})
    come = f"{counted(len(done), 'failure')} {'comes' if len(done) == 1 else 'come'}"
    click.echo(f"{come} down to {counted(different, 'different road')}")
    if unguarded := [work.name for work, minimised in done if minimised.note]:
        click.echo(f"Not found to hold the guard: {', '.join(unguarded)}")
    first, _ = done[0]
    click.echo(f"Roads:       {first.files.road.parent}")
    click.echo(f"Repeat one:  {first.repeat}")


def _as_json(work: Work, minimised: Minimised) -> dict[str, Any]:
    files = work.files
    before, after = minimised.shapes
    return {
        "name": work.name,
        "test": work.test_id,
        "reason": str(minimised.reason),
        "description": minimised.smallest.reason,
        "length_before": before.length,
        "length": after.length,
        "curves_before": before.curves,
        "curves": after.curves,
        "drives": minimised.drives,
        "ending": str(minimised.ending),
        "trouble": minimised.trouble,
        "guard": minimised.guard,
        "note": minimised.note,
        "difference": minimised.difference,
        "match": minimised.match,
        "step": after.step,
        "curvatures": list(after.values),
        "conditions": dict(minimised.conditions),
        "passes": dict(minimised.passes),
        "road": str(files.road),
        "picture": str(files.picture),
        "comparison": str(files.comparison),
        "repeat": work.repeat,
        "improvements": [
            {
                "pass": found.by,
                "drives": found.trials,
                "length": found.shape.length,
                "curves": found.shape.curves,
            }
            for found in minimised.improvements
        ],
    }
