"""Profiles: values along a road and its drive, as curves one below the other."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from frenetic._support.words import oob_words, signed
from frenetic.criteria.criterion import DRIVER, LANE
from frenetic.report.judged_drive import JudgedDrive
from frenetic.report.scene import EGO_LANE, draw_coloured
from frenetic.report.style import ALARM, FAINT, INK, INNER_WIDTH, MARGIN, QUIET, Paper
from frenetic.report.view import size_of
from frenetic.road import Road
from frenetic.road.profile import value_at

_TITLE_HEIGHT: Final = 0.3  # [in] above a profile; our choice
_AXIS_HEIGHT: Final = 0.55  # [in] below the last profile; our choice
_MOST_ASKED: Final = np.radians(90.0)  # [rad] drawn of the steering that is asked for; our choice
_LINE_COLOUR: Final = "#48678a"


class Profile(NamedTuple):
    """A value along the road, with the function that draws it."""

    name: str
    title: str
    height: float
    """Height, in inches; our choice."""
    draw: Callable[[Axes, Road, JudgedDrive | None], None]


def profiles_of(road: Road, judged: JudgedDrive | None) -> list[Profile]:
    """Return the profiles to draw for a road and its drive, from top to bottom."""
    names = {"curvature"} if judged is None or not len(judged) else {"oob", "curvature", "speed"}
    if judged is not None and judged.mistake is not None:
        names |= {"steering", "pedals"}
    names |= {name for name in ("grade", "superelevation") if len(getattr(road, name))}
    return [profile for profile in _PROFILES if profile.name in names]


def height_of(profiles: Sequence[Profile]) -> float:
    """Return the height of profiles with their axis, in inches."""
    return sum(profile.height + _TITLE_HEIGHT for profile in profiles) + _AXIS_HEIGHT


def draw_profiles(
    page: Paper, road: Road, judged: JudgedDrive | None, profiles: Sequence[Profile], y: float
) -> None:
    """Draw profiles one below the other.

    Args:
        page: page to draw on.
        road: the road.
        judged: the drive; None for the road alone.
        profiles: the profiles, from `profiles_of`.
        y: upper edge of the first profile, in inches down the page.
    """
    left, width = MARGIN + 0.45, INNER_WIDTH - 0.45
    for profile in profiles:
        page.text(MARGIN, y + _TITLE_HEIGHT - 0.08, profile.title, size=8.5, color=QUIET)
        y += _TITLE_HEIGHT
        axes = page.axes(left, y, width, profile.height, bare=False, label=profile.name)
        profile.draw(axes, road, judged)
        axes.set_xlim(0.0, road.length)
        axes.xaxis.set_major_locator(MaxNLocator(10, steps=[1, 2, 2.5, 5, 10]))
        axes.grid(visible=True)
        axes.spines["left"].set_visible(False)
        axes.tick_params(labelbottom=profile is profiles[-1])
        for finding in () if judged is None else judged.result.findings:
            if finding.criterion not in (LANE, DRIVER):
                axes.axvline(finding.distance, color=ALARM, lw=1.0, ls=":", zorder=2)
        if judged is not None and judged.mistake is not None:
            axes.axvline(judged.mistake.place, color=INK, lw=1.0, ls="--", zorder=2)
            if profile.name == "steering":
                _label_line(axes, judged.mistake.place / road.length, "first mistake", INK)
        if judged is not None and judged.result.departure is not None:
            departure = judged.result.departure.distance
            axes.axvline(departure, color=ALARM, lw=1.0, zorder=2)
            if profile is profiles[0]:
                _label_line(axes, departure / road.length, "departure", ALARM)
        y += profile.height
    middle = left + 0.5 * width
    page.text(middle, y + 0.335, "distance along the road (m)", size=8.5, color=QUIET, ha="center")


def _draw_oob_distance(axes: Axes, road: Road, judged: JudgedDrive | None) -> None:
    """Draw the oob distance, and mark the MOOBD."""
    assert judged is not None
    half = 0.5 * road.lane_width
    # A car far outside its lane is drawn at one and a half lanes from the edge.
    lowest = max(float(judged.oob_distance.min()), -3.0 * half)
    # On top there is room for the departure's label.
    low, high = min(-0.6 * half, lowest - 0.65 * half), 1.55 * half
    axes.set_ylim(low, high)
    axes.set_xlim(0.0, road.length)
    axes.set_yticks([tick for tick in (-half, 0.0, half) if tick > low])
    axes.axhspan(low, 0.0, color="#fbeeee", zorder=0.2, lw=0.0)
    axes.axhline(0.0, color=ALARM, lw=0.8, alpha=0.6, zorder=1.5)
    scale = size_of(axes) / (road.length, high - low)
    points = np.column_stack([judged.distance, judged.oob_distance])
    draw_coloured(axes, points, scale, judged.oob_distance, half, 2.2)
    if judged.result.moobd is None:
        return
    worst = int(np.argmin(judged.oob_distance))
    distance, moobd = float(judged.distance[worst]), float(judged.oob_distance[worst])
    style: Any = {"ms": 6.0, "mfc": "white", "mec": INK, "mew": 1.4, "zorder": 6, "clip_on": False}
    axes.plot(distance, lowest, "o", **style)
    share = distance / road.length
    if judged.result.departure is not None:  # beside the departure's line
        alignment, dx, dy = ("left", 8.0, -8.0) if share < 0.2 else ("right", -8.0, -8.0)
    else:
        alignment, dx, dy = "center", 0.0, -13.0
        alignment = "left" if share < 0.06 else "right" if share > 0.94 else alignment
    axes.annotate(
        f"MOOBD {oob_words(moobd, road.lane_width)}", (distance, lowest), (dx, dy),
        textcoords="offset points", ha=alignment, va="center", size=8.5, weight="bold", zorder=6,
        annotation_clip=False,
    )  # fmt: skip


def _label_line(axes: Axes, share: float, text: str, colour: str) -> None:
    """Write a text beside a line, which is at a share of the road's length."""
    is_left_of_line = share > 0.85
    axes.annotate(
        text, (share, 1.0), (-5.0 if is_left_of_line else 5.0, -3.0),
        xycoords="axes fraction", textcoords="offset points", va="top", size=8.5,
        ha="right" if is_left_of_line else "left", weight="bold", color=colour, zorder=6,
    )  # fmt: skip


