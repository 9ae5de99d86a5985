"""What compare says of two versions of a driver."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from frenetic._support.words import counted
from frenetic.cli import echo
from frenetic.cli.again import interrupted, recorded_spec, shown_driving
from frenetic.cli.console import Log, print_table
from frenetic.errors import CampaignError

if TYPE_CHECKING:
    from frenetic.again.versions import BackToBack
    from frenetic.spec import Spec


def compare_versions(
    folder: Path, given: Mapping[str, Any], *, fresh: int, workers: int, as_json: bool
) -> NoReturn:
    """Says whether another driver is better than that of a campaign; ends the command.

    Args:
        folder: of the campaign.
        given: values of the options ``--driver`` and ``--as``.
        fresh: number of fresh random roads.
        workers: roads driven at once.
        as_json: whether to print the result as JSON.
    """
    from frenetic.again.versions import BETTER, WORSE

    old, new = _specs(folder, given)
    result = _driven(folder, old, new, fresh, workers)
    if as_json:
        echo(json.dumps(result.as_json()))
    else:
        _print(result, old, new)
    raise click.exceptions.Exit({BETTER: 0, WORSE: 1}.get(result.verdict, 3))


def _specs(folder: Path, given: Mapping[str, Any]) -> tuple[Spec, Spec]:
    """The specs of both versions.

    Raises:
        CampaignError: the campaign was started from Python, or its record is damaged.
        FreneticError: it names code that this user has not run.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.campaign.state import is_told

    with CampaignStore.open(folder) as store:
        if store.config.get("run") is None:
            how = "was told its results" if is_told(store.config) else "was started from Python"
            raise CampaignError(
                f"{folder} {how}, so its parts have no names: compare the versions from Python,"
                " with frenetic.again.versions"
            )
        old = recorded_spec(store, {}, checked=False)
        return old, replace(old, driver=recorded_spec(store, given).driver)


def _driven(folder: Path, old: Spec, new: Spec, fresh: int, workers: int) -> BackToBack:
    from frenetic.again.versions import as_recorded, check_differ, fresh_roads
    from frenetic.again.versions import compare_versions as compared
    from frenetic.campaign import CampaignStore
    from frenetic.description import describe
    from frenetic.simulators.isolated import isolated

    log, simulator = Log(), new.make_simulator()
    # Both are made first, so that a mistake in the new one shows before the old one has driven.
    with as_recorded(folder, old) as recorded:
        described = describe(recorded.make_driver())
    check_differ(described, describe(new.make_driver()))
    with CampaignStore.open(folder) as store:
        drives = 2 * fresh + store.counts().failed
    with shown_driving(log, "Driving both versions", drives) as on_event:
        how: Any = {"workers": workers, "on_event": on_event}
        with as_recorded(folder, old) as recorded:
            driver = recorded.make_driver()
            place = isolated(simulator, driver) if workers == 1 else simulator
            roads = fresh_roads(folder, place, driver, fresh=fresh, spec=recorded, **how)
        driver = new.make_driver()
        place = isolated(simulator, driver) if workers == 1 else simulator
        result = compared(roads, place, driver, **how)
    if result.missing:
        left = counted(result.missing, "drive")
        raise interrupted(log, f"{left} to go")
    return result


def _print(result: BackToBack, old: Spec, new: Spec) -> None:
    from frenetic.again.verdicts import Change
    from frenetic.versions import innermost, short_version

    echo(result.answer)
    for version, spec, driver in (("old", old, result.old), ("new", new, result.new)):
        _, *words = spec.driver.words("driver")
        echo(f"{version}: {shlex.join(words)} ({short_version(innermost(driver))})")
    if result.domain is not None:
        echo(f"domain: {result.domain.in_words()}")
    sets = {"fresh roads": result.fresh, "old's failing roads": result.known}
    print_table(
        ("", ">judged", ">old fails", ">new fails", *(f">{change}" for change in Change)),
        [
            (name, len(roads.judged), *roads.failing, *(roads.changes[one] for one in Change))
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
