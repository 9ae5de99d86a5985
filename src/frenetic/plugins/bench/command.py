"""The command ``frenetic bench``, which compares road generators.

The bench's modules are imported in functions, since they would slow down ``--help``.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click
from msgspec import structs, to_builtins

from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions, PartsSource
from frenetic.cli.compare import comparison_document, print_comparison
from frenetic.cli.console import (
    Log,
    TimeLeft,
    announced_compilation,
    live_line,
    print_table,
    shell,
)
from frenetic.cli.entries import (
    complete_names,
    entry_option,
    part_options,
    trust_option,
    was_given,
)
from frenetic.cli.option_types import DURATION_TYPE, WORKERS_TYPE
from frenetic.cli.options import as_usage_error, count_option, folder_option, json_option
from frenetic.errors import FreneticError
from frenetic.parts.trust import is_here

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison
    from frenetic.plugins.bench import Bench, RunState

_ENTRIES: Final = (
    *("generator", "strategy", "simulations", "kilometres", "simulated_time"),
    *("repeats", "seed", "stability", "preset"),
)
"""Options that are entries of `frenetic.plugins.bench.file.BenchFile`."""
_OPTIONS_WITH_RESUME: Final = ("workers", "out", "resume", "is_trusted", "as_json")
"""Parameters that may be given with ``--resume``: they do not describe the bench."""
_INTERRUPTED: Final = 130
"""Exit code after Ctrl-C, as of shells."""


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False, metavar="[FILE.toml]")
@click.option(
    "--generator",
    multiple=True,
    metavar="GENERATOR",
    help="A generator: package.module:Class, file.py:Class or a name from --list. With options:"
    " path=DIR of its modules, copy=DIR that is copied for each run, pipeline=DIR of the"
    " competition's modules if they are not around it, python=FILE to run it, name=N in tables. May"
    " be repeated.",
)
@click.option(
    "--strategy",
    multiple=True,
    metavar="STRATEGY",
    shell_complete=complete_names("strategy"),
    help="A search strategy: frenetic-2021,threshold=-0.2. May be repeated. [default: all built-in"
    " ones]",
)
@click.option(
    "--preset",
    metavar="EDITION",
    help="Setting of a competition's edition, as near as ours can be, with its published figures"
    " beside the results: sbst2021 or sbft2023. Other entries win.",
)
@count_option("--simulations", "Budget of each run, in drives. [default: 200]")
@click.option("--kilometres", type=float, metavar="KM", help="Budget of each run, in km driven.")
@click.option(
    "--simulated-time", type=DURATION_TYPE, help="Budget of each run, simulated: 30m, 2h."
)
@count_option("--repeats", "Runs of each entrant. [default: 10]")
@count_option("--seed", "Seed of the first runs. [default: 1]", least=0)
@count_option(
    "--stability",
    "Failures of each run to drive again, with 2 % less and 2 % more grip. [default: 0]",
    least=0,
)
@part_options
@entry_option("objective")
@trust_option
@click.option(
    "--workers", type=WORKERS_TYPE, metavar="N", help="Runs at once. [default: the cores]"
)
@folder_option("Folder for the results. [default: a new one under benches/]")
@click.option("--resume", is_flag=True, help="Complete the bench in --out.")
@click.option("--list", "as_list", is_flag=True, help="List published generators.")
@json_option
@click.pass_context
def bench(
    context: click.Context,
    /,
    file: Path | None,
    workers: int | None,
    out: Path | None,
    is_trusted: bool,
    resume: bool,
    as_list: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Compare road generators on the same driver, with repeats.

    Generators of the SBST/SBFT competition's pipeline run unmodified, each run in its own process
    and folder, beside our strategies. Every run is a campaign. FILE.toml holds the options and
    more, such as seconds_per_test, patience and speed_limit; bench.toml in every bench's folder is
    such a file. Options win.
    """
    if as_list:
        _list_recipes(as_json)
        return
    if resume:
        the_bench = _bench_to_resume(context, out, is_trusted)
    else:
        the_bench, workers_of_file = _new_bench(context, file, out)
        workers = workers or workers_of_file
    _run(the_bench, resume, workers, as_json)


