"""The command that compares generators: bench."""

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
    CommandOptions,
    PartsSource,
    entry_option,
    names_of,
    part_options,
    trust_option,
    was_given,
)
from frenetic.cli.options import (
    WORKERS,
    as_usage_error,
    count_option,
    folder_option,
    json_option,
)
from frenetic.errors import FreneticError
from frenetic.parts.trust import is_here

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison
    from frenetic.plugins.bench import Bench, RunState

_ENTRIES: Final = ("generator", "strategy", "simulations", "repeats", "seed", "preset")
"""Options that are entries of a file, too, beside those that say how roads are driven."""
_ALSO_TO_RESUME: Final = ("workers", "out", "resume", "is_trusted", "as_json")
"""Options that say nothing of the bench itself."""


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
@click.option(
    "--preset",
    metavar="EDITION",
    help="Setting of a competition's edition, as far as we can have it, beside its published"
    " figures: sbst2021 or sbft2023. FILE.toml and other options win.",
)
@count_option("--simulations", "Budget of each run, in drives. [default: 200]")
@count_option("--repeats", "Runs of each. [default: 10]")
@count_option("--seed", "Of the first run of each. [default: 1]", least=0)
@part_options
@entry_option("objective")
@trust_option
@click.option("--workers", type=WORKERS, metavar="N", help="Runs at once. [default: the cores]")
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
    and folder, beside our strategies. Every run is a campaign. FILE.toml says what the options say
    and more, such as seconds_per_test, patience and speed_limit; bench.toml in every bench's folder
    is one. Options given beside it win.
    """
    if as_list:
        _list_recipes(as_json)
        return
    if not resume:
        the_bench, of_file = _begun(context, file, out)
        _run_advised(the_bench, resume, workers or of_file, as_json)
        return
    from frenetic.plugins.bench import open_bench

    if out is None:
        raise click.UsageError("--resume needs the folder of a bench: add --out DIR")
    for parameter in context.command.params:
        name = parameter.name or ""
        if name not in _ALSO_TO_RESUME and was_given(context, name):
            raise click.UsageError(
                f"{parameter.opts[0]} cannot be given here: the bench goes on as it was begun"
            )
    begun = open_bench(out, is_trusted=is_trusted)
    if (place := begun.terms.tester.folder) is not None and not is_here(place):
        Log().print(f"Note: the code of {out} is loaded from {place}", markup=False)
    _run_advised(begun, resume, workers, as_json)


def _begun(context: click.Context, path: Path | None, out: Path | None) -> tuple[Bench, int | None]:
    """Return the bench of a command line, and the workers that its file wants."""
    from frenetic.campaign import new_folder
    from frenetic.plugins.bench.bench import BENCHES
    from frenetic.plugins.bench.file import read_bench

    overrides = {n: context.params[n] for n in _ENTRIES if was_given(context, n)}
    if {"generator", "strategy"} & overrides.keys():  # in the place of all that the file names
        overrides |= {kind: context.params[kind] for kind in ("generator", "strategy")}
    driving, here = CommandOptions.of(context), Path.cwd()
    spec, entries = read_bench(path, overrides.get("preset"))
    with as_usage_error():
        source = None if path is None else PartsSource(path, spec, entries.parts)
        entries = structs.replace(entries, **overrides)
        is_named = path is None or "generator" in overrides
        if is_named:
            driving = replace(driving, others=entries.parts)
        spec, folder = driving.trusted(
            driving.over(spec, has_roads=False),
            source,
            left_out=("strategy",),
            others=entries.parts,
        )
        place = here if is_named else folder
        with chdir(place):
            entrants = entries.entrants()
        if folder != place:
            entrants = tuple(entrant.absolute(place) for entrant in entrants)
        out = out or new_folder(BENCHES)
        with chdir(folder):
            return entries.bench(spec, out, entrants), entries.workers


def _run_advised(the_bench: Bench, resume: bool, workers: int | None, as_json: bool) -> None:
    """Run a bench; after Ctrl-C the command that goes on with it is printed."""
    from frenetic.plugins.bench.bench import RECORD

    try:
        _run(the_bench, resume, workers, as_json)
    except KeyboardInterrupt:
        if not (the_bench.folder / RECORD).is_file():
            raise  # nothing was begun
        echo(f"frenetic: interrupted; go on: {_next_command(the_bench)}", err=True)
        raise click.exceptions.Exit(130) from None


def _next_command(the_bench: Bench) -> str:
    """Return the command that goes on with a bench."""
    return f"frenetic bench --resume --out {shell(the_bench.folder)}"


def _run(the_bench: Bench, resume: bool, workers: int | None, as_json: bool) -> None:
    from frenetic.campaign.workers import available_cores
    from frenetic.simulators.capabilities import capabilities

    log = Log()
    again = _next_command(the_bench)

    def ended(end: RunState) -> None:
        if end.ending is None or end.ending.end not in ("over", "returned"):
            log.print(f"{end.run.name}: {end.trouble or end.ending}", markup=False)

    with announced_compilation(log) as compiled:

        def started() -> None:
            compiled()
            _print_plan(the_bench, log, resume)

        time_left = TimeLeft()

        def progress(share: float, words: str) -> None:
            text = words + time_left.words(share, 1.0)
            show(share, lambda: text)

        usual = capabilities(the_bench.terms.tester.simulator).usual_workers
        with live_line(log) as show:
            try:
                ends = the_bench.run(
                    resume=resume,
                    workers=workers or usual or available_cores(),
                    on_start=started,
                    on_progress=progress,
                    on_end=ended,
                    on_interrupt=log.stopping,
                )
            except KeyboardInterrupt:
                echo(f"Go on: {again}", err=True)
                raise
    states = the_bench.states()
    has_drives = _show_results(the_bench, states, log, as_json)
    if missing := sum(state.ending is None for state in states):
        if troubles := [f"{end.run.name}: {end.trouble}" for end in ends if end.trouble]:
            raise FreneticError(
                f"{missing} of {len(states)} runs could not be completed ({troubles[0]}); try"
                f" again: {again}"
            )
        echo(f"{missing} of {len(states)} runs are missing; go on: {again}", err=True)
        raise click.exceptions.Exit(130)
    if not has_drives:
        raise click.exceptions.Exit(1)


def _print_plan(the_bench: Bench, log: Log, resume: bool) -> None:
    """Print which runs a bench makes, and warn of too few repeats when it begins."""
    names = ", ".join(entrant.name for entrant in the_bench.entrants)
    log.print(
        f"{the_bench.runs_text} each of {names}, results in {the_bench.folder}",
        markup=False,
    )
    needed = the_bench.repeats_needed
    if the_bench.repeats < needed and not resume:
        log.print(
            f"Note: {len(the_bench.entrants)} generators need at least {needed} repeats:"
            f" with {the_bench.repeats} no difference can be shown",
            markup=False,
        )


def _show_results(the_bench: Bench, states: Sequence[RunState], log: Log, as_json: bool) -> bool:
    """Compares the entrants; prints and writes the comparison. Says whether a drive was judged."""
    from frenetic.plugins.bench.results import write_results

    runs = {"runs": [state.as_json() for state in states]}
    if all(state.ending is None for state in states):
        echo(json.dumps(runs) if as_json else f"Results: {the_bench.folder}")
        return False
    with log.status("Comparing"):
        comparison = the_bench.comparison()
    for note in comparison.notes:
        log.print(f"Note: {note}", markup=False)
    with log.status("Writing the page"):
        page = write_results(the_bench, comparison)
    if as_json:
        document = {**comparison_document(comparison), **runs}
        if the_bench.preset is not None:
            differences = the_bench.preset.differences(the_bench.entries())
            document["preset"] = {**to_builtins(the_bench.preset), "differs": differences}
        echo(json.dumps(document))
    else:
        print_comparison(comparison)
        _print_published(the_bench, comparison)
        echo(f"Page:    {page}")
        echo(f"Results: {the_bench.folder}")
    return any(r.simulations > r.counts.errors for g in comparison.groups.values() for r in g)


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
    for name, place in preset.sources.items():
        echo(f"Source {name}: {place}")


def _list_recipes(as_json: bool) -> None:
    from frenetic.plugins.bench import RECIPES

    if as_json:
        echo(json.dumps(to_builtins(list(RECIPES.values()))))
        return
    print_table(
        ("generator", "files of", "needs"),
        [(recipe.name, recipe.source, recipe.needs or "") for recipe in RECIPES.values()],
    )
    echo("Take part: --generator NAME,path=FOLDER,python=INTERPRETER")
