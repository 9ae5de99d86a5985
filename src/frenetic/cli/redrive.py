"""Shared parts of the commands that drive roads again: robustness, confirm, regression."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import click

from frenetic.cli.console import Log, announced_compilation, counted_progress
from frenetic.cli.options import as_usage_error, drive_limit_option, json_option
from frenetic.cli.parts import part_options
from frenetic.errors import CampaignError
from frenetic.spec import Spec

if TYPE_CHECKING:
    from collections.abc import Iterator

    from frenetic.campaign import CampaignStore

P = ParamSpec("P")
R = TypeVar("R")


rows_option = click.option(
    "--rows", "with_rows", is_flag=True, help="Print a row per test after the summary."
)


def redriving_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose parts and workers, and --json."""
    workers = click.option(
        "--workers",
        type=click.IntRange(1),
        default=1,
        show_default=True,
        metavar="N",
        help="Drive on N roads at once, in processes of their own.",
    )
    return part_options(workers(drive_limit_option(json_option(command))))


def recorded_spec(store: CampaignStore, given: Mapping[str, Any]) -> Spec:
    """The spec of a campaign, with replacements from the command line.

    Args:
        store: the campaign.
        given: values of the options of `part_options`.

    Raises:
        CampaignError: the campaign was started from Python and a part is not given, or its record
            is damaged.
        FreneticError: a given rule is out of range.
    """
    from frenetic.campaign.store import DATABASE

    spec = Spec.from_json(store.config, source=store.folder / DATABASE).replaced(given)
    if spec.driver.name is None or spec.simulator.name is None:
        raise CampaignError(
            f"{store.folder} was started from Python, so its driver and simulator have no names:"
            " give --driver and --simulator, or do it from Python"
        )
    return spec


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
def shown_driving(log: Log, what: str) -> Iterator[Mapping[str, Any]]:
    """Gives the callbacks for `frenetic.redrive`.

    Args:
        log: the console for progress.
        what: the work, such as "Driving again".
    """
    with (
        announced_compilation(log) as compiled,
        counted_progress(log, what) as show,
        as_usage_error(),
    ):
        yield {"on_progress": show, "on_start": compiled, "on_interrupt": log.stopping}


def interrupted(log: Log, missing: int) -> click.exceptions.Exit:
    """Prints the number of undriven roads and ends the command."""
    log.print(f"Interrupted: {missing} roads were not driven")
    return click.exceptions.Exit(130)