def _draw_steering(axes: Axes, _: Road, judged: JudgedDrive | None) -> None:
    """Draw the angle of the front wheels, and as a dashed line the angle that was asked for."""
    assert judged is not None
    path, n = judged.drive.trajectory, len(judged)
    reached = np.degrees(path.steering[:n])
    asked = np.degrees(np.clip(path.steering_input[:n], -_MOST_ASKED, _MOST_ASKED))
    most = 1.35 * max(float(np.abs(reached).max()), float(np.abs(asked).max()), 1.0)
    axes.set_ylim(-most, most)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(judged.distance, asked, color=QUIET, lw=1.1, dashes=(3.0, 2.0), zorder=2.5)
    axes.plot(judged.distance, reached, color=_LINE_COLOUR, lw=1.4, zorder=3)


def _draw_pedals(axes: Axes, _: Road, judged: JudgedDrive | None) -> None:
    """Draw the throttle upwards and the brake downwards."""
    assert judged is not None
    path, n = judged.drive.trajectory, len(judged)
    axes.set_ylim(-1.1, 1.1)
    axes.set_yticks([-1.0, 0.0, 1.0], ["1", "0", "1"])
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.fill_between(judged.distance, path.throttle[:n], color=_LINE_COLOUR, lw=0.0, alpha=0.6)
    axes.fill_between(judged.distance, -path.brake[:n], color=ALARM, lw=0.0, alpha=0.6)
    for share, text, va in ((0.95, "throttle", "top"), (0.05, "brake", "bottom")):
        axes.text(1.004, share, text, size=7.5, color=QUIET, va=va, transform=axes.transAxes)


