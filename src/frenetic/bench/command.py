"""The command that compares generators: bench."""

from __future__ import annotations

import json
import shlex
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic.cli.compare import comparison_document, print_comparison
from frenetic.cli.console import Log, announced_compilation, live_line, print_table, shell
from frenetic.cli.options import (
    WORKERS,
    Decorator,
    Duration,
    GroupedCommand,
    GroupedOption,
    Setting,
    as_usage_error,
    folder_option,
    json_option,
    objective_option,
)
from frenetic.cli.parts import AS, asked_spec, driver_options, names_of, was_given
from frenetic.errors import FreneticError
from frenetic.spec import drive_options

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison
    from frenetic.bench import Bench, BenchProgress, Entrant, RunState

SIMULATIONS: Final = 200
SECONDS_PER_TEST: Final = 36.0
REPEATS: Final = 10
PATIENCE: Final = 600.0
SEED: Final = 1

_ENTRANTS: Final = "Who takes part"
_PLACES: Final = ("path", "copy", "python")
_OPENING: Final = ("generator", "strategy", "recipe")
_OF_ENTRANT: Final = ("path", "copy", "name", "options", "python")
_FIXED: Final = (
    *(*_OPENING, *_OF_ENTRANT, "simulations", "seconds", "repeats", "seed"),
    *("seconds_per_test", "count_computing", "patience", "records"),
)
"""Options that begin a bench and stay when it is resumed."""


class EntrantsCommand(GroupedCommand):
    """A command whose options of an entrant, such as --path, belong to the entrant before them."""

    first_group = _ENTRANTS

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Notes the order of the entrants' options."""
        values, _, order = self.make_parser(ctx).parse_args(args=list(args))
        coming = {name: iter(values[name]) for name in (*_OPENING, *_OF_ENTRANT) if name in values}
        ctx.meta[__name__] = [
            (parameter.name, next(coming[parameter.name]))
            for parameter in order
            if parameter.name in coming
        ]
        return super().parse_args(ctx, args)


@dataclass
class _AskedEntrant:
    """An entrant on the command line."""

    spec: str
    """Of a generator or strategy, or name of a recipe."""
    is_strategy: bool
    is_recipe: bool = False
    may_be_generator: bool = False
    """Whether a path or the like would show that it is a generator, whose class is missing."""
    given: dict[str, str] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def entrant(self, seconds_per_test: float) -> Entrant:
        """The entrant of a bench, in which a drive costs so much."""
        from frenetic.bench import Entrant, find_recipe

        if self.is_recipe:
            recipe = find_recipe(self.spec)
            if "path" not in self.given:
                raise FreneticError(
                    f"{recipe.title} has to be there: give --path, a folder with the files of"
                    f" {recipe.source}"
                )
            if "copy" in self.given or self.options:
                raise FreneticError(f"{recipe.title} comes with a recipe: without --copy, --option")
            recipe.check(seconds_per_test)
            python = self.given.get("python")
            return recipe.entrant(
                Path(self.given["path"]),
                python=None if python is None else Path(python),
                name=self.given.get("name"),
            )
        places = {name: Path(self.given[name]) for name in _PLACES if name in self.given}
        return Entrant(
            name=self.given.get("name", self._name()),
            spec=self.spec,
            is_strategy=self.is_strategy and not (self.may_be_generator and places),
            options=self.options,
            **places,
        )

    def _name(self) -> str:
        if not self.is_strategy:
            return self.spec.rpartition(":")[2]
        settings = [f"{name}={json.dumps(value)}" for name, value in self.options.items()]
        return " ".join([self.spec.rpartition(":")[2], *settings])


def _entrant_option(name: str, *names: str, **how: Any) -> Decorator:
    return click.option(name, *names, multiple=True, cls=GroupedOption, group=_ENTRANTS, **how)


