"""The command that says whether a new version of a driver is better: back-to-back."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import capitalised, counted
from frenetic.cli.again import interrupted, recorded_spec, shown_driving
from frenetic.cli.console import Log, print_table, two_digits
from frenetic.cli.options import (
    CampaignFolder,
    GroupedCommand,
    as_usage_error,
    count_option,
    drive_limit_option,
    json_option,
    workers_option,
)
from frenetic.cli.parts import moved, part_choice, place_option
from frenetic.errors import CampaignError

if TYPE_CHECKING:
    from frenetic.again.paired import BackToBack, Version
    from frenetic.again.versions import Plan
    from frenetic.campaign import Event
    from frenetic.spec import Spec

_LISTED: Final = 10
"""Most distinct failures that are printed."""
_EXIT_CODES: Final = {"new is better": 0, "new is worse": 1, "cannot tell": 3}


@click.command(name="back-to-back", cls=GroupedCommand)
@click.argument("old", type=CampaignFolder())
@click.argument("new", type=CampaignFolder(), required=False)
@part_choice("driver", "The new version, in place of NEW's driver.")
@part_choice(
    "driver",
    "The old version, in place of OLD's driver.",
    name="old-driver",
)
@count_option("--fresh", "Number of fresh random roads.", default=200)
@click.option(
    "--seed",
    type=click.IntRange(0),
    metavar="S",
    help="Seed of the fresh roads. [default: the first from 0 that no campaign has]",
)
@count_option(
    "--repeats",
    "Drive each road N times with each version: for what does not repeat, and for noise, whose"
    " errors then differ.",
    default=1,
)
@count_option("--top", "Only the N most telling failures of each campaign. [default: all]", least=0)
@workers_option
@drive_limit_option
@place_option
@json_option
def back_to_back(
    old: Path,
    new: Path | None,
    driver: str | None,
    driver_options: tuple[tuple[str, Any], ...],
    old_driver: str | None,
    old_driver_options: tuple[tuple[str, Any], ...],
    simulator: str | None,
    simulator_options: tuple[tuple[str, Any], ...],
    fresh: int,
    seed: int | None,
    repeats: int,
    top: int | None,
    workers: int,
    drive_limit: float | None,
    as_json: bool,
) -> None:
    """Say whether a new version of a driver is better than the old one.

    OLD is a campaign with the old version. The new one is that of the campaign NEW, or --driver.
    Both drive on fresh random roads and on the failing roads of each campaign, in the same
    simulator, by the same rules. The answer rests on the fresh roads: the difference of the failure
    rates, with its interval. What is driven is stored, so the same command goes on after Ctrl-C.
    The exit code is 0 if the new version is better, 1 if it is worse, 3 if that cannot be told, 2
    if something is wrong with the command.
    """
    from frenetic.again.paired import Version, back_to_back_document
    from frenetic.again.versions import as_recorded
    from frenetic.again.versions import plan as plan_roads

    if new is None and driver is None and not driver_options:
        raise click.UsageError(
            "say what the new version is: give its campaign after OLD, or --driver"
        )
    with as_usage_error():
        plan = plan_roads(old, new, fresh=fresh, seed=seed, repeats=repeats, top=top)
    place = simulator, simulator_options
    is_recorded = old_driver is None and not old_driver_options
    old_spec = _spec(old, old_driver, old_driver_options, place, checked=not is_recorded)
    new_spec = _spec(new or old, driver, driver_options, place)
    old_version = partial(as_recorded, old) if is_recorded else nullcontext
    result = _driven(plan, lambda: old_version(old_spec), new_spec, workers, drive_limit)
    if as_json:
        click.echo(json.dumps(back_to_back_document(result)))
    else:
        _print(result, {Version.OLD: old_spec, Version.NEW: new_spec})
    raise click.exceptions.Exit(_EXIT_CODES[result.verdict])


def _spec(
    folder: Path,
    driver: str | None,
    options: tuple[tuple[str, Any], ...],
    place: tuple[str | None, tuple[tuple[str, Any], ...]],
    *,
    checked: bool = True,
) -> Spec:
    """The spec of a version, whose parts have to be trusted if that is ``checked``.

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
        given = {"driver": driver, "driver_options": options}
        spec = recorded_spec(store, given, checked=checked)
        recorded: Any = store.config["driver"]
    simulator = spec.simulator
    return replace(
        spec,
        driver=replace(spec.driver, made=recorded if spec.driver.made else {}),
        simulator=replace(simulator, options=moved(simulator, *place)),
    )


def _driven(
    plan: Plan,
    old_version: Callable[[], AbstractContextManager[Spec]],
    new_spec: Spec,
    workers: int,
    drive_limit: float | None,
) -> BackToBack:
    from frenetic.again.versions import (
        Driving,
        check_differ,
        drive_new,
        drive_old,
        pair_up,
    )
    from frenetic.simulators.isolated import isolated
    from frenetic.spec import describe
    from frenetic.versions import other_version

    log = Log()
    # First both are made, so that a mistake in the new one shows before the old one has driven.
    made = []
    for version in (old_version, lambda: nullcontext(new_spec)):
        with version() as spec:
            made.append(describe(spec.make_driver()))
    simulator = new_spec.make_simulator()
    check_differ(*made)
    if plan.new is not None and (note := other_version("driver", new_spec.driver.made, made[1])):
        log.print(f"Note: {plan.new}: {note}", markup=False)

    def driving(spec: Spec, on_event: Callable[[Event], None]) -> Driving:
        driver = spec.make_driver()
        place = isolated(simulator, driver, drive_limit) if workers == 1 else simulator
        return Driving(place, driver, workers, drive_limit, on_event)

    with (
        old_version() as spec,
        shown_driving(log, "Driving the old version", plan.drives) as on_event,
    ):
        old = drive_old(plan, driving(spec, on_event), spec)
    to_go = "{} to go; the same command goes on"
    if old.missing:
        raise interrupted(log, to_go.format(counted(old.missing + plan.drives, "drive")))
    with shown_driving(log, "Driving the new version", plan.drives) as on_event:
        new = drive_new(plan, driving(new_spec, on_event), old)
    if new.missing:
        raise interrupted(log, to_go.format(counted(new.missing, "drive")))
    return pair_up(plan, old, new)


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
    for text in result.trade_offs:
        click.echo(capitalised(text))
    _print_distinct(result)
    for note in result.notes:
        click.echo(f"Note: {note}")


def _print_distinct(result: BackToBack) -> None:
    from frenetic.again.paired import Fate

    distinct = result.distinct
    if not distinct:
        return
    fates = (Fate.NEW, Fate.REMAINS, Fate.REPLACED, Fate.FIXED)
    counts = [(fate, sum(one.fate is fate for one in distinct)) for fate in fates]
    told = ", ".join(f"{number} {fate}" for fate, number in counts if number)
    print_table(
        ("", ">old fails", ">new fails", ">MOOBD (m)", "what happens", "such as"),
        [
            (
                one.fate,
                one.old,
                one.new,
                two_digits(one.moobd),
                one.description,
                f"{one.folder} {one.test_id}",
            )
            for one in sorted(distinct, key=lambda one: fates.index(one.fate))[:_LISTED]
        ],
        title=f"{counted(len(distinct), 'distinct failure')}: {told}"
        + (f"; {_LISTED} are listed" if len(distinct) > _LISTED else ""),
    )
