"""The command line: parses, calls the library, prints."""

from __future__ import annotations

import json
import logging
import os
import secrets
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, ParamSpec, TextIO, TypeVar

import click
from rich.console import Console
from rich.table import Table

from frenetic.durations import format_duration, parse_duration
from frenetic.errors import CampaignError, FreneticError
from frenetic.registry import DRIVERS, SIMULATORS, STRATEGIES, Registry

if TYPE_CHECKING:
    from frenetic.campaign import (
        Budget,
        Campaign,
        CampaignStore,
        Progress,
        Summary,
        TestRecord,
    )
    from frenetic.drivers import Driver
    from frenetic.oracle import Result
    from frenetic.road import Road
    from frenetic.search import Strategy
    from frenetic.simulators import Simulator

P = ParamSpec("P")
R = TypeVar("R")

logger = logging.getLogger(__name__)

DEFAULT_SIMULATIONS = 1000
ANNOUNCE_AFTER = 1.5  # s of compiling after which it is mentioned
PLAIN_INTERVAL = 5.0  # s between two lines of progress where there is no terminal

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs the command line; every mistake of the user is one line on stderr and exit code 2."""
    try:
        code = cli.main(args=arguments, prog_name="frenetic", standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        _fail(error.format_message())
    except FreneticError as error:
        logger.debug("the error in full", exc_info=True)
        _fail(str(error))
    except (KeyboardInterrupt, click.Abort):
        click.echo("frenetic: interrupted", err=True)
        code = 130
    except BrokenPipeError:
        # The reader of our output has gone; so may we, without another word.
        _silence(sys.stdout)
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


def _fail(message: str) -> NoReturn:
    _complain(message)
    sys.exit(2)


def _complain(message: str) -> None:
    click.echo(f"frenetic: {' '.join(message.split())}", err=True)


class Duration(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """A time such as 90, 90s, 10m or 1h30m."""

    name = "time"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Seconds."""
        try:
            return parse_duration(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Folder(click.ParamType):  # type: ignore[type-arg]
    """A folder, which need not exist."""

    name = "folder"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Its path."""
        if not str(value):
            self.fail("an empty name; write . for the current folder", param, ctx)
        return Path(value)


class Setting(click.ParamType):  # type: ignore[type-arg]
    """NAME=VALUE for an option of a part; the value is read as JSON if it is some."""

    name = "name=value"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, Any]:
        """(name, value)."""
        name, equals, text = str(value).partition("=")
        if not equals or not name.strip():
            self.fail(f"{value!r} is not NAME=VALUE", param, ctx)
        for read in (json.loads, float):
            try:
                return name.strip(), read(text)
            except ValueError:
                continue
        return name.strip(), text


def _driver_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options by which a driver, a simulator and the rules are chosen."""
    options = [
        click.option(
            "--driver",
            default="planner",
            show_default=True,
            metavar="D",
            help="Who drives: a name ('frenetic drivers'), package.module:Class or file.py:Class.",
        ),
        click.option(
            "--driver-option",
            "driver_options",
            type=Setting(),
            multiple=True,
            help="An option of the driver, such as aggression=1.2; may be repeated.",
        ),
        click.option(
            "--noise",
            type=float,
            metavar="M",
            help="Let the driver err about its lateral place, by this standard deviation in m.",
        ),
        click.option(
            "--delay", type=float, metavar="S", help="Let the controls arrive this many s late."
        ),
        click.option(
            "--view", type=float, metavar="M", help="Let the driver see only this many m ahead."
        ),
        click.option(
            "--simulator",
            default="embedded",
            show_default=True,
            metavar="S",
            help="What moves the car (see 'frenetic simulators').",
        ),
        click.option(
            "--simulator-option",
            "simulator_options",
            type=Setting(),
            multiple=True,
            help="An option of the simulator, such as friction=0.7; may be repeated.",
        ),
        click.option("--speed-limit", type=float, default=70.0, show_default=True, help="km/h."),
        click.option(
            "--oob-tolerance",
            type=float,
            default=0.95,
            show_default=True,
            help="Share of the car that may be outside its lane, above 0 and up to 1.",
        ),
        click.option(
            "--map-size", type=float, default=200.0, show_default=True, help="m, side of the map."
        ),
        click.option(
            "--wall-limit",
            type=float,
            default=60.0,
            show_default=True,
            help="s of wall time that one drive may take.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


_json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


@click.group(context_settings=CONTEXT, invoke_without_command=True)
@click.version_option(None, "--version", package_name="frenetic-roads", prog_name="frenetic")
@click.option("--debug", is_flag=True, help="Log what happens, with tracebacks, to stderr.")
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """Finds the roads on which an automated driver leaves its lane."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())
    if debug:
        logging.basicConfig(
            level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s"
        )
        logging.getLogger("frenetic").setLevel(logging.DEBUG)


@cli.command(short_help="Search for roads on which a driver fails.")
@click.option("--simulations", type=int, metavar="N", help="Stop after N drives. [default: 1000]")
@click.option("--time", "seconds", type=Duration(), help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N failures.")
@click.option(
    "--strategy",
    default="frenetic",
    show_default=True,
    metavar="S",
    help="How to search (see 'frenetic strategies').",
)
@click.option(
    "--strategy-option",
    "strategy_options",
    type=Setting(),
    multiple=True,
    help="An option of the strategy, such as threshold=-0.2; may be repeated.",
)
@_driver_options
@click.option("--seed", type=click.IntRange(0), help="Repeats a search. [default: a new one]")
@click.option(
    "--out",
    type=Folder(),
    metavar="DIR",
    help="Folder for the results. [default: a new one under campaigns/]",
)
@_json_option
def run(
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    strategy: str,
    strategy_options: tuple[tuple[str, Any], ...],
    driver: str,
    driver_options: tuple[tuple[str, Any], ...],
    noise: float | None,
    delay: float | None,
    view: float | None,
    simulator: str,
    simulator_options: tuple[tuple[str, Any], ...],
    speed_limit: float,
    oob_tolerance: float,
    map_size: float,
    wall_limit: float,
    seed: int | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Search for roads on which a driver leaves its lane.

    With no option at all, 1000 drives of the built-in planner go into a new folder under
    campaigns/. The first of --simulations, --time and --failures that is reached ends the search;
    so does Ctrl-C, and nothing found is lost.
    """
    from frenetic.campaign import Budget, new_folder

    if simulations is None and seconds is None and failures is None:
        simulations = DEFAULT_SIMULATIONS
    seed = secrets.randbelow(2**31) if seed is None else seed
    with _as_usage_error():
        budget = Budget(simulations=simulations, time=seconds, failures=failures)
    command = {
        "strategy": strategy,
        "strategy_options": dict(strategy_options),
        "driver": driver,
        "driver_options": dict(driver_options),
        "noise": noise,
        "delay": delay,
        "view": view,
        "simulator": simulator,
        "simulator_options": dict(simulator_options),
        "speed_limit": speed_limit,
        "oob_tolerance": oob_tolerance,
        "wall_limit": wall_limit,
    }
    folder = new_folder() if out is None else out
    campaign = _make_campaign(command, seed, map_size, budget, folder)
    text = f"Searching with {strategy} for roads on which {driver} fails, seed {seed}"
    _search(campaign, campaign.run, text, as_json, seed)


def _search(
    campaign: Campaign,
    search: Callable[..., Summary],
    announcement: str,
    as_json: bool,
    seed: object,
) -> None:
    """Runs or resumes a campaign, shows how it goes and what it found."""
    from frenetic.campaign import CampaignStore
    from frenetic.report.failures import FAILURES, GALLERY, telling_failures, write_failures

    folder = campaign.folder
    log = _Log()
    trouble: FreneticError | None = None
    summary: Summary | None = None
    with _announced_compilation(log) as compiled, _live_progress(log) as show:

        def started() -> None:
            compiled()
            log.print(f"{announcement}, results in {folder}", markup=False)

        def stopping() -> None:
            log.print("Stopping after this test; press Ctrl-C again to leave at once.")

        try:
            summary = search(show, on_start=started, on_interrupt=stopping)
        except CampaignError as error:
            # What was stored until then is still worth a look.
            if not campaign.started:
                raise
            trouble = error
    with CampaignStore.open(folder) as store:
        listed = telling_failures(store)
        if summary is not None and as_json:
            click.echo(json.dumps(summary.as_json() | {"seed": seed}))
        elif summary is not None:
            _print_summary(summary)
        if listed and not as_json:
            _print_failures(listed)
        if summary is not None and not as_json:
            click.echo(f"Results:     {folder}")
        if listed:
            with log.status("Drawing the most telling failures"):
                complete = write_failures(store, listed)
            if not as_json:
                click.echo(f"At a glance: {folder / FAILURES / (GALLERY if complete else '')}")
                click.echo(f"Look closer: frenetic show {_shell(folder)} {listed[0].candidate.id}")
    if trouble is not None:
        raise trouble
    if summary is not None and summary.interrupted:
        raise click.exceptions.Exit(130)


@cli.command(short_help="Go on with a campaign that was interrupted or is to be extended.")
@click.argument("campaign", type=click.Path(path_type=Path))
@click.option("--simulations", type=int, metavar="N", help="N more drives.")
@click.option("--time", "seconds", type=Duration(), help="This much more time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="N more failures.")
@_json_option
def resume(
    campaign: Path,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    as_json: bool,
) -> None:
    """Go on with the CAMPAIGN in a folder, whatever ended it: Ctrl-C, a crash, its budget.

    Its log is replayed to a fresh strategy, so that an interrupted campaign ends as it would have
    without the interruption. With options, its budget becomes what is spent and so much more.
    """
    from frenetic.campaign import Budget, CampaignStore
    from frenetic.outcome import Outcome

    with CampaignStore.open(campaign) as store:
        config, facts, counts = store.config, store.facts, store.counts()
        spent = sum(record.seconds for record in store.tests())
    command = config.get("command")
    if not isinstance(command, Mapping):
        raise click.UsageError(
            f"{campaign} was started from Python: resume it there, with Campaign.resume()"
        )
    number = counts.by_outcome
    given = {"simulations": simulations, "time": seconds, "failures": failures}
    done: dict[str, Any] = {
        "simulations": counts.told - number[Outcome.INVALID],
        "time": spent,
        "failures": number[Outcome.FAIL],
    }
    with _as_usage_error():
        for name, more in given.items():
            if more is not None and more <= 0:
                raise ValueError(f"{name} is {more}: more than 0 is needed")
        last = facts.get("budget", config.get("budget"))
        limits: dict[str, Any] = dict(last) if isinstance(last, Mapping) else {}
        if any(more is not None for more in given.values()):
            limits = {k: None if v is None else done[k] + v for k, v in given.items()}
        budget = Budget(**limits)
        if budget.spent(done["simulations"], spent, done["failures"]) >= 1.0:
            raise ValueError(
                f"the budget of {campaign} is spent: say how much more, with --simulations,"
                " --time or --failures"
            )
    map_size: Any = config.get("map_size")
    the_campaign = _make_campaign(command, config.get("seed"), map_size, budget, campaign)
    text = f"Going on after {counts.told} tests with {command['strategy']}"
    _search(the_campaign, the_campaign.resume, text, as_json, config.get("seed"))


@cli.command(short_help="Drive one road from a file.")
@click.argument("road", type=click.Path(path_type=Path))
@_driver_options
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Draw the drive into this PNG, SVG or PDF file.",
)
@click.option("--anyway", is_flag=True, help="Drive the road even if it is invalid.")
@_json_option
def drive(
    road: Path,
    driver: str,
    driver_options: tuple[tuple[str, Any], ...],
    noise: float | None,
    delay: float | None,
    view: float | None,
    simulator: str,
    simulator_options: tuple[tuple[str, Any], ...],
    speed_limit: float,
    oob_tolerance: float,
    map_size: float,
    wall_limit: float,
    plot: Path | None,
    anyway: bool,
    as_json: bool,
) -> None:
    """Drive one road from a JSON file and say what happened.

    ROAD holds curvatures (1/m) and optionally a step (m), or road_points, or is a test file of the
    competition or of a campaign's failures. It is moved into the map if it lies elsewhere; a road
    that is invalid is not driven. The exit code is 0 if it was driven, 1 if it is INVALID or the
    simulator or driver broke (ERROR).
    """
    from frenetic.campaign import RoadTester
    from frenetic.oracle import Result, judge
    from frenetic.outcome import Outcome
    from frenetic.road.files import read_road

    the_driver = _make_driver(driver, dict(driver_options), noise, delay, view)
    the_simulator = _make_simulator(
        simulator, dict(simulator_options), speed_limit, oob_tolerance, wall_limit
    )
    loaded = read_road(road).road()
    _check_map_size(map_size)
    fitted, verdict = loaded.placed(map_size)
    the_road = fitted or loaded
    if not verdict.valid and not anyway:
        result = Result(Outcome.INVALID, verdict.message, None, None, None, 0.0, None)
        if plot is not None:
            from frenetic.report.picture import draw_road

            title = f"{road.name}: INVALID"
            draw_road(the_road, plot, title=title, reason=verdict.message)
    else:
        with _announced_compilation(_Log()) as compiled, the_simulator:
            compiled()
            the_drive = RoadTester(the_simulator, the_driver).drive(the_road)
        result = judge(the_road, the_drive)
        if plot is not None:
            from frenetic.report.picture import draw_drive

            draw_drive(the_road, the_drive, plot, title=f"{road.name}: {result.outcome}")
    if as_json:
        document = {"road": str(road), "length": the_road.length, **asdict(result)}
        if plot is not None:
            document["plot"] = str(plot)
        click.echo(json.dumps(document))
    else:
        _print_drive(result, the_road, road, plot)
    if not result.outcome.is_driven:
        raise click.exceptions.Exit(1)


def _print_drive(result: Result, the_road: Road, road: Path, plot: Path | None) -> None:
    click.echo(f"{result.outcome}  {result.reason}")
    facts: list[tuple[str, str]] = [("road", f"{the_road.length:.1f} m, {road}")]
    facts += _facts_of_drive(result, result.duration if result.outcome.is_driven else None)
    if plot is not None:
        facts.append(("picture", str(plot)))
    _print_facts(facts)


def _facts_of_drive(result: Result | TestRecord, duration: float | None) -> list[tuple[str, str]]:
    """What there is to say of a drive, fresh or recorded."""
    facts = []
    if result.moobd is not None and result.moobd_distance is not None:
        facts += [
            ("MOOBD", f"{result.moobd:.3f} m, at {result.moobd_distance:.1f} m"),
            ("oob share", f"{result.max_oob_share:.0%} at most"),
        ]
    if duration is not None:
        facts.append(("time", f"{duration:.2f} s"))
    place = result.departure
    if place is not None:
        facts.append(
            (
                "left lane",
                f"to the {place.side} after {place.distance:.1f} m and {place.time:.2f} s,"
                f" at ({place.x:.1f}, {place.y:.1f})",
            )
        )
    return facts


@cli.command(short_help="Say whether roads are valid, as the competition does.")
@click.argument(
    "files", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="FILE..."
)
@click.option(
    "--map-size", type=float, default=200.0, show_default=True, help="m, side of the map."
)
@_json_option
def validate(files: tuple[Path, ...], map_size: float, as_json: bool) -> None:
    """Say for each road file whether the competition calls it valid.

    Points are judged where they lie, curvatures where they fit the map. The exit code is 1 if any
    road is invalid, 2 if a file cannot be read; the other files are judged all the same.
    """
    from frenetic.road.files import read_road

    _check_map_size(map_size)
    verdicts: list[dict[str, Any]] = []
    unreadable = []
    for path in files:
        try:
            verdict = read_road(path).check_validity(map_size)
        except FreneticError as error:
            unreadable.append(str(error))
            continue
        verdicts.append({"file": str(path), "valid": verdict.valid, "message": verdict.message})
        if not as_json:
            click.echo(f"{path}: {'valid' if verdict.valid else 'INVALID  ' + verdict.message}")
    if as_json:
        click.echo(json.dumps(verdicts))
    if unreadable:
        for message in unreadable:
            _complain(message)
        raise click.exceptions.Exit(2)
    if not all(verdict["valid"] for verdict in verdicts):
        raise click.exceptions.Exit(1)


@cli.command(short_help="Look at a campaign, or at one of its tests.")
@click.argument("campaign", type=click.Path(path_type=Path))
@click.argument("test_id", type=int, required=False, metavar="[ID]")
@click.option(
    "--plot",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Where to draw the test. [default: in the campaign's folder]",
)
@_json_option
def show(campaign: Path, test_id: int | None, plot: Path | None, as_json: bool) -> None:
    """Say what a CAMPAIGN folder holds, or show one test in full, with its picture."""
    from frenetic.campaign import CampaignStore

    with CampaignStore.open(campaign) as store:
        if test_id is None:
            if plot is not None:
                raise click.UsageError("--plot needs the ID of a test, too")
            _show_campaign(store, as_json)
        else:
            _show_test(store, test_id, plot, as_json)


def _show_campaign(store: CampaignStore, as_json: bool) -> None:
    from frenetic.outcome import Outcome
    from frenetic.report.failures import telling_failures

    counts = store.counts()
    config, facts = store.config, store.facts
    number = counts.by_outcome
    if as_json:
        document = {
            "folder": str(store.folder),
            "tests": counts.told,
            "invalid": number[Outcome.INVALID],
            "passed": number[Outcome.PASS],
            "failed": number[Outcome.FAIL],
            "errors": number[Outcome.ERROR],
            "min_moobd": counts.lowest_moobd,
            "facts": dict(facts),
            "config": dict(config),
        }
        click.echo(json.dumps(document))
        return
    rules = config.get("rules")
    limits = rules if isinstance(rules, Mapping) else {}
    budget = facts.get("budget", config.get("budget"))
    limited = budget if isinstance(budget, Mapping) else {}
    spent = ", ".join(f"{value} {name}" for name, value in limited.items() if value is not None)
    if facts.get("interrupted"):
        spent += ", interrupted"
    elif "finished_at" not in facts:
        spent += ", not finished"
    _print_facts(
        [
            ("campaign", str(store.folder)),
            ("made", str(facts.get("created_at", "unknown")).replace("T", " ")),
            ("strategy", _part(config.get("strategy"))),
            ("driver", _part(config.get("driver"))),
            ("simulator", _part(config.get("simulator"))),
            (
                "rules",
                f"{limits.get('speed_limit')} km/h, {limits.get('oob_tolerance')} of the car may"
                f" be out, map of {config.get('map_size')} m",
            ),
            ("budget", spent),
            (
                "tests",
                f"{counts.told}: {number[Outcome.PASS]} passed, {number[Outcome.FAIL]} failed,"
                f" {number[Outcome.INVALID]} invalid, {number[Outcome.ERROR]} errors",
            ),
        ]
    )
    listed = telling_failures(store)
    if listed:
        _print_failures(listed)
        click.echo(f"One in full: frenetic show {_shell(store.folder)} {listed[0].candidate.id}")


def _part(described: object) -> str:
    """A part of a campaign's configuration in one line: class, options, what it lies over."""
    if not isinstance(described, Mapping):
        return "unknown"
    options = described.get("options")
    shown = ", ".join(
        f"{name}={value}"
        for name, value in (options.items() if isinstance(options, Mapping) else ())
        if not isinstance(value, Mapping)
    )
    text = str(described.get("class", "unknown")).rpartition(":")[2] + (
        f"({shown})" if shown else ""
    )
    inner = described.get("driver")
    return text if inner is None else f"{text} over {_part(inner)}"


def _show_test(store: CampaignStore, test_id: int, plot: Path | None, as_json: bool) -> None:
    from frenetic.outcome import Outcome
    from frenetic.report.failures import (
        FAILURES,
        PICTURES,
        file_stem,
        road_document,
        stored_test,
    )
    from frenetic.report.picture import draw_drive, draw_road

    record = store.test(test_id)
    test = stored_test(store, record)
    kind = FAILURES if record.outcome is Outcome.FAIL else PICTURES
    picture = plot if plot is not None else store.folder / kind / f"{file_stem(test_id)}.png"
    title = f"Test {test_id}: {record.outcome}"
    try:
        if plot is None:
            picture.parent.mkdir(exist_ok=True)
        if test.drive is not None:
            draw_drive(test.road, test.drive, picture, title=title)
        else:
            draw_road(test.road, picture, title=title, reason=record.reason)
        drawn = str(picture)
    except (OSError, FreneticError) as error:
        if plot is not None:
            raise
        drawn = f"not drawn, {error}; choose a place with --plot"
    if as_json:
        document = road_document(test, store.config) | {"picture": drawn, "told": record.told}
        click.echo(json.dumps(document))
        return
    origin = record.candidate.origin
    parents = f" of {', '.join(map(str, origin.parents))}" if origin.parents else ""
    facts = [
        ("test", f"{test_id}, told as number {record.told}"),
        ("outcome", f"{record.outcome}  {record.reason}"),
        ("origin", f"{origin.operator}{parents}, generation {origin.generation}"),
        ("road", f"{test.road.length:.1f} m, {len(test.road.curvatures)} curvatures"),
    ]
    facts += _facts_of_drive(record, record.duration)
    facts += [
        ("curvatures", " ".join(f"{value:.4f}" for value in test.road.curvatures)),
        ("picture", drawn),
    ]
    _print_facts(facts)


def _listing(name: str, registry: Registry, summary: str) -> None:
    @cli.command(name, short_help=summary, help=f"{summary} Others are installed as packages.")
    @_json_option
    def listing(as_json: bool) -> None:
        entries = registry.entries()
        if as_json:
            click.echo(json.dumps([asdict(entry) for entry in entries]))
            return
        table = Table(box=None, pad_edge=False)
        for column in ("name", "from", "what it is"):
            table.add_column(column, overflow="fold")
        for entry in entries:
            table.add_row(entry.name, entry.origin, entry.summary or entry.target)
        _Results().print(table)
        click.echo(f"Your own: package.module:Class or path/to/file.py:Class as --{registry.kind}.")


_listing("drivers", DRIVERS, "List the drivers, the systems under test.")
_listing("strategies", STRATEGIES, "List the search strategies.")
_listing("simulators", SIMULATORS, "List the simulators.")


@contextmanager
def _as_usage_error() -> Iterator[None]:
    """Turns a `ValueError` of the library into a mistake of the user."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def _check_map_size(map_size: float) -> None:
    from frenetic.road import MARGIN

    if not 2.0 * MARGIN < map_size < float("inf"):
        raise click.UsageError(
            f"--map-size is {map_size:g}: more than twice the margin of {MARGIN:g} m is needed"
        )


def _make_campaign(
    command: Mapping[str, Any], seed: object, map_size: float, budget: Budget, folder: Path
) -> Campaign:
    """The campaign of a command line, as it was given or as a campaign has recorded it."""
    from frenetic.campaign import Campaign

    driver = _make_driver(*(command[k] for k in ("driver", "driver_options", *_LAYERS)))
    simulator = _make_simulator(*(command[k] for k in ("simulator", "simulator_options", *_LIMITS)))
    strategy: Strategy = _make_part(
        STRATEGIES,
        command["strategy"],
        command["strategy_options"],
        {"seed": seed, "map_size": map_size},
    )
    with _as_usage_error():
        return Campaign(
            strategy=strategy,
            simulator=simulator,
            driver=driver,
            budget=budget,
            folder=folder,
            map_size=map_size,
            description={"seed": seed, "command": dict(command)},  # type: ignore[dict-item]
        )


_LAYERS = ("noise", "delay", "view")
_LIMITS = ("speed_limit", "oob_tolerance", "wall_limit")


def _make_driver(
    spec: str,
    options: Mapping[str, Any],
    noise: float | None,
    delay: float | None,
    view: float | None,
) -> Driver:
    from frenetic.drivers.loading import load_driver

    return load_driver(spec, options, noise=noise, delay=delay, view=view)


def _make_simulator(
    spec: str,
    options: Mapping[str, Any],
    speed_limit: float,
    oob_tolerance: float,
    wall_limit: float,
) -> Simulator:
    from frenetic.simulators import Rules

    with _as_usage_error():
        rules = Rules(speed_limit=speed_limit, oob_tolerance=oob_tolerance)
    simulator: Simulator = _make_part(
        SIMULATORS, spec, options, {"rules": rules, "wall_limit": wall_limit}
    )
    return simulator


def _make_part(
    registry: Registry, spec: str, options: Mapping[str, Any], available: Mapping[str, object]
) -> Any:
    """A part with its options, and with those of the command that its class takes."""
    for name in options:
        if name in available:
            raise click.UsageError(
                f"--{registry.kind}-option {name} is not allowed: it follows from the options of"
                " the command"
            )
    takes = registry.option_names(registry.load(spec))
    taken = {k: v for k, v in available.items() if takes is None or k in takes}
    return registry.make(spec, **options, **taken)


@contextmanager
def _announced_compilation(log: Console) -> Iterator[Callable[[], None]]:
    """Says that the simulator is being compiled, unless what it gives is called soon."""
    text = "Compiling the simulator; this happens once, takes about 20 s and is cached."
    timer = threading.Timer(ANNOUNCE_AFTER, log.print, [text])
    timer.daemon = True
    timer.start()
    try:
        yield timer.cancel
    finally:
        timer.cancel()


class _Results(Console):
    """The console for results: as wide as needed where they go into a file or a pipe."""

    def __init__(self) -> None:
        super().__init__(highlight=False, width=None if sys.stdout.isatty() else 120)

    def on_broken_pipe(self) -> None:
        """Leaves it to `main`."""
        raise BrokenPipeError


class _Log(Console):
    """The console for what is going on; a campaign goes on when nobody reads it any more."""

    def __init__(self) -> None:
        super().__init__(stderr=True, highlight=False, soft_wrap=True)

    def on_broken_pipe(self) -> None:
        """Falls silent."""
        self.quiet = True
        _silence(sys.stderr)


def _silence(stream: TextIO) -> None:
    """Lets a stream that nobody reads lead nowhere, so that nothing fails at exit either."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _progress_text(progress: Progress) -> str:
    least = "-" if progress.min_moobd is None else f"{progress.min_moobd:.2f} m"
    left = progress.seconds_left
    return (
        f"tests {progress.tests}, invalid {progress.invalid}, failures {progress.failed},"
        f" best MOOBD {least}, {progress.tests_per_second:.0f} tests/s,"
        f" {'?' if left is None else format_duration(left)} left"
    )


@contextmanager
def _live_progress(log: Console) -> Iterator[Callable[[Progress], None]]:
    """Shows progress: a bar on a terminal, now and then a plain line elsewhere."""
    if log.is_terminal:
        from rich.live import Live
        from rich.progress_bar import ProgressBar

        bar = ProgressBar(total=1.0, width=40)
        with Live(console=log, refresh_per_second=8, transient=True) as live:

            def update(progress: Progress) -> None:
                bar.update(progress.budget_spent)
                lines = Table.grid()
                lines.add_row(bar)
                lines.add_row(_progress_text(progress))
                live.update(lines)

            yield update
        return
    last: float | None = None

    def line(progress: Progress) -> None:
        nonlocal last
        now = time.monotonic()
        if last is None:
            last = now  # the first test: nothing to tell yet
        elif now - last >= PLAIN_INTERVAL:
            last = now
            log.print(_progress_text(progress))

    yield line


def _print_summary(summary: Summary) -> None:
    least = "" if summary.min_moobd is None else f", best MOOBD {summary.min_moobd:.2f} m"
    stopped = "Interrupted: " if summary.interrupted else ""
    click.echo(
        f"{stopped}{summary.simulations} simulations in {format_duration(summary.seconds)}"
        f" ({summary.tests_per_second:.0f} tests/s): {summary.failed} failures,"
        f" {summary.passed} passed, {summary.invalid} invalid, {summary.errors} errors{least}"
    )


def _print_failures(listed: Sequence[TestRecord]) -> None:
    table = Table(
        title="The most severe and most different failures",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
    )
    for column in ("test", "MOOBD (m)", "left on", "after (m)", "of (m)", "origin"):
        table.add_column(column, justify="left" if column in ("left on", "origin") else "right")
    for record in listed:
        candidate = record.candidate
        place = record.departure_distance
        table.add_row(
            str(candidate.id),
            "-" if record.moobd is None else f"{record.moobd:.2f}",
            record.departure_side or "-",
            "-" if place is None else f"{place:.0f}",
            f"{(len(candidate.curvatures) - 1) * candidate.step:.0f}",
            candidate.origin.operator,
        )
    _Results().print(table)


def _print_facts(facts: Sequence[tuple[str, str]]) -> None:
    for name, value in facts:
        click.echo(f"{name:<11}{value}")


def _shell(path: Path) -> str:
    """A path as it can be pasted into a shell."""
    import shlex

    text = str(path)
    return f'"{text}"' if sys.platform == "win32" and " " in text else shlex.quote(text)