@click.command(cls=EntrantsCommand)
@_entrant_option(
    "--generator",
    metavar="MODULE:CLASS",
    help="A generator written for the SBST/SBFT pipeline, package.module:Class or file.py:Class;"
    " may be repeated. Without a colon, the name of one of our strategies.",
)
@_entrant_option(
    "--strategy",
    metavar="S",
    shell_complete=names_of("strategy"),
    help="A search strategy, by name or package.module:Class; may be repeated."
    " [default: all built-in ones, without a --generator]",
)
@_entrant_option(
    "--recipe",
    metavar="R",
    help="A published generator, as --recipes lists them, with the folder of its repository's files"
    " as --path; may be repeated.",
)
@_entrant_option(
    "--path",
    metavar="DIR",
    help="Folder in which the modules of the generator before it are.",
)
@_entrant_option(
    "--copy",
    metavar="DIR",
    help="Folder that the generator before it works in, as a copy of every run's own; for one that"
    " opens files of its repository or writes beside its source.",
)
@_entrant_option(
    "--name",
    metavar="N",
    help="What tables call the generator or strategy before it. [default: its class]",
)
@_entrant_option(
    "--option",
    "options",
    type=Setting(),
    help="An option of the strategy before it, such as threshold=-0.2; may be repeated.",
)
@_entrant_option(
    "--python",
    metavar="FILE",
    help="The interpreter of the generator before it, such as that of its virtual environment"
    " (3.9 or newer, with numpy 1.21 or newer and scipy).",
)
@click.option(
    "--simulations",
    type=click.IntRange(1),
    metavar="N",
    help=f"Budget of each run, in drives. [default: {SIMULATIONS}]",
)
@click.option(
    "--time",
    "seconds",
    type=Duration(),
    help="Budget of each run, in virtual time: 2h, of which each drive costs --seconds-per-test.",
)
@click.option(
    "--seconds-per-test",
    type=float,
    default=SECONDS_PER_TEST,
    show_default=True,
    metavar="S",
    help="Virtual time that a drive costs.",
)
@click.option(
    "--count-computing/--free-computing",
    default=False,
    show_default=True,
    help="Whether the time that a generator takes itself counts against the budget.",
)
@objective_option
@click.option(
    "--repeats", type=click.IntRange(1), default=REPEATS, show_default=True, help="Runs of each."
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=SEED,
    show_default=True,
    help="Of the first run of each; the following ones count on.",
)
@click.option(
    "--patience",
    type=Duration(),
    default=PATIENCE,
    show_default="10m",
    help="End a generator that asks for no test for longer.",
)
@click.option(
    "--records",
    type=click.Choice(["all", "failures", "none"]),
    default="failures",
    show_default=True,
    help="Whose drives' records the competition's results folders hold.",
)
@driver_options
@click.option(
    "--workers",
    type=WORKERS,
    metavar="N",
    help="Runs at once, in processes of their own. [default: the cores]",
)
@folder_option("Folder for the results. [default: a new one under benches/]")
@click.option("--resume", is_flag=True, help="Complete the bench in the folder --out.")
@click.option(
    "--list",
    "as_list",
    is_flag=True,
    help="List the runs of the bench in the folder --out, or else who can take part by name.",
)
@click.option(
    "--recipes",
    "lists_recipes",
    is_flag=True,
    help="List the published generators, and their needs.",
)
@json_option
@click.pass_context
def bench(
    context: click.Context,
    /,
    workers: int | None,
    out: Path | None,
    resume: bool,
    as_list: bool,
    lists_recipes: bool,
    as_json: bool,
    **asked: Any,
) -> None:
    """Compare road generators on the same driver, with repeats.

    Generators written for the pipeline of the SBST/SBFT competition run unmodified, each run in its
    own process and folder, beside our own strategies. Every run is a campaign, and holds a results
    folder for the competition's tools.
    """
    from frenetic.bench import Bench

    if lists_recipes:
        _list_recipes(as_json)
        return
    if as_list and out is None:
        _refuse_given(context, "--list without --out lists who can take part by name")
        _list_names(as_json)
        return
    if (resume or as_list) and out is None:
        raise click.UsageError("--resume needs the folder of a bench: add --out DIR")
    if resume or as_list:
        assert out is not None
        _refuse_given(context, "the bench goes on as it was begun")
        with as_usage_error():
            the_bench = Bench.open(out)
    else:
        the_bench = _begun(context, out, asked)
    if as_list:
        _list_runs(the_bench.states(), as_json)
        return
    _run(the_bench, resume, workers, as_json)


