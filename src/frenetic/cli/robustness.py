"""The command that measures how often failures repeat: robustness."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli.console import Log, print_table, two_digits
from frenetic.cli.options import AskedRange, CampaignFolder, GroupedCommand, Range, count_option
from frenetic.cli.redrive import (
    chosen_tests,
    interrupted,
    recorded_spec,
    redriving_options,
    rows_option,
    say_where,
    shown_driving,
)

if TYPE_CHECKING:
    from frenetic.redrive.conditions import Variation
    from frenetic.redrive.drives import RedriveProgress
    from frenetic.redrive.robustness import Rerun
    from frenetic.simulators import Simulator

VARY: Final = "--vary"
# `frenetic.simulators.worlds.QUANTITIES`, whose import is too slow for help.
QUANTITIES: Final = (
    *("friction", "speed", "noise", "delay", "start", "heading"),
    *("scene", "wear", "fog", "rain", "blur", "light", "grain"),
)


def variation(asked: AskedRange, simulator: Simulator) -> Variation:
    """The range of a quantity for the simulator; its usual one if none was given."""
    from frenetic.redrive.conditions import Variation

    if asked.limits is None:
        return Variation.usual(asked.name, simulator)
    return Variation(asked.name, *asked.limits)


class VaryingCommand(GroupedCommand):
    """A command whose --vary takes all ranges that follow it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Gives each range its own --vary."""
        spread: list[str] = []
        is_range = False
        for arg in args:
            name, equals, _ = arg.partition("=")
            is_range = is_range and (name in QUANTITIES or bool(equals)) and arg[:1] != "-"
            if is_range and spread[-1] != VARY:
                spread.append(VARY)
            spread.append(arg)
            is_range = is_range or arg == VARY
        return super().parse_args(ctx, spread)


@click.command(cls=VaryingCommand)
@click.argument("campaign", type=CampaignFolder())
@click.argument("test_ids", type=int, nargs=-1, metavar="[ID]...")
@count_option("--times", "Drives of each test.", default=20)
@click.option(
    VARY,
    "asked",
    type=Range("friction=0.8:1.0"),
    multiple=True,
    help="What differs between the drives: friction, speed (km/h), noise (m), delay (s), start (m),"
    " heading (rad), as in --vary friction=0.8:1.0 noise=0.2 speed; for a driver with a camera also"
    " scene, wear, fog (m), rain (mm/h), blur (s), light and grain; a name alone means its usual"
    " range. [default: nothing]",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@count_option("--top", "Only the N most telling failures. [default: all failures]")
@rows_option
@redriving_options
def robustness(
    campaign: Path,
    test_ids: tuple[int, ...],
    times: int,
    asked: tuple[AskedRange, ...],
    seed: int,
    top: int | None,
    with_rows: bool,
    workers: int,
    drive_limit: float | None,
    out: Path | None,
    as_json: bool,
    **given: Any,
) -> None:
    """Drive failing roads of a CAMPAIGN again and say how often they fail.

    Without --vary each drive is the same, so a failure repeats every time unless the driver or the
    simulator is not repeatable. With it, each drive is in its own world, drawn from the ranges: the
    command prints how many drives fail and which of the ranges matter, and with --rows for each
    failure its share and the 95 % interval. A failure is fragile if it surely repeats in less than
    half of the worlds, robust if in half or more. The same command goes on with an interrupted one,
    and shows a complete one.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.redrive.robustness import rerun as rerun_campaign

    with CampaignStore.open(campaign) as store:
        chosen = chosen_tests(store, test_ids, top)
        spec = recorded_spec(store, given)
    driver, simulator = spec.make_parts(isolate=workers == 1, drive_limit=drive_limit)
    variations = [variation(one, simulator) for one in asked]
    log = Log()
    left: int | None = None
    interrupts = 0

    def stopping() -> None:
        nonlocal interrupts
        interrupts += 1
        log.stopping()

    with shown_driving(log, "Driving again") as hooks:

        def progress(now: RedriveProgress) -> None:
            nonlocal left
            left = now.total - now.drives
            hooks["on_progress"](now.drives, now.total)

        reruns = rerun_campaign(
            campaign,
            simulator,
            driver,
            test_ids=chosen,
            times=times,
            variations=variations,
            seed=seed,
            workers=workers,
            drive_limit=drive_limit,
            out=out,
            **{**hooks, "on_progress": progress, "on_interrupt": stopping},
        )
    is_judged = any(one.judged for one in reruns)
    is_cut = bool(interrupts) and left != 0
    if as_json:
        from frenetic.redrive.robustness import rerun_document

        click.echo(json.dumps([rerun_document(one) for one in reruns]))
    elif reruns:
        most = f"{'up to ' if is_cut else ''}{counted(times, 'drive')} of each"
        _print(reruns, most, variations, with_rows)
        if is_judged:
            say_where(campaign, reruns[0].folder, out)
    elif not interrupts:
        click.echo(f"{campaign} holds no failure")
    if is_cut:
        what = "no drive was finished" if left is None else f"{counted(left, 'drive')} to go"
        raise interrupted(log, f"{what}; the same command goes on")
    if reruns and not is_judged:
        raise click.exceptions.Exit(1)


def _print(
    reruns: Sequence[Rerun], most: str, variations: Sequence[Variation], with_rows: bool
) -> None:
    from frenetic.redrive.record import matches_text
    from frenetic.redrive.robustness import Stability

    how = ", ".join(str(one) for one in variations) or "the same each time"
    click.echo(f"{counted(len(reruns), 'test')}, {most}, {how}")
    counts = [(kind, sum(one.stability is kind for one in reruns)) for kind in Stability]
    if any(number for _, number in counts):
        click.echo(", ".join(f"{number} {kind}" for kind, number in counts if number))
    failed, judged = (sum(getattr(one, name) for one in reruns) for name in ("failed", "judged"))
    drives = [drive for one in reruns for drive in one.drives]
    told = matches_text(drives)
    click.echo(f"{failed} of {judged} drives fail{': ' if told else ''}{told}")
    influences = [one for rerun in reruns for one in rerun.influences if one.matters]
    for name, number in Counter(one.quantity for one in influences).items():
        click.echo(f"{name} matters in {number} of {len(reruns)}")
    if fine := [str(one.test_id) for one in reruns if one.stability is None]:
        click.echo(f"No failure in the campaign, so neither robust nor fragile: {', '.join(fine)}")
    troubles = [drive.trouble for drive in drives if drive.trouble]
    if troubles:
        click.echo(
            f"{counted(len(troubles), 'drive')} could not be judged, the first one: {troubles[0]}"
        )
    if with_rows:
        _print_rows(reruns)
    else:
        click.echo("Test by test: --rows")


def _print_rows(reruns: Sequence[Rerun]) -> None:
    rows = []
    for one in reruns:
        low, high = one.interval
        matters = [str(influence) for influence in one.influences if influence.matters]
        rows.append(
            (
                one.test_id,
                two_digits(one.recorded.moobd),
                f"{one.failed} of {one.judged}",
                f"{one.alike} of {one.failed}",
                None if one.share is None else f"{100.0 * one.share:.0f} %",
                f"{100.0 * low:.0f} to {100.0 * high:.0f} %",
                one.stability,
                ", ".join(matters) or None,
            )
        )
    numbers = (">test", ">MOOBD (m)", ">fails", ">same failure", ">share", ">95 % interval")
    print_table((*numbers, "it is", "what matters"), rows)
