"""Standard manoeuvres for ``frenetic drive --manoeuvre``."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, chdir
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from frenetic._support.option_text import part_word, read_part
from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.console import Log, announced_compilation, print_facts, print_table
from frenetic.cli.drive_facts import facts_of_drive
from frenetic.cli.drive_trace import TraceFile
from frenetic.conditions.condition import as_text
from frenetic.spec import Spec
from frenetic.spec.part_text import part_text

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester
    from frenetic.manoeuvres import Manoeuvre, ManoeuvrePlan, ManoeuvreResult
    from frenetic.road import Road


def drive_manoeuvre(
    options: CommandOptions,
    word: str,
    plot: Path | None,
    trace: TraceFile | None,
    *,
    is_quiet: bool,
) -> dict[str, Any]:
    """Drive a manoeuvre; print what it measures, unless quiet, and return it for JSON.

    Args:
        options: options of the command line.
        word: name and options of the manoeuvre, such as ``step,radius=100``.
        plot: file for the picture; None for no picture.
        trace: file for the trace; None for no trace.
        is_quiet: whether nothing is printed.

    Raises:
        FreneticError: no manoeuvre has the name, an option is out of range, or no road may bend as
            the manoeuvre asks.
    """
    from frenetic.campaign import RoadTester
    from frenetic.campaign.workers import driving
    from frenetic.manoeuvres import ManoeuvrePlan

    manoeuvre = _manoeuvre_of(word)
    spec, code_folder = options.trusted(options.over(Spec(), roads_are_given=False))
    with chdir(code_folder):
        tester = replace(RoadTester.of(spec), keeps_notes=trace is not None)
    road_class = spec.road_class
    plan = ManoeuvrePlan.of(
        manoeuvre,
        tester.simulator,
        tester.simulator.rules,
        conditions=tester.terms.conditions,
        lane_width=tester.terms.lane_width,
        max_curvature=None if road_class is None else road_class.max_curvature,
    )
    with ExitStack() as entered:
        compiled = entered.enter_context(announced_compilation(Log()))
        drive_road = entered.enter_context(driving(tester, isolate=True))
        compiled()
        drive = drive_road(plan.road, plan.conditions)
    result = plan.result(drive)
    if plot is not None:
        from frenetic.report.manoeuvre_picture import draw_manoeuvre  # imports matplotlib

        driver = part_text(tester.described["driver"], word=spec.driver)
        title = f"{manoeuvre.name} at {3.6 * plan.speed:.4g} km/h, {driver}"
        draw_manoeuvre(result, plot, title=f"{title}: {result.result.outcome}")
    document = _document(plan, result, tester, plot)
    if trace is not None:
        document |= trace.write(plan.road, drive, result.result, plan.conditions)
    if not is_quiet:
        _print(spec, plan, result, document)
    return document


def _manoeuvre_of(word: str) -> Manoeuvre:
    """Return the manoeuvre that a text such as ``step,radius=100`` stands for.

    Raises:
        FreneticError: no manoeuvre has the name, or an option is out of range.
        ValueError: an option has no value.
    """
    from frenetic.parts.registry import MANOEUVRES

    name, manoeuvre_options = read_part(word)
    if name is None:
        raise ValueError(f"{word!r} has no name, as in step,radius=100")
    manoeuvre: Manoeuvre = MANOEUVRES.make(name, **manoeuvre_options)
    return manoeuvre


def _manoeuvre_text(plan: ManoeuvrePlan) -> str:
    """Return name and options of a manoeuvre, as the command line writes them."""
    options = {name: value for name, value in vars(plan.manoeuvre).items() if value is not None}
    return part_word(plan.manoeuvre.name, options)


def _road_text(road: Road) -> str:
    """Return length and least radius of a road."""
    sharpest = float(abs(road.curvatures).max())
    return f"{road.length:.0f} m, " + (
        f"least radius {1.0 / sharpest:.3g} m" if sharpest > 0.0 else "straight"
    )


def _document(
    plan: ManoeuvrePlan, result: ManoeuvreResult, tester: RoadTester, plot: Path | None
) -> dict[str, Any]:
    """Return what happened in a manoeuvre, for JSON."""
    return {
        **result.as_json(),
        "speed_limit": 3.6 * plan.speed,
        "length": result.road.length,
        **result.result.as_json(),
        **tester.described,
        "conditions": dict(plan.conditions),
        **({} if plot is None else {"plot": str(plot)}),
    }


def _print(
    spec: Spec, plan: ManoeuvrePlan, result: ManoeuvreResult, document: Mapping[str, Any]
) -> None:
    """Print what happened in a manoeuvre, and what was measured."""
    verdict = result.result
    duration = verdict.duration if verdict.outcome.is_driven else None
    echo(f"{verdict.outcome}  {verdict.reason}")
    driver = part_text(document["driver"], word=spec.driver)
    simulator = part_text(document["simulator"], word=spec.simulator)
    print_facts(
        [
            ("manoeuvre", _manoeuvre_text(plan)),
            ("road", _road_text(result.road)),
            ("driver", f"{driver} in {simulator}"),
            ("limit", f"{3.6 * plan.speed:.4g} km/h"),
            ("conditions", as_text(plan.conditions)),
            *facts_of_drive(verdict, duration, result.road.lane_width),
            ("picture", document.get("plot", "")),
            ("trace", document.get("trace", "")),
        ]
    )
    print_table(
        ("quantity", "of", ">value", ""),
        [
            (
                quantity.name.replace("_", " "),
                quantity.of,
                quantity.text if quantity.value is not None else "",
                quantity.unit if quantity.value is not None else quantity.reason,
            )
            for quantity in result.measures.quantities
        ],
    )
    for rows in result.measures.tables.values():
        columns = list(rows[0])
        print_table(
            tuple(f">{_TITLES.get(column, column)}" for column in columns),
            [tuple(f"{round(row[column], 3) + 0.0:.3g}" for column in columns) for row in rows],
        )


_TITLES = {"frequency": "frequency (Hz)", "lag": "lag (°)", "delay": "delay (s)"}
"""Column of a table -> title with the unit."""