def _begun(context: click.Context, out: Path | None, asked: Mapping[str, Any]) -> Bench:
    """The bench of a command line."""
    from frenetic.bench import Bench, Entrant, Terms, new_folder
    from frenetic.registry import STRATEGIES

    if asked["simulations"] is not None and asked["seconds"] is not None:
        raise click.UsageError("--simulations and --time exclude each other: both are the budget")
    cost = asked["seconds_per_test"]
    with as_usage_error():
        entrants = tuple(one.entrant(cost) for one in _asked_entrants(context.meta[__name__]))
    if not entrants:
        entrants = tuple(
            Entrant(name=entry.name, spec=entry.name, is_strategy=True)
            for entry in STRATEGIES.entries()
            if set(STRATEGIES.needs(STRATEGIES.load(entry.name))) <= {"seed", "map_size"}
        )
    spec = asked_spec(context).with_limit()
    with as_usage_error():
        return Bench(
            entrants=entrants,
            terms=Terms.of(
                spec,
                budget=asked["seconds"] or (asked["simulations"] or SIMULATIONS) * cost,
                seconds_per_test=cost,
                counts_computing=asked["count_computing"],
                patience=asked["patience"],
                objective=asked["objective"],
                records=asked["records"],
            ),
            repeats=asked["repeats"],
            seed=asked["seed"],
            folder=new_folder() if out is None else out,
        )


def _asked_entrants(given: Sequence[tuple[str, str]]) -> Iterator[_AskedEntrant]:
    """Entrants, each from the option that opens it to the next such option."""
    entrant: _AskedEntrant | None = None
    for name, value in given:
        if name in _OPENING:
            if entrant is not None:
                yield entrant
            is_named = name == "generator" and ":" not in value
            is_strategy = name == "strategy" or (is_named and not set(value) & set("./\\"))
            entrant = _AskedEntrant(value, is_strategy, name == "recipe", is_named)
        elif entrant is None:
            option = "option" if name == "options" else name
            raise click.UsageError(
                f"--{option} belongs after the --generator, --strategy or --recipe"
            )
        elif name == "options":
            key, setting = Setting().convert(value, None, None)
            entrant.options[key] = setting
        elif name in entrant.given:
            raise click.UsageError(f"--{name} is given twice for {entrant.spec}")
        else:
            entrant.given[name] = value
    if entrant is not None:
        yield entrant


def _refuse_given(context: click.Context, why: str) -> None:
    """Refuses the options that begin a bench."""
    for name in (*_FIXED, AS, *drive_options()):
        if was_given(context, name):
            parameter = next(p for p in context.command.params if p.name == name)
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
            page = write_results(the_bench, comparison, command=shlex.join(the_bench.words()))
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
    if not any(run.simulations > run.errors for group in runs for run in group):
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


def _list_names(as_json: bool) -> None:
    from frenetic.registry import STRATEGIES

    entries = STRATEGIES.entries()
    if as_json:
        click.echo(json.dumps([{"name": e.name, "class": e.target} for e in entries]))
        return
    print_table(
        ("name", "class", "what it is"),
        [(entry.name, entry.target, entry.summary or entry.origin) for entry in entries],
    )
    click.echo("Others: --generator package.module:Class or path/to/file.py:Class")


def _list_recipes(as_json: bool) -> None:
    from frenetic.bench import RECIPES

    if as_json:
        click.echo(json.dumps([one.as_json() for one in RECIPES.values()]))
        return
    print_table(
        ("recipe", "files of", "needs"),
        [(one.name, one.source, one.needs or "") for one in RECIPES.values()],
    )
    click.echo("Take part: --recipe NAME --path FOLDER --python INTERPRETER")


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
