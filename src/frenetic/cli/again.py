"""Shared parts of the commands that drive recorded roads, and of estimate, which draws them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli import Invocation
from frenetic.cli.console import Log, announced_compilation, counted_progress, this_command
from frenetic.cli.options import as_usage_error
from frenetic.cli.parts import given_options, with_given, without_place
from frenetic.errors import CampaignError
from frenetic.spec import DRIVEN, Spec
from frenetic.trust import NOT_DRIVING

if TYPE_CHECKING:
    from collections.abc import Iterator

    from frenetic.campaign import CampaignStore, Event
    from frenetic.road.files import RoadFile


def recorded_spec(store: CampaignStore, given: Mapping[str, Any], *, checked: bool = True) -> Spec:
    """The spec of a campaign, with replacements from the command line.

    Args:
        store: the campaign.
        given: values of the options of `part_options`.
        checked: whether code that it names has to be trusted, see `frenetic.trust`.

    Raises:
        CampaignError: the campaign was started from Python and a part is not given, or its record
            is damaged.
        FreneticError: a given rule is out of range.
        click.UsageError: another map is given.
    """
    from frenetic.campaign.campaign import STARTED_IN
    from frenetic.campaign.state import is_told
    from frenetic.campaign.store import DATABASE

    if given.get("road_class") is not None:
        raise click.UsageError("--roads is for a ROAD file: a campaign has its own road class")
    recorded = Spec.from_json(store.config, source=store.folder / DATABASE)
    spec = with_given(recorded, given)
    if checked:
        started_in = str(store.fact(STARTED_IN) or "")
        spec.require_trusted(store.folder, named_parts(given), started_in=started_in)
    if spec.driver.name is None or spec.simulator.name is None:
        how, elsewhere = "was started from Python", ", or do it from Python"
        if is_told(store.config):
            how, elsewhere = "was told its results", ""
        raise CampaignError(
            f"{store.folder} {how}, so its driver and simulator have no names: give --driver and"
            f" --simulator{elsewhere}"
        )
    return spec


def named_parts(given: Mapping[str, Any]) -> list[str]:
    """Kinds of parts that the command line names itself, or does not make."""
    return [*NOT_DRIVING, *(kind for kind in ("driver", "simulator") if given.get(kind))]


def file_spec(context: click.Context, file: RoadFile, *, checked: bool = True) -> Spec:
    """The spec with which a road's file was driven, with replacements from the command line.

    Files that do not say it are driven as the options and their defaults say.

    Args:
        context: of the command.
        file: the road's file.
        checked: as for `recorded_spec`.

    Raises:
        FreneticError: the file names parts that are not loaded unasked, or its record is damaged.
    """
    given = given_options(context)
    if DRIVEN not in file.entries:
        return with_given(Spec(), given, has_roads=False)
    recorded = Spec.from_drive_record(file.entries[DRIVEN], source=file.path)
    # Which program is started, no file says.
    recorded = replace(recorded, simulator=without_place(recorded.simulator))
    spec = with_given(recorded, given)
    if not checked:
        return spec
    spec.require_trusted(file.path, named_parts(given))
    return spec.with_limit()  # which loads the simulator


def chosen_tests(
    store: CampaignStore, test_ids: tuple[int, ...], top: int | None
) -> list[int] | None:
    """The tests that the command line names; None if it names none.

    Raises:
        click.UsageError: it names them twice.
    """
    from frenetic.analysis.failures import representative_failures

    if test_ids and top is not None:
        raise click.UsageError("--top and the ID of a test exclude each other")
    if top is not None:
        return [record.candidate.id for record in representative_failures(store, top)]
    return list(dict.fromkeys(test_ids)) or None


@contextmanager
def shown_driving(
    log: Log, what: str, total: int | None = None
) -> Iterator[Callable[[Event], None]]:
    """Gives the function that shows the events of campaigns that drive again.

    Args:
        log: the console for progress.
        what: the work, such as "Driving again".
        total: number of drives of all campaigns; by default from the budget of the only one.
    """
    drives: dict[Path, int] = {}  # folder of a campaign -> its drives

    with (
        announced_compilation(log) as compiled,
        counted_progress(log, what) as show,
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


def interrupted(log: Log, what: str, command: Invocation | None = None) -> click.exceptions.Exit:
    """Print what is left to do, and which command goes on, by default the same; end this one."""
    goes_on = f"the same command goes on: {this_command()}"
    if command is not None:
        goes_on = f"go on: {command}"
    log.print(f"Interrupted: {what}; {goes_on}", markup=False)
    return click.exceptions.Exit(130)