def _draw_curvature(axes: Axes, road: Road, _: JudgedDrive | None) -> None:
    """Draw the curvature, positive to the left."""
    reach = max(0.0125, 1.25 * float(np.abs(road.curvatures).max()))
    axes.set_ylim(-reach, reach)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    distances = road.stations
    axes.fill_between(distances, road.curvatures, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(distances, road.curvatures, color=_LINE_COLOUR, lw=1.4, zorder=3)
    for share, text, va in ((0.95, "left", "top"), (0.05, "right", "bottom")):
        axes.text(1.004, share, text, size=7.5, color=QUIET, va=va, transform=axes.transAxes)


def _draw_speed(axes: Axes, road: Road, judged: JudgedDrive | None) -> None:
    """Draw the speed, and the speed limits as a dashed line."""
    assert judged is not None
    limits = judged.drive.rules.speed_limits_on(road)
    edges = [*limits[:, 0], road.length]
    limit = float(limits[-1, 1])
    low, high = float(judged.speed.min()), float(judged.speed.max())
    axes.set_ylim(min(0.0, low), 1.15 * max(float(limits[:, 1].max()), high))
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    if len(limits) == 1:
        axes.axhline(limit, color=QUIET, lw=0.8, dashes=(4.0, 3.0), zorder=1.5)
    else:
        axes.stairs(limits[:, 1], edges, baseline=None, color=QUIET, lw=0.8, ls=(0, (4.0, 3.0)))
    axes.text(1.004 * road.length, limit, "limit", size=7.5, color=QUIET, va="center")
    axes.plot(judged.distance, judged.speed, color=_LINE_COLOUR, lw=1.4, zorder=3)


def _draw_height(axes: Axes, road: Road, _: JudgedDrive | None) -> None:
    """Draw the height, and write the grade in the middle of every eighth of the road."""
    distances = road.distances()
    heights = road.heights(distances)
    low, high = float(heights.min()), float(heights.max())
    span = max(high - low, 1.0)
    low -= 0.55 * span  # room for the grades
    axes.set_ylim(low, high + 0.15 * span)
    axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    axes.fill_between(distances, heights, low, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.plot(distances, heights, color=_LINE_COLOUR, lw=1.4, zorder=3)
    middles = road.length * (np.arange(8) + 0.5) / 8.0
    for middle, grade in zip(middles, value_at(road.grade, middles), strict=True):
        axes.text(
            middle, 0.08, f"{'+' if grade > 0.0 else ''}{signed(100.0 * grade, 1)} %", size=7.5,
            color=QUIET, ha="center", transform=axes.get_xaxis_transform(), zorder=5,
        )  # fmt: skip


def _draw_superelevation(axes: Axes, road: Road, _: JudgedDrive | None) -> None:
    """Draw the superelevation, positive where the road falls to the right."""
    distances = road.distances()
    slopes = 100.0 * value_at(road.superelevation, distances)
    most = max(0.1, round(float(np.abs(slopes).max()), 1))
    axes.set_ylim(-1.3 * most, 1.3 * most)
    axes.set_yticks([-most, 0.0, most])
    axes.fill_between(distances, slopes, color=EGO_LANE, lw=0.0, alpha=0.75, zorder=1.2)
    axes.axhline(0.0, color=FAINT, lw=0.8, zorder=1.3)
    axes.plot(distances, slopes, color=_LINE_COLOUR, lw=1.4, zorder=3)


_PROFILES: Final = (
    Profile("oob", "oob distance (m)", 1.35, _draw_oob_distance),
    Profile("curvature", "curvature (1/m)", 0.85, _draw_curvature),
    Profile(
        "superelevation", "superelevation (%), + falls to the right", 0.6, _draw_superelevation
    ),
    Profile("grade", "height (m), with the grade", 0.85, _draw_height),
    Profile("speed", "speed (km/h)", 0.85, _draw_speed),
    Profile("steering", "steering (°), dashed: asked for; + is left", 0.85, _draw_steering),
    Profile("pedals", "pedals", 0.6, _draw_pedals),
)
"""All profiles, from top to bottom."""
