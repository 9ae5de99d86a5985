"""The command that compares generators: bench."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from msgspec import structs

from frenetic.cli.compare import comparison_document, print_comparison
from frenetic.cli.console import Log, announced_compilation, live_line, print_table, shell
from frenetic.cli.options import (
    WORKERS,
    as_usage_error,
    count_option,
    folder_option,
    json_option,
    objective_option,
)
from frenetic.cli.parts import (
    AS,
    as_option,
    given_options,
    names_of,
    part_choices,
    was_given,
    with_given,
)
from frenetic.errors import FreneticError
from frenetic.spec import drive_options

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison
    from frenetic.bench import Bench, BenchProgress, RunState

_ENTRIES: Final = ("generator", "strategy", "simulations", "repeats", "seed")
"""Options that are entries of a file, too, beside those that say how roads are driven."""


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False, metavar="[FILE.toml]")
@click.option(
    "--generator",
    multiple=True,
    metavar="GENERATOR",
    help="A generator: package.module:Class, file.py:Class or one that --list lists. With options:"
    " path=DIR of its modules, copy=DIR for each run to work in, pipeline=DIR of the competition's"
    " modules if they are not around it, python=FILE to run it, name=N in tables. May be repeated.",
)
@click.option(
    "--strategy",
    multiple=True,
    metavar="STRATEGY",
    shell_complete=names_of("strategy"),
    help="A search strategy: frenetic-2021,threshold=-0.2. May be repeated. [default: all built-in"
    " ones]",
)
@count_option("--simulations", "Budget of each run, in drives. [default: 200]")
@count_option("--repeats", "Runs of each. [default: 10]")
@count_option("--seed", "Of the first run of each. [default: 1]", least=0)
@as_option
@part_choices
@objective_option
@click.option(
    "--workers",
    type=WORKERS,
    metavar="N",
    help="Runs at once. [default: the cores]",
)
@folder_option("Folder for the results. [default: a new one under benches/]")
@click.option("--resume", is_flag=True, help="Complete the bench in --out.")
@click.option(
    "--list",
    "as_list",
    is_flag=True,
    help="List the bench in --out; alone, published generators.",
)
@json_option
@click.pass_context
def bench(
    context: click.Context,
    /,
    file: Path | None,
    workers: int | None,
    out: Path | None,
    resume: bool,
    as_list: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Compare road generators on the same driver, with repeats.

    Generators of the SBST/SBFT competition's pipeline run unmodified, each run in its own process
    and folder, beside our strategies. Every run is a campaign with a folder for the competition's
    tools. FILE.toml says what the options say and more, such as time, seconds_per_test,
    count_computing, patience and speed_limit; bench.toml in every bench's folder is one.
    Options given beside it win.
    """
    from frenetic.bench import Bench

    if as_list and out is None:
        _refuse_given(context, "--list without --out lists the published generators")
        _list_recipes(as_json)
        return
    if (resume or as_list) and out is None:
        raise click.UsageError("--resume needs the folder of a bench: add --out DIR")
    if resume or as_list:
        assert out is not None
        _refuse_given(context, "the bench goes on as it was begun")
        with as_usage_error():
            the_bench = Bench.open(out)
    else:
        the_bench, of_file = _begun(context, file, out)
        workers = workers or of_file
    if as_list:
        _list_runs(the_bench.states(), as_json)
        return
    _run(the_bench, resume, workers, as_json)


def _begun(context: click.Context, path: Path | None, out: Path | None) -> tuple[Bench, int | None]:
    """The bench of a command line, and the workers that its file wants."""
    from frenetic.bench import BenchFile, new_folder
    from frenetic.bench.entrants import require_trusted
    from frenetic.run_file import read_file

    given = {n: context.params[n] for n in _ENTRIES if was_given(context, n)}
    if {"generator", "strategy"} & given.keys():  # in the place of all that the file names
        given |= {kind: context.params[kind] for kind in ("generator", "strategy")}
    driving, objective = given_options(context), context.params["objective"]
    entries = BenchFile()
    spec = entries.spec()
    if path is not None:
        spec, entries = read_file(path, BenchFile, "a bench")
    named = [*driving, *(("driver", "simulator") if AS in driving else ())]
    if was_given(context, "objective"):
        spec, named = replace(spec, objective=objective), [*named, "objective"]
    if path is not None:
        spec.require_trusted(path, named)
    if "simulations" in given:
        given["time"] = None
    entries = structs.replace(entries, **given)
    with as_usage_error():
        if path is not None:
            require_trusted(entries.entrants(), path, [*given])
        folder = new_folder() if out is None else out
        spec = with_given(spec, driving, has_roads=False).with_limit()
        return entries.bench(spec, folder), entries.workers


