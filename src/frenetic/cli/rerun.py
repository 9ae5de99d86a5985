"""The command `rerun`, which drives a campaign's roads again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import click

from frenetic._support.words import counted, oob_unit
from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, print_table, two_digits
from frenetic.cli.entries import part_options, trust_option, was_given
from frenetic.cli.option_types import NamedRange, NewFile, range_type
from frenetic.cli.options import (
    campaign_argument,
    count_option,
    file_option,
    json_option,
    workers_option,
)
from frenetic.cli.rerun_options import (
    campaign_spec,
    chosen_tests,
    interrupted,
    kept_text,
    shown_driving,
)
from frenetic.cli.search import fail_on_failure_option
from frenetic.conditions.condition import as_text

if TYPE_CHECKING:
    from frenetic.campaign import CampaignStore, RoadTester
    from frenetic.rerun.campaigns import ReplayOptions
    from frenetic.rerun.reruns import Rerun
    from frenetic.rerun.stability import Repeats
    from frenetic.rerun.variations import Variation
    from frenetic.spec import Spec

VARIED_TIMES: Final = 20
"""Drives of each road with --vary, unless --times is given (our choice)."""

_OTHER_STUDIES: Final = ("everything", "times", "varied_conditions", "junit", "fail_on_failure")
"""Parameters that exclude ``--stability`` and ``--trials``."""


def _variation(condition: NamedRange, tester: RoadTester) -> Variation:
    """Return a condition with the range of ``--vary``, or with its usual range for a tester."""
    from frenetic.rerun.variations import Variation

    if condition.limits is None:
        amount = tester.terms.conditions.get(condition.name)
        return Variation.usual(condition.name, tester.simulator, amount)
    return Variation(condition.name, *condition.limits)


@click.command()
@campaign_argument
@click.argument("test_ids", type=int, nargs=-1, metavar="[ID]...")
@count_option("--top", "Only the N most telling failures. [default: all failures]")
@click.option(
    "--all", "everything", is_flag=True, help="All roads that were driven, not only the failures."
)
@count_option("--times", f"Drives of each road. [default: 1, with --vary {VARIED_TIMES}]")
@click.option(
    "--vary",
    "varied_conditions",
    type=range_type("friction=0.8:1.0"),
    multiple=True,
    help="A condition that differs between the drives, as in --vary friction=0.8:1.0; a name"
    " alone means the usual range ('frenetic list conditions') around a test's own amount. May be"
    " repeated.",
)
@click.option(
    "--stability",
    "is_study",
    is_flag=True,
    help="Drive failures again, also with 2 % less and more grip: how many fail, and how many keep"
    " their cause.",
)
@click.option(
    "--trials",
    "are_trials",
    is_flag=True,
    help="Drive a failure of each cause, or each ID, with one thing changed at a time: how sure"
    " is its cause?",
)
@part_options
@trust_option
@workers_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Folder for the drives. [default: a folder in rerun/ of the CAMPAIGN]",
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
    varied_conditions: tuple[NamedRange, ...],
    is_study: bool,
    are_trials: bool,
    workers: int,
    out: Path | None,
    junit: Path | None,
    fail_on_failure: bool,
    as_json: bool,
    **_: Any,
) -> None:
    """Drive failing roads of a CAMPAIGN again and say which fail again, and how.

    Each road is driven where it lay on the map, in its conditions, as the campaign drove it unless
    options change that: without options, the command says whether failures repeat. With --vary each
    drive has its own conditions, drawn from the ranges: a failure is fragile if it surely occurs in
    less than half of the drives, robust if in half or more. Amounts of --vary, --with or
    --simulator win over a test's own. Another --driver shows what is fixed, another --simulator
    which failures are the driver's. A failure is the same if it is on the same side within 30 m
    along the road, and if road, offsets and speeds before it differ by at most 2 m, as within one
    distinct failure. The same command continues after Ctrl-C, and shows a complete rerun.
    """
    from frenetic.rerun.junit import write_junit
    from frenetic.rerun.rerun import rerun_with

    _require_fitting_options(context)
    options = CommandOptions.of(context)
    times = times or (VARIED_TIMES if varied_conditions else 1)
    chosen, spec, tester = _of_campaign(options, campaign, test_ids, top, everything=everything)
    driving: ReplayOptions = {
        "tests": chosen,
        "instead": options.overridden_conditions(spec),
        "workers": workers,
        "isolate": True,
        "out": out,
    }
    if is_study or are_trials:
        _study(campaign, tester, driving, are_trials=are_trials, as_json=as_json)
        return
    variations = [_variation(condition, tester) for condition in varied_conditions]
    log = Log()
    with shown_driving(log, "Driving again") as on_event:
        driving["on_event"] = on_event
        result = rerun_with(campaign, tester, times=times, vary=variations, **driving)
    if junit is not None and not result.missing:
        write_junit(result, junit)
    if as_json:
        echo(json.dumps(result.as_json()))
    elif not result.planned:
        echo(f"{campaign} holds no {'driven road' if everything else 'failure'}")
    else:
        is_as_before, has_ids = not varied_conditions and not options, bool(test_ids)
        _print(result, times, is_as_before=is_as_before, has_named_tests=has_ids)
        # The report shows only reruns in the campaign's own folder.
        echo(kept_text(result.folder, campaign, is_reported=out is None))
    _exit_if_not_good(result, log, fail_on_failure=fail_on_failure)


def _study(
    campaign: Path, tester: RoadTester, driving: ReplayOptions, *, are_trials: bool, as_json: bool
) -> None:
    """Try causes, or study the stability of failures; see `rerun` for the arguments."""
    from frenetic.cli.rerun_stability import study_failures
    from frenetic.cli.rerun_trials import try_causes

    study = try_causes if are_trials else study_failures
    study(campaign, tester, driving, as_json=as_json)


def _require_fitting_options(context: click.Context) -> None:
    """Check that no option excludes another.

    Raises:
        click.UsageError: ``--all`` stands beside tests, or a study of its own beside another one.
    """
    values = context.params
    if values["is_study"] and values["are_trials"]:
        raise click.UsageError("--stability and --trials are two studies: give one of them")
    if values["everything"] and (values["test_ids"] or values["top"] is not None):
        raise click.UsageError("--all excludes --top and the ID of a test")
    for parameter in context.command.params:
        name = parameter.name or ""
        for study, option in (("is_study", "--stability"), ("are_trials", "--trials")):
            if values[study] and name in _OTHER_STUDIES and was_given(context, name):
                raise click.UsageError(
                    f"{option} has its own drives and no verdict: leave out {parameter.opts[0]}"
                )


def _exit_if_not_good(result: Rerun, log: Log, *, fail_on_failure: bool) -> None:
    """End the command with another exit code than 0 where the result calls for it.

    Raises:
        click.exceptions.Exit: drives are left after Ctrl-C, no drive could be judged, or roads
            failed and `fail_on_failure` says that this counts.
    """
    if result.missing:
        raise interrupted(log, f"{counted(result.missing, 'drive')} to go")
    is_judged = any(test.judged for test in result.tests)
    if result.tests and (not is_judged or (fail_on_failure and not result.passed)):
        raise click.exceptions.Exit(1)


def _of_campaign(
    options: CommandOptions,
    folder: Path,
    test_ids: tuple[int, ...],
    top: int | None,
    *,
    everything: bool,
) -> tuple[Sequence[int] | None, Spec, RoadTester]:
    """Return the IDs of the tests to drive again, and the spec and the tester of their drives.

    The IDs are None for all failures.
    """
    from frenetic.campaign import CampaignStore
    from frenetic.rerun.rerun import campaign_tester

    with CampaignStore.open(folder) as store:
        chosen = _driven_tests(store) if everything else chosen_tests(store, test_ids, top)
        spec, code_folder = campaign_spec(store, options)
        with chdir(code_folder):
            return chosen, spec, campaign_tester(store, spec)


def _driven_tests(store: CampaignStore) -> list[int]:
    """Return the IDs of all driven tests of a campaign."""
    return [test.id for test in store.tests(with_repeats=False) if test.outcome.is_driven]


def _print(result: Rerun, times: int, *, is_as_before: bool, has_named_tests: bool) -> None:
    """Print how many drives failed, which conditions matter, and a row for each test.

    Args:
        result: the rerun.
        times: drives of each road.
        is_as_before: whether nothing differs from the campaign's drives.
        has_named_tests: whether the command line names the tests: then all rows are printed.
    """
    from frenetic.analysis.clusters import LISTED
    from frenetic.rerun.stability import Stability

    tests, drives = result.tests, result.drives
    echo(_headline(result, times))
    kinds = Counter(test.stability for test in tests)
    if any(kinds[kind] for kind in Stability):
        echo(", ".join(f"{kinds[kind]} {kind}" for kind in Stability if kinds[kind]))
    influential = [
        influence.condition for test in tests for influence in test.influences if influence.matters
    ]
    for name, number in Counter(influential).most_common():
        echo(f"{name} matters in {number} of {len(tests)}")
    if is_as_before:
        echo(f"{result.same} of {counted(len(drives), 'drive')} ended exactly as before")
    if reasons := [drive.reason for drive in drives if not drive.outcome.is_driven]:
        echo(f"{counted(len(reasons), 'drive')} could not be judged, the first one: {reasons[0]}")
    if not has_named_tests and len(tests) > LISTED:
        echo(f"Test by test: name the IDs, or --top {LISTED}")
        return
    _print_tests(tests, times)


def _headline(result: Rerun, times: int) -> str:
    """Return the number of tests, the drives of each and their conditions, and how many failed."""
    from frenetic.rerun.stability import matches_text

    tests, drives = result.tests, result.drives
    varied = [
        str(variation)
        if all(test.variations[i] == variation for test in tests)
        else f"{variation.condition} around each test's own"
        for i, variation in enumerate(result.variations)
    ]
    conditions_text = ", ".join(varied) or ("in the same conditions" if times > 1 else "")
    plan = f"{counted(times, 'drive')} of each{', ' if conditions_text else ''}{conditions_text}"
    if times > 1:
        failed, judged = sum(test.failed for test in tests), sum(test.judged for test in tests)
        matches = matches_text(drives)
        outcome = f"{failed} of {judged} drives fail{f' ({matches})' if matches else ''}"
    else:
        outcome = str(result) or "none was finished"
    limit = "up to " if result.missing else ""
    return f"{counted(len(tests), 'test')}, {limit}{plan}: {outcome}"


def _print_tests(tests: Sequence[Repeats], times: int) -> None:
    """Print a row for each test: one drive in words, or the shares of several drives."""
    headings = [">fails", ">same failure", ">95 % interval", "it is", "what matters"]
    if times == 1:
        headings = [">now (m)", "it", "how", "what happened now"]
    conditions = [as_text(test.conditions) or None for test in tests]
    has_conditions = any(conditions)
    rows = [
        (
            test.id,
            two_digits(test.recorded.moobd),
            *(_cells_of_one_drive(test) if times == 1 else _cells_of_drives(test)),
            *([text] if has_conditions else []),
        )
        for test, text in zip(tests, conditions, strict=True)
    ]
    if has_conditions:
        headings.append("conditions")
    moobd = f">MOOBD ({oob_unit(tests[0].recorded.road.lane_width)})" if tests else ">MOOBD (m)"
    print_table((">test", moobd, *headings), rows)


def _cells_of_one_drive(test: Repeats) -> tuple[object, ...]:
    """Return the MOOBD now, the change, how the failure matches the recorded one, the reason."""
    (drive,) = test.drives
    return two_digits(drive.moobd), test.change, drive.match, drive.reason


def _cells_of_drives(test: Repeats) -> tuple[object, ...]:
    """Return how many drives failed and how many alike, the interval, kind and influences."""
    low, high = test.interval
    influences = [str(influence) for influence in test.influences if influence.matters]
    return (
        f"{test.failed} of {test.judged}",
        f"{test.alike} of {test.judged}",
        f"{100.0 * low:.0f} to {100.0 * high:.0f} %",
        test.stability or test.change,
        ", ".join(influences) or None,
    )
