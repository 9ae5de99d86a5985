"""The part of compare that compares two versions of a driver."""

from __future__ import annotations

import json
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
from msgspec import structs

from frenetic._support.words import counted, part_word
from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, print_table, shell
from frenetic.cli.rerun_options import campaign_source, interrupted, shown_driving
from frenetic.errors import CampaignError, FreneticError
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.rerun.back_to_back import BackToBack


def compare_versions(
    folder: Path, options: CommandOptions, *, fresh: int, workers: int, as_json: bool
) -> NoReturn:
    """Say whether a new driver is better than a campaign's driver, and end the command.

    Args:
        folder: folder of the campaign.
        options: the options ``--driver`` and ``--as``.
        fresh: number of fresh random roads.
        workers: roads driven at once.
        as_json: whether to print the result as JSON.
    """
    from frenetic.rerun.back_to_back import BETTER, WORSE

    old, new, place = _specs(folder, options)
    is_trusted = options.is_trusted
    result = _driven(folder, old, new, place, workers, fresh=fresh, is_trusted=is_trusted)
    if as_json:
        echo(json.dumps(result.as_json()))
    else:
        _print(result, old, new)
    raise click.exceptions.Exit({BETTER: 0, WORSE: 1}.get(result.verdict, 3))


def _specs(folder: Path, options: CommandOptions) -> tuple[Spec, Spec, Path]:
    """Return the specs of both versions, and the folder in which the new driver is made.

    Raises:
        CampaignError: the campaign was started from Python, or its record is damaged.
        FreneticError: the campaign names code that this user has not trusted, or the file of
            ``--as`` changes more than the driver.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.configuration import SPEC
    from frenetic.campaign.stored_spec import is_client_driven

    with CampaignStore.open(folder) as store:
        if store.config.get(SPEC) is None:
            origin = (
                "was driven by a client"
                if is_client_driven(store.config)
                else "was started from Python"
            )
            raise CampaignError(
                f"{folder} {origin}, so its parts have no names: compare the versions from Python,"
                " with frenetic.rerun.back_to_back"
            )
        source = campaign_source(store)
        old = Spec.of(source.spec)
        CommandOptions(is_trusted=options.is_trusted).trusted(old, source)
        new = structs.replace(old, driver=_new_driver(folder, old, options))
        return old, *options.trusted(new, source, of_file=("driver",), noted=("simulator",))


def _new_driver(folder: Path, old: Spec, options: CommandOptions) -> str | None:
    """Return the new driver; the file of ``--as`` must agree with the campaign in all else.

    Raises:
        FreneticError: the file of ``--as`` names no driver, or differs in more than the driver.
    """
    file = CommandOptions(driven_as=options.driven_as).over(Spec())
    if options.driven_as is not None and file.driver is None:
        raise FreneticError(
            f"{options.driven_as} names no driver: name one there, or give --driver"
        )
    recorded = {**old.entries(), "simulator": part_word(*old.part("simulator"))}
    others = {name: value for name, value in file.entries().items() if name != "driver"}
    if differing := [repr(name) for name, value in others.items() if value != recorded.get(name)]:
        raise FreneticError(
            f"{options.driven_as} and {folder} differ in {', '.join(differing)}, but both"
            " versions drive as the campaign did: leave out all but the driver"
        )
    return options.over(old).driver


def _driven(
    folder: Path, old: Spec, new: Spec, place: Path, workers: int, *, fresh: int, is_trusted: bool
) -> BackToBack:
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.rerun.back_to_back import check_differ
    from frenetic.rerun.back_to_back import compare_versions as compared
    from frenetic.rerun.old_version import fresh_roads_as_recorded, recorded_driver

    log = Log()
    with CampaignStore.open(folder) as store:
        drives = 2 * fresh + store.counts().failed
        recorded, terms = recorded_driver(store), store.setting.terms
    # The new version is made first, so that a mistake in it shows before the old version drives.
    with chdir(place):
        tester = RoadTester.of(new, terms)
    check_differ(recorded, tester.described["driver"])
    with shown_driving(log, "Driving both versions", drives) as on_event:
        driving: Any = {"workers": workers, "isolate": True, "on_event": on_event}
        roads = fresh_roads_as_recorded(folder, old, fresh=fresh, is_trusted=is_trusted, **driving)
        result = compared(roads, tester, **driving)
    if result.missing:
        raise interrupted(log, f"{counted(result.missing, 'drive')} to go")
    return result


def _print(result: BackToBack, old: Spec, new: Spec) -> None:
    from frenetic.parts.versions import innermost, short_version
    from frenetic.rerun.stability import Change

    echo(result.answer)
    for version, spec, driver in (("old", old, result.old), ("new", new, result.new)):
        echo(f"{version}: {shell(str(spec.part('driver')))} ({short_version(innermost(driver))})")
    if result.domain is not None:
        echo(f"domain: {result.domain.as_text()}")
    sets = {"fresh roads": result.fresh, "old's failing roads": result.known}
    print_table(
        ("", ">judged", ">old fails", ">new fails", *(f">{change}" for change in Change)),
        [
            (name, len(roads.judged), *roads.failing, *(roads.changes[change] for change in Change))
            for name, roads in sets.items()
            if roads.pairs
        ],
    )
    if result.causes:
        print_table(
            ("what the driver does", ">old fails", ">new fails"),
            [(cause, *roads) for cause, roads in result.causes.items()],
            title="On all these roads",
        )
    for note in result.notes:
        echo(f"Note: {note}")
