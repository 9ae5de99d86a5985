"""Shared parts of the commands that drive recorded roads: specs, tests, progress, interruption."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import chdir, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from frenetic.cli import INTERRUPTED, Invocation
from frenetic.cli.command_options import CommandOptions, PartsSource
from frenetic.cli.console import Log, announced_compilation, counted_progress, shell, this_command
from frenetic.cli.options import as_usage_error
from frenetic.cli.simulator_place import without_place
from frenetic.errors import CampaignError
from frenetic.spec import DRIVEN, Signed, Spec, sign_driven

if TYPE_CHECKING:
    from collections.abc import Iterator

    from frenetic.campaign import CampaignStore, Event, RoadTester
    from frenetic.road.files import RoadFile


def campaign_source(store: CampaignStore) -> PartsSource:
    """Return a campaign as a source of parts, which ``--trust`` signs in its database."""
    from frenetic.campaign.reader import SIGNATURE, SOURCES, STARTED_IN
    from frenetic.campaign.store import CampaignStore
    from frenetic.campaign.stored_spec import signed_spec

    def sign(signed: Signed) -> None:
        facts = {STARTED_IN: signed.folder, SIGNATURE: signed.signature}
        try:
            with CampaignStore.open(store.folder, readonly=False) as written:
                written.keep(**facts)
        except CampaignError as error:
            Log().print(f"Note: --trust holds for this command only: {error}", markup=False)

    return PartsSource(store.folder, signed_spec(store), sources=store.fact(SOURCES), sign=sign)


def campaign_spec(
    store: CampaignStore, options: CommandOptions, *, needs_trust: bool = True
) -> tuple[Spec, Path]:
    """Return a campaign's spec with the command line's changes, and the folder of its parts.

    Args:
        store: the campaign.
        options: options of the command line.
        needs_trust: whether parts are made, so that the user must have trusted the campaign's code
            (`frenetic.parts.trust`).

    Raises:
        CampaignError: the campaign was started from Python and an option for a part is missing, or
            its record is damaged.
        FreneticError: an option is out of range, or the user has not trusted the campaign's code.
        click.UsageError: the command line has ``--roads``.
    """
    from frenetic.campaign.configuration import SPEC
    from frenetic.campaign.stored_spec import is_client_driven

    if options.says("roads"):
        raise click.UsageError("--roads is for a ROAD file: a campaign has its own road class")
    source, folder = campaign_source(store), Path.cwd()
    spec = options.over(source.spec)
    if needs_trust:
        spec, folder = options.trusted(spec, source)
    if store.config.get(SPEC) is None and None in (spec.driver, spec.simulator):
        origin, alternative = "was started from Python", ", or do it from Python"
        if is_client_driven(store.config):
            origin, alternative = "was driven by a client", ""
        raise CampaignError(
            f"{store.folder} {origin}, so its driver and simulator have no names: give --driver and"
            f" --simulator{alternative}"
        )
    return spec, folder


def tester_of_options(options: CommandOptions) -> RoadTester:
    """Return the tester that drives new roads as the command line says.

    Raises:
        click.UsageError: an option is out of range, or sets a condition that the domain draws.
        FreneticError: a part cannot be made.
    """
    from frenetic.campaign.tester import RoadTester

    spec, code_folder = options.trusted(options.over(Spec(), roads_are_given=False))
    options.check_drawn(spec)
    with as_usage_error(), chdir(code_folder):
        return RoadTester.of(spec)


def tester_of_campaign(store: CampaignStore, options: CommandOptions) -> RoadTester:
    """Return the tester that drives on a campaign's terms, with the command line's changes.

    Raises:
        CampaignError: see `campaign_spec`.
        FreneticError: a part cannot be made.
    """
    from frenetic.rerun.rerun import campaign_tester

    spec, code_folder = campaign_spec(store, options)
    with chdir(code_folder):
        return campaign_tester(store, spec)


def file_spec(
    options: CommandOptions, file: RoadFile, *, needs_trust: bool = True
) -> tuple[Spec, Path]:
    """Return the spec recorded in a road's file, with the options over it, and its parts' folder.

    A file without such a record is driven as the options and their defaults say.

    Args:
        options: options of the command line.
        file: the road's file.
        needs_trust: whether parts are made, so that the user must have trusted the file's code.

    Raises:
        FreneticError: the user has not trusted the code that the file names, or its record is
            damaged.
    """
    spec, source = Spec(), None
    if has_driven := DRIVEN in file.entries:
        recorded = Spec.of_driven(file.entries[DRIVEN], source=file.path)
        source = PartsSource(file.path, recorded, sign=partial(sign_driven, file.path))
        spec = without_place(recorded)  # no file decides which program is started
    spec = options.over(spec, roads_are_given=has_driven)
    return options.trusted(spec, source) if needs_trust else (spec, Path.cwd())


def chosen_tests(
    store: CampaignStore, test_ids: tuple[int, ...], top: int | None
) -> list[int] | None:
    """Return the IDs of the tests that the command line chooses; None if it chooses none.

    Args:
        store: the campaign.
        test_ids: IDs on the command line.
        top: number of ``--top``; None without the option.

    Raises:
        click.UsageError: the command line has IDs and ``--top``.
    """
    from frenetic.analysis.clusters import representative_failures

    if test_ids and top is not None:
        raise click.UsageError("--top and the ID of a test exclude each other")
    if top is not None:
        return [record.candidate.id for record in representative_failures(store, top)]
    return list(dict.fromkeys(test_ids)) or None


@contextmanager
def shown_driving(
    log: Log, work: str, total: int | None = None
) -> Iterator[Callable[[Event], None]]:
    """Yield a function that shows the events of campaigns that drive known roads.

    Args:
        log: the console for progress.
        work: verb for the work, such as "Driving again".
        total: number of drives of all campaigns; by default the budget of the only campaign.
    """
    drives: dict[Path, int] = {}  # folder of a campaign -> number of its drives

    with (
        announced_compilation(log) as compiled,
        counted_progress(log, work) as show,
        as_usage_error(),
    ):

        def on_event(event: Event) -> None:
            if event.kind == "interrupted":
                log.stopping()
                return
            if event.kind == "started":
                compiled()
            summary = event.summary
            drives[summary.folder] = summary.simulations
            done, all_drives = sum(drives.values()), total
            if all_drives is None and summary.budget_spent:  # of a budget in drives
                all_drives = round(summary.simulations / summary.budget_spent)
            # An earlier command with more drives may have stored more than this one needs.
            if all_drives is not None and done <= all_drives:
                show(done, all_drives)

        yield on_event


def kept_text(driven: Path | None, campaign: Path, *, is_reported: bool) -> str:
    """Return where drives are kept, and the command that shows them.

    Args:
        driven: folder of the drives.
        campaign: folder of the campaign whose report may show the drives.
        is_reported: whether the campaign's report shows the drives.
    """
    see = f"to see it: frenetic report {shell(campaign)}"
    return f"Kept in {driven}; {see if is_reported else 'the same command shows it'}"


def interrupted(
    log: Log, remaining: str, command: Invocation | None = None
) -> click.exceptions.Exit:
    """Print what is left to do after Ctrl-C and the command that continues; return the exit.

    Args:
        log: the console for progress.
        remaining: what is left to do, such as "12 drives to go".
        command: the command that continues; None if it is the present command line.
    """
    advice = f"the same command continues: {this_command()}"
    if command is not None:
        advice = f"go on: {command}"
    log.print(f"Interrupted: {remaining}; {advice}", markup=False)
    return click.exceptions.Exit(INTERRUPTED)
