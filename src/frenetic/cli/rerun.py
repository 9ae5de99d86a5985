"""The command that drives a campaign's roads again: rerun."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted
from frenetic.cli.again import (
    chosen_tests,
    interrupted,
    recorded_spec,
    shown_driving,
)
from frenetic.cli.console import Log, print_table, shell, two_digits
from frenetic.cli.options import (
    AskedRange,
    NewFile,
    Range,
    campaign_argument,
    count_option,
    file_option,
    json_option,
    workers_option,
)
from frenetic.cli.parts import given_options, given_quantities, part_options
from frenetic.cli.search import fail_on_failure_option
from frenetic.quantities import in_words

if TYPE_CHECKING:
    from frenetic.again.conditions import Variation
    from frenetic.again.rerun import Rerun
    from frenetic.again.verdicts import Repeats
    from frenetic.campaign import CampaignStore
    from frenetic.simulators import Simulator

VARY: Final = "--vary"
VARIED_TIMES: Final = 20
"""Default number of drives of each test if something is varied."""


def variation(asked: AskedRange, simulator: Simulator, layers: Mapping[str, float]) -> Variation:
    """The range of a quantity; its usual one for simulator and driver's layers if none is given."""
    from frenetic.again.conditions import Variation

    if asked.limits is None:
        return Variation.usual(asked.name, simulator, layers.get(asked.name))
    return Variation(asked.name, *asked.limits)


@click.command()
@campaign_argument
@click.argument("test_ids", type=int, nargs=-1, metavar="[ID]...")
@count_option("--top", "Only the N most telling failures. [default: all failures]")
@click.option(
    "--all", "everything", is_flag=True, help="All roads that were driven, not only the failures."
)
@count_option("--times", f"Drives of each road. [default: 1, with {VARY} {VARIED_TIMES}]")
@click.option(
    VARY,
    "asked",
    type=Range("friction=0.8:1.0"),
    multiple=True,
    help="What differs between the drives, as in --vary friction=0.8:1.0; a name alone means"
    " its usual range ('frenetic list quantities'), around a test's own amount. May be repeated.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the draws.")
