"""Shared parts of the commands that drive recorded roads, and of estimate."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from frenetic.cli import Invocation
from frenetic.cli.command_options import CommandOptions, PartsSource
from frenetic.cli.console import Log, announced_compilation, counted_progress, this_command
from frenetic.cli.options import as_usage_error
from frenetic.cli.simulator_place import without_place
from frenetic.errors import CampaignError
from frenetic.spec import DRIVEN, Signed, Spec, sign_driven

if TYPE_CHECKING:
    from collections.abc import Iterator

    from frenetic.campaign import CampaignStore, Event
    from frenetic.road.files import RoadFile


def campaign_source(store: CampaignStore) -> PartsSource:
    """Return a campaign as a source of parts."""
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
    store: CampaignStore, options: CommandOptions, *, checked: bool = True
) -> tuple[Spec, Path]:
    """Return a campaign's spec with the command line's changes, and the folder of its parts.

    Args:
        store: the campaign.
        options: of the command line.
        checked: whether code that it names has to be trusted, see `frenetic.parts.trust`.

    Raises:
        CampaignError: the campaign was started from Python and a part is not given, or its record
            is damaged.
        FreneticError: a given rule is out of range.
        click.UsageError: other roads are given.
    """
    from frenetic.campaign.configuration import SPEC
    from frenetic.campaign.stored_spec import is_client_driven

    if options.says("roads"):
        raise click.UsageError("--roads is for a ROAD file: a campaign has its own road class")
    source, folder = campaign_source(store), Path.cwd()
    spec = options.over(source.spec)
    if checked:
        spec, folder = options.trusted(spec, source)
    if store.config.get(SPEC) is None and None in (spec.driver, spec.simulator):
        origin, elsewhere = "was started from Python", ", or do it from Python"
        if is_client_driven(store.config):
            origin, elsewhere = "was driven by a client", ""
        raise CampaignError(
            f"{store.folder} {origin}, so its driver and simulator have no names: give --driver and"
            f" --simulator{elsewhere}"
        )
    return spec, folder


def file_spec(
    options: CommandOptions, file: RoadFile, *, checked: bool = True
) -> tuple[Spec, Path]:
    """Return the spec with which a road's file was driven, and the folder of its parts.

    Files that do not say it are driven as the options and their defaults say.

    Args:
        options: of the command line.
        file: the road's file.
        checked: as for `campaign_spec`.

    Raises:
        FreneticError: the file names parts that are not loaded unasked, or its record is damaged.
    """
    spec, source = Spec(), None
    if has_driven := DRIVEN in file.entries:
        recorded = Spec.of_driven(file.entries[DRIVEN], source=file.path)
        source = PartsSource(file.path, recorded, sign=partial(sign_driven, file.path))
        spec = without_place(recorded)  # which program is started, no file says
    spec = options.over(spec, has_roads=has_driven)
    return options.trusted(spec, source) if checked else (spec, Path.cwd())


def chosen_tests(
    store: CampaignStore, test_ids: tuple[int, ...], top: int | None
) -> list[int] | None:
    """Return the tests that the command line names; None if it names none.

    Raises:
        click.UsageError: it names them twice.
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
    """Yield a function that shows the events of campaigns that drive again.

    Args:
        log: the console for progress.
        work: the work, such as "Driving again".
        total: number of drives of all campaigns; by default from the budget of the only one.
    """
    drives: dict[Path, int] = {}  # folder of a campaign -> its drives

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
            now = event.summary
            drives[now.folder] = now.simulations
            done = sum(drives.values())
            whole = total
            if whole is None and now.budget_spent:  # the share of the drives
                whole = round(now.simulations / now.budget_spent)
            if whole is not None and done <= whole:  # more may be stored than is wanted now
                show(done, whole)

        yield on_event


def interrupted(log: Log, rest: str, command: Invocation | None = None) -> click.exceptions.Exit:
    """Print what is left to do and the command that goes on; return the exit."""
    goes_on = f"the same command goes on: {this_command()}"
    if command is not None:
        goes_on = f"go on: {command}"
    log.print(f"Interrupted: {rest}; {goes_on}", markup=False)
    return click.exceptions.Exit(130)