def _refuse_given(context: click.Context, why: str) -> None:
    """Refuses what begins a bench."""
    for parameter in context.command.params:
        name = parameter.name or ""
        if name in ("file", AS, "objective", *_ENTRIES, *drive_options()) and was_given(
            context, name
        ):
            raise click.UsageError(f"{parameter.opts[0]} cannot be given here: {why}")


def _run(the_bench: Bench, resume: bool, workers: int | None, as_json: bool) -> None:
    from frenetic.campaign.workers import available_cores
    from frenetic.simulators.capabilities import capabilities

    log = Log()
    names = ", ".join(entrant.name for entrant in the_bench.entrants)
    terms = the_bench.terms

    def ended(end: RunState) -> None:
        if end.ending is None or end.ending.end not in ("over", "returned"):
            log.print(f"{end.run.name}: {end.trouble or end.ending}", markup=False)

    with announced_compilation(log) as compiled:

        def started() -> None:
            compiled()
            log.print(
                f"{the_bench.runs_in_words} each of {names}, results in {the_bench.folder}",
                markup=False,
            )

        def progress(now: BenchProgress) -> None:
            show(now.share, lambda: now.in_words(time.monotonic() - start))

        start = time.monotonic()
        with live_line(log) as show, _go_on_line(the_bench):
            ends = the_bench.run(
                resume=resume,
                workers=workers or capabilities(terms.simulator).usual_workers or available_cores(),
                on_start=started,
                on_progress=progress,
                on_end=ended,
                on_interrupt=log.stopping,
            )
    _show_results(the_bench, ends, log, as_json)


@contextmanager
def _go_on_line(the_bench: Bench) -> Iterator[None]:
    """Says how to resume after a second Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        click.echo(f"Go on: {_resume_line(the_bench)}", err=True)
        raise


def _resume_line(the_bench: Bench) -> str:
    return f"frenetic bench --resume --out {shell(the_bench.folder)}"


def _show_results(the_bench: Bench, ends: Sequence[RunState], log: Log, as_json: bool) -> None:
    """Compares the entrants; prints and writes the comparison."""
    states = the_bench.states()
    comparison: Comparison | None = None
    page: Path | None = None
    if any(state.ending is not None for state in states):
        from frenetic.bench.results import write_results

        with log.status("Comparing"):
            comparison = the_bench.comparison()
        for note in comparison.notes:
            log.print(f"Note: {note}", markup=False)
        with log.status("Writing the page"):
            page = write_results(the_bench, comparison)
    if as_json:
        groups = {} if comparison is None else comparison_document(comparison)
        click.echo(json.dumps({**groups, "runs": [state.as_json() for state in states]}))
    else:
        if comparison is not None:
            print_comparison(comparison)
        else:
            _print_runs(states)
        if page is not None:
            click.echo(f"Page:    {page}")
        click.echo(f"Results: {the_bench.folder}")
    _end(the_bench, ends, states)
    runs = () if comparison is None else comparison.groups.values()
    if not any(run.simulations > run.counts.errors for group in runs for run in group):
        raise click.exceptions.Exit(1)


def _end(the_bench: Bench, ends: Sequence[RunState], states: Sequence[RunState]) -> None:
    """Says what is left to do, if anything."""
    missing = sum(state.ending is None for state in states)
    if not missing:
        return
    again = _resume_line(the_bench)
    if troubles := [f"{end.run.name}: {end.trouble}" for end in ends if end.trouble]:
        raise FreneticError(
            f"{missing} of {len(states)} runs could not be completed ({troubles[0]}); try again:"
            f" {again}"
        )
    click.echo(f"{missing} of {len(states)} runs are missing; go on: {again}", err=True)
    raise click.exceptions.Exit(130)


def _print_runs(states: Sequence[RunState]) -> None:
    print_table(
        ("generator", ">run", ">seed", "state", "folder"),
        [
            (run.entrant.name, run.repeat, run.seed, state.ending or "to do", run.folder)
            for state in states
            for run in (state.run,)
        ],
    )


def _list_recipes(as_json: bool) -> None:
    from frenetic.bench import RECIPES

    if as_json:
        click.echo(json.dumps([one.as_json() for one in RECIPES.values()]))
        return
    print_table(
        ("generator", "files of", "needs"),
        [(one.name, one.source, one.needs or "") for one in RECIPES.values()],
    )
    click.echo("Take part: --generator NAME,path=FOLDER,python=INTERPRETER")


def _list_runs(states: Sequence[RunState], as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps([state.as_json() for state in states]))
        return
    _print_runs(states)
    done = Counter(state.ending is not None for state in states)
    click.echo(f"{done[True]} of {len(states)} runs are complete")
    if done[False]:
        folder = states[0].run.folder.parent.parent
        click.echo(f"Go on: frenetic bench --resume --out {shell(folder)}")