@part_options
@workers_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Campaign that drives them. [default: a folder in again/ of the CAMPAIGN]",
)
@file_option("--junit", "Write the results as JUnit XML, one test case per road.", type=NewFile())
@fail_on_failure_option
@json_option
@click.pass_context
def rerun(
    context: click.Context,
    /,
    campaign: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    everything: bool,
    times: int | None,
    asked: tuple[AskedRange, ...],
    seed: int,
    workers: int,
    out: Path | None,
    junit: Path | None,
    fail_on_failure: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Drive failing roads of a CAMPAIGN again and say which fail again, and how.

    Each road is driven where it lay on the map, in its conditions, as the campaign drove it unless
    options change that: without any, the command says whether failures repeat. With --vary each
    drive is in its own conditions, drawn from the ranges: a failure is fragile if it is surely
    there in less than half of them, robust if in half or more. Amounts that --vary, --with or
    --simulator give win over a test's own. Another --driver shows what is fixed, another
    --simulator what says something of the driver. A failure is the same if it is on the same side
    within 30 m along the road, and road, offsets and speeds before it differ by at most 2 m, as
    within one distinct failure. The same command goes on with an interrupted one, and shows a
    complete one.
    """
    from frenetic.again.junit import write_junit
    from frenetic.again.rerun import elsewhere
    from frenetic.again.rerun import rerun as rerun_campaign
    from frenetic.campaign import CampaignStore
    from frenetic.simulators.capabilities import check_pair

    if everything and (test_ids or top is not None):
        raise click.UsageError("--all excludes --top and the ID of a test")
    given = given_options(context)
    times = times or (VARIED_TIMES if asked else 1)
    with CampaignStore.open(campaign) as store:
        chosen = _driven_tests(store) if everything else chosen_tests(store, test_ids, top)
        spec = recorded_spec(store, given)
    driver, simulator = spec.make_parts(isolate=workers == 1)
    check_pair(simulator, driver)  # which may bring its car
    variations = [variation(one, simulator, spec.layers) for one in asked]
    log = Log()
    with shown_driving(log, "Driving again") as on_event:
        found = rerun_campaign(
            campaign,
            simulator,
            driver,
            tests=chosen,
            times=times,
            vary=variations,
            seed=seed,
            instead=given_quantities(spec, given),
            workers=workers,
            out=out,
            on_event=on_event,
        )
    if junit is not None and not found.missing:
        write_junit(found, junit)
    with CampaignStore.open(campaign) as store:
        is_elsewhere = bool(elsewhere([found], store.config))
    if as_json:
        click.echo(json.dumps(found.as_json()))
    elif not found.planned:
        click.echo(f"{campaign} holds no {'driven road' if everything else 'failure'}")
    else:
        is_as_before = not asked and not given
        _print(found, times, is_as_before, is_elsewhere, with_rows=bool(test_ids))
        what = "both paths" if is_elsewhere else "it"
        see = f"to see {what}: frenetic report {shell(campaign)}"
        click.echo(f"Kept in {found.folder}; {see if out is None else 'the same command shows it'}")
    if found.missing:
        left = counted(found.missing, "drive")
        raise interrupted(log, f"{left} to go; the same command goes on")
    is_judged = any(test.judged for test in found.tests)
    if found.tests and (not is_judged or (fail_on_failure and not found.passed)):
        raise click.exceptions.Exit(1)


def _varied(found: Rerun) -> Iterator[str]:
    """What varied in all tests, for people."""
    for i, one in enumerate(found.variations):
        ranges = {test.variations[i] for test in found.tests}
        yield str(one) if ranges <= {one} else f"{one.quantity} around each test's own"


def _driven_tests(store: CampaignStore) -> list[int]:
    return [test.id for test in store.tests() if test.outcome.is_driven]


def _print(
    found: Rerun, times: int, is_as_before: bool, is_elsewhere: bool, *, with_rows: bool
) -> None:
    from frenetic.again.verdicts import Stability, matches_text
    from frenetic.analysis.failures import LISTED

    tests, drives = found.tests, found.drives
    up_to = "up to " if found.missing else ""
    what = ", ".join(_varied(found)) or ("in the same conditions" if times > 1 else "")
    failed, judged = (sum(getattr(test, n) for test in tests) for n in ("failed", "judged"))
    matches = matches_text(drives)
    shares = f"{failed} of {judged} drives fail{f' ({matches})' if matches else ''}"
    click.echo(
        f"{counted(len(tests), 'test')}, {up_to}{counted(times, 'drive')} of each"
        f"{', ' if what else ''}{what}: {shares if times > 1 else found or 'none was finished'}"
    )
    counts = [(kind, sum(test.stability is kind for test in tests)) for kind in Stability]
    if any(number for _, number in counts):
        click.echo(", ".join(f"{number} {kind}" for kind, number in counts if number))
    influences = [one for test in tests for one in test.influences if one.matters]
    for name, number in Counter(one.quantity for one in influences).most_common():
        click.echo(f"{name} matters in {number} of {len(tests)}")
    if is_as_before:
        click.echo(f"{found.same} of {counted(len(drives), 'drive')} ended exactly as before")
    if is_elsewhere and (correlation := found.correlation) is None:
        click.echo("rank correlation of MOOBD with the campaign's: too few roads to say")
    elif is_elsewhere and correlation is not None:
        click.echo(
            f"rank correlation of MOOBD with the campaign's: {correlation.spearman:.2f} (Spearman,"
            f" p = {correlation.p:.2g}, {correlation.pairs} drives)"
        )
    troubles = [drive.reason for drive in drives if not drive.outcome.is_driven]
    if troubles:
        click.echo(
            f"{counted(len(troubles), 'drive')} could not be judged, the first one: {troubles[0]}"
        )
    if not with_rows and len(tests) > LISTED:
        click.echo(f"Test by test: name the IDs, or --top {LISTED}")
    elif times > 1:
        _print_shares(tests)
    else:
        _print_changes(tests)


def _print_changes(tests: Sequence[Repeats]) -> None:
    rows = []
    for test in tests:
        (now,) = test.drives
        rows.append(
            (
                test.id,
                two_digits(test.recorded.moobd),
                two_digits(now.moobd),
                test.change,
                now.match,
                now.reason,
            )
        )
    columns = (">test", ">MOOBD (m)", ">now (m)", "it", "how", "what happened now")
    _print_rows(columns, tests, rows)


def _print_shares(tests: Sequence[Repeats]) -> None:
    rows = []
    for test in tests:
        low, high = test.interval
        matters = [str(influence) for influence in test.influences if influence.matters]
        rows.append(
            (
                test.id,
                two_digits(test.recorded.moobd),
                f"{test.failed} of {test.judged}",
                f"{test.alike} of {test.judged}",
                None if test.share is None else f"{100.0 * test.share:.0f} %",
                f"{100.0 * low:.0f} to {100.0 * high:.0f} %",
                test.stability or test.change,
                ", ".join(matters) or None,
            )
        )
    numbers = (">test", ">MOOBD (m)", ">fails", ">same failure", ">share", ">95 % interval")
    _print_rows((*numbers, "it is", "what matters"), tests, rows)


def _print_rows(
    columns: Sequence[str], tests: Sequence[Repeats], rows: Sequence[Sequence[object]]
) -> None:
    """Prints a row for each test, with its conditions where one has any."""
    told = [in_words(test.conditions) or None for test in tests]
    if any(told):
        columns = (*columns, "conditions")
        rows = [(*row, text) for row, text in zip(rows, told, strict=True)]
    print_table(columns, rows)