def _bench_to_resume(context: click.Context, out: Path | None, is_trusted: bool) -> Bench:
    """Return the bench in a folder.

    Raises:
        click.UsageError: there is no folder, or an option that describes a bench.
    """
    from frenetic.plugins.bench import open_bench

    if out is None:
        raise click.UsageError("--resume needs the folder of a bench: add --out DIR")
    for parameter in context.command.params:
        name = parameter.name or ""
        if name not in _OPTIONS_WITH_RESUME and was_given(context, name):
            raise click.UsageError(
                f"{parameter.opts[0]} cannot be given with --resume: the bench continues as it was"
                " begun"
            )
    the_bench = open_bench(out, is_trusted=is_trusted)
    code_folder = the_bench.terms.tester.folder
    if code_folder is not None and not is_here(code_folder):
        Log().print(f"Note: the code of {out} is loaded from {code_folder}", markup=False)
    return the_bench


def _new_bench(
    context: click.Context, path: Path | None, out: Path | None
) -> tuple[Bench, int | None]:
    """Return the bench of a command line, and the number of workers in its file.

    Args:
        context: context of the command, with its options.
        path: file of the bench, whose entries hold where no option is given.
        out: folder for the bench; by default a new one.
    """
    from frenetic.campaign import new_folder
    from frenetic.plugins.bench.bench import BENCHES
    from frenetic.plugins.bench.file import read_bench

    overrides = {name: context.params[name] for name in _ENTRIES if was_given(context, name)}
    if {"generator", "strategy"} & overrides.keys():  # they replace all entrants of the file
        overrides |= {kind: context.params[kind] for kind in ("generator", "strategy")}
    options, current_folder = CommandOptions.of(context), Path.cwd()
    spec, entries = read_bench(path, overrides.get("preset"))
    with as_usage_error():
        source = None if path is None else PartsSource(path, spec, entries.parts)
        entries = structs.replace(entries, **overrides)
        # Code that the user names here is trusted; code that a file names has to be.
        are_named_here = path is None or "generator" in overrides
        if are_named_here:
            options = replace(options, others=entries.parts)
        spec, code_folder = options.trusted(
            options.over(spec, roads_are_given=False),
            source,
            left_out=("strategy",),
            others=entries.parts,
        )
        entrants_folder = current_folder if are_named_here else code_folder
        with chdir(entrants_folder):
            entrants = entries.entrants()
        if code_folder != entrants_folder:
            entrants = tuple(entrant.absolute(entrants_folder) for entrant in entrants)
        out = out or new_folder(BENCHES)
        with chdir(code_folder):
            return entries.bench(spec, out, entrants), entries.workers


def _run(the_bench: Bench, resume: bool, workers: int | None, as_json: bool) -> None:
    """Run a bench and show its results; after Ctrl-C, print the command that continues it."""
    from frenetic.plugins.bench.bench import RECORD

    log = Log()
    try:
        ends = _run_with_progress(the_bench, resume, workers, log)
        _finish(the_bench, ends, log, as_json)
    except KeyboardInterrupt:
        if not (the_bench.folder / RECORD).is_file():
            raise  # nothing was begun
        echo(f"frenetic: interrupted; go on: {_resume_command(the_bench)}", err=True)
        raise click.exceptions.Exit(_INTERRUPTED) from None


def _resume_command(the_bench: Bench) -> str:
    """Return the command that continues a bench."""
    return f"frenetic bench --resume --out {shell(the_bench.folder)}"


def _run_with_progress(
    the_bench: Bench, resume: bool, workers: int | None, log: Log
) -> list[RunState]:
    """Run a bench with a line of its progress; return the states of the runs that it ran."""
    from frenetic.campaign.workers import available_cores
    from frenetic.simulators.capabilities import capabilities

    time_left = TimeLeft()

    def print_unusual_end(end: RunState) -> None:
        if end.ending is None or end.ending.end not in ("over", "returned"):
            log.print(f"{end.run.name}: {end.trouble or end.ending}", markup=False)

    with announced_compilation(log) as compiled, live_line(log) as show:

        def print_plan() -> None:
            compiled()
            _print_plan(the_bench, log, resume)

        def show_progress(share: float, counts: str) -> None:
            text = counts + time_left.words(share, 1.0)
            show(share, lambda: text)

        usual = capabilities(the_bench.terms.tester.simulator).usual_workers
        return the_bench.run(
            resume=resume,
            workers=workers or usual or available_cores(),
            on_start=print_plan,
            on_progress=show_progress,
            on_end=print_unusual_end,
            on_interrupt=log.stopping,
        )


