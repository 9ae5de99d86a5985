"""What compare says of two versions of a driver."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click

from frenetic._support.words import capitalised, counted
from frenetic.cli.again import interrupted, recorded_spec, shown_driving
from frenetic.cli.console import Log, print_table, two_digits
from frenetic.cli.options import as_usage_error
from frenetic.errors import CampaignError
from frenetic.quantities import in_words

if TYPE_CHECKING:
    from frenetic.again.paired import BackToBack, Version
    from frenetic.again.versions import Plan, VersionDrives
    from frenetic.spec import Spec

_LISTED: Final = 10
"""Most distinct failures that are printed."""
_EXIT_CODES: Final = {"new is better": 0, "new is worse": 1}
"""Exit code of a verdict, 3 of others."""


def compare_versions(
    folder: Path,
    given: Mapping[str, Any],
    *,
    fresh: int,
    seed: int | None,
    repeats: int,
    workers: int,
    as_json: bool,
) -> NoReturn:
    """Says whether another driver is better than that of a campaign; ends the command.

    Args:
        folder: of the campaign.
        given: values of the options ``--driver`` and ``--as``.
        fresh: number of fresh random roads.
        seed: of these.
        repeats: drives of each road.
        workers: roads driven at once.
        as_json: whether to print the result as JSON.
    """
    from frenetic.again.paired import Version, back_to_back_document
    from frenetic.again.versions import as_recorded
    from frenetic.again.versions import plan as plan_roads

    with as_usage_error():
        plan = plan_roads(folder, fresh=fresh, seed=seed, repeats=repeats)
    old, new = _specs(folder, given)
    result = _driven(plan, partial(as_recorded, folder, old), new, workers)
    if as_json:
        click.echo(json.dumps(back_to_back_document(result)))
    else:
        _print(result, {Version.OLD: old, Version.NEW: new})
    raise click.exceptions.Exit(_EXIT_CODES.get(result.verdict, 3))


def _specs(folder: Path, given: Mapping[str, Any]) -> tuple[Spec, Spec]:
    """The specs of both versions.

    Raises:
        CampaignError: the campaign was started from Python, or its record is damaged.
        FreneticError: it names code that this user has not run.
    """
    from frenetic.campaign import CampaignStore

    with CampaignStore.open(folder) as store:
        if store.config.get("command") is None:
            raise CampaignError(
                f"{folder} was started from Python, so its parts have no names: compare the"
                " versions there, with frenetic.again.versions"
            )
        old = recorded_spec(store, {}, checked=False)
        return old, replace(old, driver=recorded_spec(store, given).driver)


def _driven(
    plan: Plan,
    old_version: Callable[[], AbstractContextManager[Spec]],
    new_spec: Spec,
    workers: int,
) -> BackToBack:
    from frenetic.again.versions import check_differ, drive, pair_up
    from frenetic.simulators.isolated import isolated
    from frenetic.spec import describe

    log = Log()
    # First both are made, so that a mistake in the new one shows before the old one has driven.
    made = []
    for version in (old_version, lambda: nullcontext(new_spec)):
        with version() as spec:
            made.append(describe(spec.make_driver()))
    simulator = new_spec.make_simulator()
    check_differ(*made)

    def driven(what: str, spec: Spec, old: VersionDrives | None, later: int) -> VersionDrives:
        driver = spec.make_driver()
        place = isolated(simulator, driver) if workers == 1 else simulator
        with shown_driving(log, f"Driving the {what} version", plan.drives) as show:
            found = drive(plan, place, driver, old, spec=spec, workers=workers, on_event=show)
        if found.missing:
            left = counted(found.missing + later, "drive")
            raise interrupted(log, f"{left} to go; the same command goes on")
        return found

    with old_version() as spec:
        old = driven("old", spec, None, plan.drives)
    return pair_up(plan, old, driven("new", new_spec, old, 0))


def _print(result: BackToBack, specs: Mapping[Version, Spec]) -> None:
    from frenetic.again.paired import Version
    from frenetic.again.verdicts import Change
    from frenetic.versions import innermost, short_version

    shown: list[Change] = [change for change in Change if change is not Change.NOT_JUDGED]
    if any(roads.count(Change.NOT_JUDGED) for roads in result.sets):
        shown.append(Change.NOT_JUDGED)
    click.echo(result.answer)
    for version, spec in specs.items():
        _, *words = spec.driver.words("driver")
        driver = result.old if version is Version.OLD else result.new
        click.echo(f"{version}: {shlex.join(words)} ({short_version(innermost(driver))})")
    if result.domain is not None:
        click.echo(f"domain: {result.domain.in_words()}")
    print_table(
        ("", ">judged", ">old fails", ">new fails", *(f">{change}" for change in shown)),
        [
            (
                roads.roads,
                len(roads.judged),
                *(roads.failing(version) for version in Version),
                *(roads.count(change) for change in shown),
            )
            for roads in result.sets
            if roads.pairs
        ],
    )
    if text := result.time_in_words:
        click.echo(capitalised(text))
    _print_distinct(result)
    for note in result.notes:
        click.echo(f"Note: {note}")


def _print_distinct(result: BackToBack) -> None:
    from frenetic.again.paired import Fate

    distinct = result.distinct
    if not distinct:
        return
    fates = (Fate.NEW, Fate.REMAINS, Fate.CHANGED, Fate.FIXED)
    counts = [(fate, sum(one.fate is fate for one in distinct)) for fate in fates]
    told = ", ".join(f"{number} {fate}" for fate, number in counts if number)
    print_table(
        ("what the driver does", ">old fails", ">new fails"),
        [(cause, *roads) for cause, roads in result.causes.items()],
        title=counted(len(result.causes), "cause"),
    )
    listed = sorted(distinct, key=lambda one: fates.index(one.fate))[:_LISTED]
    in_conditions = ["conditions"] if any(one.conditions for one in listed) else []
    print_table(
        ("", ">old fails", ">new fails", ">MOOBD (m)", "what happens", "such as", *in_conditions),
        [
            (
                one.fate,
                one.old,
                one.new,
                two_digits(one.moobd),
                one.description,
                f"{one.folder} {one.test_id}",
                *(in_words(one.conditions) or None for _ in in_conditions),
            )
            for one in listed
        ],
        title=f"{counted(len(distinct), 'distinct failure')}: {told}"
        + (f"; {_LISTED} are listed" if len(distinct) > _LISTED else ""),
    )
