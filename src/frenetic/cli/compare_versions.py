"""The part of the command `compare` that compares two versions of a driver."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn, Self

import click
from msgspec import structs

from frenetic._support.option_text import part_word
from frenetic._support.words import counted
from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, this_command
from frenetic.cli.entries import was_given
from frenetic.cli.option_types import ParsedText
from frenetic.cli.rerun_options import campaign_source, interrupted, shown_driving
from frenetic.cli.versions_output import print_versions
from frenetic.errors import CampaignError, FreneticError
from frenetic.spec import Spec

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester
    from frenetic.rerun.back_to_back import BackToBack
    from frenetic.rerun.disturbances import Disturbance, QualityPlan

_NOT_DISTURBED: Final = "none"
"""Value of ``--disturb`` for no disturbed drives."""
_NO_DIFFERENCE_SHOWN: Final = 3
"""Exit code if the drives show neither driver to be better."""


@dataclass(frozen=True, kw_only=True)
class VersionsOptions:
    """Options of the command that compares two versions of a driver."""

    fresh: int
    """Number of fresh random roads."""
    quality: QualityPlan
    """Roads and disturbances of the comparison where both pass."""
    workers: int
    """Number of roads driven at once."""
    as_json: bool
    """Whether the result is printed as JSON."""
    out: tuple[Path, ...]
    """Pages to write."""

    @classmethod
    def of(cls, context: click.Context) -> Self:
        """Return the options of a command line."""
        from frenetic.rerun.disturbances import QualityPlan

        options = context.params
        return cls(
            fresh=options["fresh"],
            quality=QualityPlan(
                options["disturb"] if was_given(context, "disturb") else None,
                options["on_own_roads"],
            ),
            workers=options["workers"],
            as_json=options["as_json"],
            out=options["out"],
        )


def _read_disturbance(text: str) -> Disturbance:
    """Return the disturbance of NAME=AMOUNT[,NAME=AMOUNT...]; empty for none.

    Raises:
        FreneticError: no condition has one of the names.
        ValueError: the text has another form, or an amount is not allowed.
    """
    from frenetic.rerun.disturbances import check_disturbances

    if text == _NOT_DISTURBED:
        return {}
    disturbance: dict[str, float] = {}
    for part in text.split(","):
        name, _, amount_text = (word.strip() for word in part.partition("="))
        try:
            amount = float(amount_text)
        except ValueError:
            raise ValueError(
                f"{text!r} is not NAME=AMOUNT[,NAME=AMOUNT...], as in noise=0.1, nor"
                f" {_NOT_DISTURBED}"
            ) from None
        if name in disturbance:
            raise ValueError(f"{name} is there twice")
        disturbance[name] = amount
    check_disturbances([disturbance])
    return disturbance


disturb_option: Final = click.option(
    "--disturb",
    type=ParsedText("name=amount", _read_disturbance),
    metavar="NAME=AMOUNT",
    multiple=True,
    help="Drive the fresh roads also with a condition, or with several, noise=0.1,gust=10; may be"
    " repeated; 'none' for no such drives. [default: noise=0.1 and, on its own, gust=10]",
)
"""Option for the disturbances in which both versions drive."""
own_roads_option: Final = click.option(
    "--own-roads",
    "on_own_roads",
    is_flag=True,
    help="Compare the quality on the campaign's own roads, not on the fresh ones.",
)
"""Option for the roads on which quality is compared."""


@dataclass(frozen=True)
class _Versions:
    """Specs of two versions of a driver."""

    old: Spec
    new: Spec
    code_folder: Path
    """Folder in which the new version has to be made."""


@dataclass(frozen=True)
class _PlannedComparison:
    """What is driven to compare two versions on the roads of a campaign."""

    folder: Path
    """Folder of the campaign."""
    versions: _Versions
    tester: RoadTester
    """Tester with the new version."""
    quality: QualityPlan
    drives: int
    """Number of all drives."""


def compare_versions(
    folders: Sequence[Path], new_driver: CommandOptions, options: VersionsOptions
) -> NoReturn:
    """Print whether a new driver is better than the driver of campaigns, and end the command.

    Args:
        folders: folders of one campaign, or of several whose roads are of different classes.
        new_driver: the options ``--driver``, ``--as`` and ``--trust``.
        options: the other options.

    Raises:
        click.exceptions.Exit: always, with the exit code that says which driver is better.
    """
    from frenetic.analysis.quality_comparison import BETTER, WORSE
    from frenetic.rerun.versions_by_class import VersionsByClass, campaigns_by_class

    names = {"": folders[0]}
    if len(folders) > 1:
        names = campaigns_by_class(folders, on_own_roads=options.quality.on_own_roads)
    # All new versions are made first, so that a mistake shows before an old version drives.
    planned = {name: _planned(folder, new_driver, options) for name, folder in names.items()}
    results = _drive_all(planned, options, is_trusted=new_driver.is_trusted)
    versions = next(iter(planned.values())).versions
    result = VersionsByClass.of(results) if len(results) > 1 else results[""]
    for path in options.out:
        from frenetic.report.html.quality import write_quality_page

        write_quality_page(result, path, command=str(this_command()))
    if options.as_json:
        echo(json.dumps(result.as_json()))
    else:
        print_versions(result, (versions.old, versions.new))
        for path in options.out:
            echo(path)
    exit_codes = {BETTER: 0, WORSE: 1}
    raise click.exceptions.Exit(exit_codes.get(result.overall, _NO_DIFFERENCE_SHOWN))


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


def _planned(
    folder: Path, new_driver: CommandOptions, options: VersionsOptions
) -> _PlannedComparison:
    """Return what is driven on the roads of a campaign, after making the new version.

    Raises:
        FreneticError: both versions are the same, or cannot have a disturbance; or see `_versions`.
    """
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.rerun.back_to_back import check_differ
    from frenetic.rerun.old_version import campaign_tests, recorded_driver

    versions, fresh = _versions(folder, new_driver), options.fresh
    with CampaignStore.open(folder) as store:
        failed = store.counts().failed
        recorded, terms = recorded_driver(store), store.setting.terms
    with chdir(versions.code_folder):
        tester = RoadTester.of(versions.new, terms)
    check_differ(recorded, tester.described["driver"])
    plan = options.quality.resolved(tester)
    disturbed = 2 * len(plan.disturbances or ())
    drives = (2 + disturbed) * fresh + failed
    if plan.on_own_roads:
        drives = 2 * fresh + (1 + disturbed) * len(campaign_tests(folder)) + failed
    return _PlannedComparison(folder, versions, tester, plan, drives)


def _drive_all(
    planned: Mapping[str, _PlannedComparison], options: VersionsOptions, *, is_trusted: bool
) -> dict[str, BackToBack]:
    """Drive both versions on fresh roads and on the roads on which the old version failed.

    Args:
        planned: road class in words -> what is driven there.
        options: options of the command.
        is_trusted: whether the command line has ``--trust``.

    Raises:
        click.exceptions.Exit: drives are left after Ctrl-C.
        FreneticError: the simulator or the old version cannot be made.
    """
    from frenetic.rerun.back_to_back import compare_versions as compared
    from frenetic.rerun.old_version import fresh_roads_as_recorded

    log = Log()
    results: dict[str, BackToBack] = {}
    missing, total = 0, sum(plan.drives for plan in planned.values())
    with shown_driving(log, "Driving both versions", total) as on_event:
        driving: Any = {"workers": options.workers, "isolate": True, "on_event": on_event}
        for name, plan in planned.items():
            if missing:  # after Ctrl-C nothing more is driven
                missing += plan.drives
                continue
            roads = fresh_roads_as_recorded(
                plan.folder,
                plan.versions.old,
                fresh=options.fresh,
                quality_plan=plan.quality,
                is_trusted=is_trusted,
                **driving,
            )
            results[name] = compared(roads, plan.tester, **driving)
            missing = results[name].missing
    if missing:
        raise interrupted(log, f"{counted(missing, 'drive')} to go")
    return results
