"""The part of the command `compare` that compares two versions of a driver."""

from __future__ import annotations

import json
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click
from msgspec import structs

from frenetic._support.option_text import part_word
from frenetic._support.words import counted
from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, print_table, shell
from frenetic.cli.rerun_options import campaign_source, interrupted, shown_driving
from frenetic.errors import CampaignError, FreneticError
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.rerun.back_to_back import BackToBack

_NO_DIFFERENCE_SHOWN: Final = 3
"""Exit code if the drives show neither driver to be better."""


@dataclass(frozen=True)
class _Versions:
    """Specs of two versions of a driver."""

    old: Spec
    new: Spec
    code_folder: Path
    """Folder in which the new version has to be made."""


def compare_versions(
    folder: Path, options: CommandOptions, *, fresh: int, workers: int, as_json: bool
) -> NoReturn:
    """Print whether a new driver is better than a campaign's driver, and end the command.

    Args:
        folder: folder of the campaign.
        options: the options ``--driver`` and ``--as``.
        fresh: number of fresh random roads.
        workers: number of roads driven at once.
        as_json: whether to print the result as JSON.

    Raises:
        click.exceptions.Exit: always, with the exit code that says which driver is better.
    """
    from frenetic.rerun.back_to_back import BETTER, WORSE

    versions = _versions(folder, options)
    result = _drive_both(folder, versions, workers, fresh=fresh, is_trusted=options.is_trusted)
    if as_json:
        echo(json.dumps(result.as_json()))
    else:
        _print(result, versions)
    exit_codes = {BETTER: 0, WORSE: 1}
    raise click.exceptions.Exit(exit_codes.get(result.verdict, _NO_DIFFERENCE_SHOWN))


def _versions(folder: Path, options: CommandOptions) -> _Versions:
    """Return the specs of both versions, after checking that the user trusts their code.

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
        # The folder of the simulator, which both versions have, was told for the old one.
        new, code_folder = options.trusted(new, source, of_file=("driver",), noted=("simulator",))
        return _Versions(old, new, code_folder)


def _new_driver(folder: Path, old: Spec, options: CommandOptions) -> str | None:
    """Return the new driver, of ``--driver`` or of the file of ``--as``.

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


def _drive_both(
    folder: Path, versions: _Versions, workers: int, *, fresh: int, is_trusted: bool
) -> BackToBack:
    """Drive both versions on fresh roads and on the roads on which the old version failed.

    Args:
        folder: folder of the campaign.
        versions: specs of both versions.
        workers: number of roads driven at once.
        fresh: number of fresh random roads.
        is_trusted: whether the command line has ``--trust``.

    Raises:
        click.exceptions.Exit: drives are left after Ctrl-C.
        FreneticError: both versions are the same.
    """
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.rerun.back_to_back import check_differ
    from frenetic.rerun.back_to_back import compare_versions as compared
    from frenetic.rerun.old_version import fresh_roads_as_recorded, recorded_driver

    log = Log()
    with CampaignStore.open(folder) as store:
        drives = 2 * fresh + store.counts().failed
        recorded, terms = recorded_driver(store), store.setting.terms
    # The new version is made first, so that a mistake in it shows before the old version drives.
    with chdir(versions.code_folder):
        tester = RoadTester.of(versions.new, terms)
    check_differ(recorded, tester.described["driver"])
    with shown_driving(log, "Driving both versions", drives) as on_event:
        driving: Any = {"workers": workers, "isolate": True, "on_event": on_event}
        roads = fresh_roads_as_recorded(
            folder, versions.old, fresh=fresh, is_trusted=is_trusted, **driving
        )
        result = compared(roads, tester, **driving)
    if result.missing:
        raise interrupted(log, f"{counted(result.missing, 'drive')} to go")
    return result


def _print(result: BackToBack, versions: _Versions) -> None:
    """Print which driver is better, and the numbers from which that follows."""
    from frenetic.parts.records import innermost, short_version
    from frenetic.rerun.stability import Change

    echo(result.answer)
    for version, spec, record in (
        ("old", versions.old, result.old),
        ("new", versions.new, result.new),
    ):
        echo(f"{version}: {shell(str(spec.part('driver')))} ({short_version(innermost(record))})")
    if result.domain is not None:
        echo(f"domain: {result.domain.as_text()}")
    road_sets = {"fresh roads": result.fresh, "old's failing roads": result.known}
    print_table(
        ("", ">judged", ">old fails", ">new fails", *(f">{change}" for change in Change)),
        [
            (name, len(roads.judged), *roads.failing, *(roads.changes[change] for change in Change))
            for name, roads in road_sets.items()
            if roads.pairs
        ],
    )
    if result.causes:
        print_table(
            ("what the driver does", ">old fails", ">new fails"),
            [(cause, *failures) for cause, failures in result.causes.items()],
            title="On all these roads",
        )
    for note in result.notes:
        echo(f"Note: {note}")