def _finish(the_bench: Bench, ends: Sequence[RunState], log: Log, as_json: bool) -> None:
    """Show a bench's results; exit with an error if runs are missing or nothing was driven.

    Args:
        the_bench: the bench.
        ends: states of the runs that were run now.
        log: log of the command.
        as_json: whether the results are printed as JSON.
    """
    states = the_bench.states()
    has_drives = _show_results(the_bench, states, log, as_json)
    if missing := sum(state.ending is None for state in states):
        command = _resume_command(the_bench)
        if troubles := [f"{end.run.name}: {end.trouble}" for end in ends if end.trouble]:
            raise FreneticError(
                f"{missing} of {len(states)} runs could not be completed ({troubles[0]}); try"
                f" again: {command}"
            )
        echo(f"{missing} of {len(states)} runs are missing; go on: {command}", err=True)
        raise click.exceptions.Exit(_INTERRUPTED)
    if not has_drives:
        raise click.exceptions.Exit(1)


def _print_plan(the_bench: Bench, log: Log, resume: bool) -> None:
    """Print which runs a bench makes; warn of too few repeats if it is new."""
    names = ", ".join(entrant.name for entrant in the_bench.entrants)
    log.print(
        f"{the_bench.runs_text} each of {names}, results in {the_bench.folder}",
        markup=False,
    )
    needed = the_bench.repeats_needed
    if the_bench.repeats < needed and not resume:
        log.print(
            f"Note: {len(the_bench.entrants)} generators need up to {needed} repeats for a"
            f" difference to be shown: {the_bench.repeats} may be too few",
            markup=False,
        )


def _show_results(the_bench: Bench, states: Sequence[RunState], log: Log, as_json: bool) -> bool:
    """Compare the entrants; print and write the comparison. Return whether a drive was judged."""
    from frenetic.plugins.bench.results import write_results

    runs_entry = {"runs": [state.as_json() for state in states]}
    if all(state.ending is None for state in states):  # nothing to compare yet
        echo(json.dumps(runs_entry) if as_json else f"Results: {the_bench.folder}")
        return False
    with log.status("Comparing"):
        comparison = the_bench.comparison()
    for note in comparison.notes:
        log.print(f"Note: {note}", markup=False)
    with log.status("Writing the page"):
        page = write_results(the_bench, comparison)
    if as_json:
        document = {**comparison_document(comparison), **runs_entry}
        if the_bench.preset is not None:
            differences = the_bench.preset.differences(the_bench.entries())
            document["preset"] = {**to_builtins(the_bench.preset), "differs": differences}
        echo(json.dumps(document))
    else:
        print_comparison(comparison)
        _print_published(the_bench, comparison)
        echo(f"Page:    {page}")
        echo(f"Results: {the_bench.folder}")
    return any(
        run.simulations > run.counts.errors for runs in comparison.groups.values() for run in runs
    )


def _print_published(the_bench: Bench, comparison: Comparison) -> None:
    """Print the figures of a bench's preset beside its entrants' figures."""
    from frenetic.plugins.bench.presets import COLUMNS, measured

    if (preset := the_bench.preset) is None:
        return
    echo(f"Setting of {preset.title}: {preset.setting}")
    print_table(
        ("", *(f">{title}" for title in COLUMNS), "from"),
        [
            (figures.tool, *figures.cells, figures.source)
            for figures in (*measured(comparison), *preset.published)
        ],
        title=f"Means of a run, here and in {preset.title}",
    )
    for name, difference in preset.differences(the_bench.entries()).items():
        echo(f"Differs in {name}: {difference}")
    for name, publication in preset.sources.items():
        echo(f"Source {name}: {publication}")


def _list_recipes(as_json: bool) -> None:
    """Print the published generators."""
    from frenetic.plugins.bench import RECIPES

    if as_json:
        echo(json.dumps(to_builtins(list(RECIPES.values()))))
        return
    print_table(
        ("generator", "files of", "needs"),
        [(recipe.name, recipe.source, recipe.needs or "") for recipe in RECIPES.values()],
    )
    echo("Take part: --generator NAME,path=FOLDER,python=INTERPRETER")
