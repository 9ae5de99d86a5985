"""Shared parts of several commands' options: types, decorators, checks."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import click

from frenetic._support.durations import parse_duration
from frenetic.cli.beamng import beamng_options, with_beamng

P = ParamSpec("P")
R = TypeVar("R")


class Duration(click.ParamType):  # type: ignore[type-arg]  # generic in click's newest only
    """A time such as 90, 90s, 10m or 1h30m."""

    name = "time"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Seconds."""
        try:
            return parse_duration(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Folder(click.ParamType):  # type: ignore[type-arg]
    """A folder, which need not exist."""

    name = "folder"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Its path."""
        if not str(value):
            self.fail("an empty name; write . for the current folder", param, ctx)
        return Path(value)


class Setting(click.ParamType):  # type: ignore[type-arg]
    """NAME=VALUE for an option of a part; the value is read as JSON if it is some."""

    name = "name=value"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, Any]:
        """(name, value)."""
        name, equals, text = str(value).partition("=")
        if not equals or not name.strip():
            self.fail(f"{value!r} is not NAME=VALUE", param, ctx)
        for read in (json.loads, float):
            try:
                return name.strip(), read(text)
            except ValueError:
                continue
        return name.strip(), text


def driver_options(command: Callable[P, R]) -> Callable[P, R]:
    """The options that choose a driver, a simulator and the rules."""
    options = [
        click.option(
            "--driver",
            default="planner",
            show_default=True,
            metavar="D",
            help="Who drives: a name ('frenetic drivers'), package.module:Class or file.py:Class.",
        ),
        click.option(
            "--driver-option",
            "driver_options",
            type=Setting(),
            multiple=True,
            help="An option of the driver, such as aggression=1.2; may be repeated.",
        ),
        click.option(
            "--noise",
            type=float,
            metavar="M",
            help="Let the driver err about its lateral place, by this standard deviation in m.",
        ),
        click.option(
            "--delay", type=float, metavar="S", help="Let the controls arrive this many s late."
        ),
        click.option(
            "--view", type=float, metavar="M", help="Let the driver see only this many m ahead."
        ),
        click.option(
            "--simulator",
            default="embedded",
            show_default=True,
            is_eager=True,
            metavar="S",
            help="What moves the car (see 'frenetic simulators').",
        ),
        click.option(
            "--simulator-option",
            "simulator_options",
            type=Setting(),
            multiple=True,
            callback=with_beamng,
            help="An option of the simulator, such as friction=0.7; may be repeated.",
        ),
        click.option("--speed-limit", type=float, default=70.0, show_default=True, help="km/h."),
        click.option(
            "--oob-tolerance",
            type=float,
            default=0.95,
            show_default=True,
            help="Share of the car that may be outside its lane, above 0 and up to 1.",
        ),
        click.option(
            "--map-size", type=float, default=200.0, show_default=True, help="m, side of the map."
        ),
        click.option(
            "--wall-limit",
            type=float,
            callback=_or_usual_limit,
            help="s of wall time that one drive may take. [default: 60, with beamng 600]",
        ),
    ]
    command = beamng_options(command)
    for option in reversed(options):
        command = option(command)
    return command


def _or_usual_limit(ctx: click.Context, _: click.Parameter, value: float | None) -> float:
    from frenetic.spec import usual_wall_limit

    return usual_wall_limit(ctx.params["simulator"]) if value is None else value


redriving_workers_option = click.option(
    "--workers",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    metavar="N",
    help="Drive on N roads at once, in processes of their own.",
)
drive_limit_option = click.option(
    "--drive-limit",
    type=Duration(),
    help="Replace a worker that tests one road for longer. [default: 1.5 times --wall-limit and"
    " 10 s]",
)
lane_option = click.option(
    "--lane",
    type=int,
    metavar="ID",
    help="OpenDRIVE: lane to drive on; one on the left (above 0) is driven against the road."
    " [default: -1]",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


@contextmanager
def as_usage_error() -> Iterator[None]:
    """Turns a `ValueError` of the library into a user's mistake."""
    try:
        yield
    except ValueError as error:
        raise click.UsageError(str(error)) from None


def check_map_size(map_size: float) -> None:
    """Refuses a map without room for a road."""
    from frenetic.road import MARGIN

    if not 2.0 * MARGIN < map_size < float("inf"):
        raise click.UsageError(
            f"--map-size is {map_size:g}: more than twice the margin of {MARGIN:g} m is needed"
        )
