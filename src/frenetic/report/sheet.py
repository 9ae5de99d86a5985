"""Contact sheets: many roads and drives from above, each at its own scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from matplotlib.figure import Figure

from frenetic._support.words import oob_words
from frenetic.campaign.record import Test
from frenetic.oracle.drive import Drive
from frenetic.report.judged_drive import focus_of, judge_drive
from frenetic.report.orientation import turn_of
from frenetic.report.scene import box_of, draw_colour_bar, draw_scene
from frenetic.report.style import INNER_WIDTH, MARGIN, QUIET, WIDTH, Paper, one_line
from frenetic.report.view import View
from frenetic.road import Road

SheetItem: TypeAlias = tuple[str, Road, Drive | Test | None]
"""Caption, road, and its drive; None or a test that was not driven for the road alone."""

# Sizes, our choice.
_GAP: Final = 0.2  # [in] between two pictures
_CAPTION_HEIGHT: Final = 0.52  # [in] under a picture
_LETTER_WIDTH: Final = 0.088  # [in] of a caption
_ASPECT: Final = 1.5  # width of a picture over its height; roads lie flat


def sheet_figure(items: Sequence[SheetItem], title: str | None) -> Figure:
    """Return a contact sheet as a figure; ``title`` is its headline."""
    columns = int(np.clip(math.ceil(math.sqrt(1.2 * len(items))), 1, 8))
    columns = max(columns, min(len(items), 3))
    top = 1.1 if title else 0.65
    rows = math.ceil(len(items) / columns)
    page = Paper.new(WIDTH, top + rows * sheet_row(INNER_WIDTH, columns) + 0.25)
    if title:
        page.text(MARGIN, 0.68, one_line(title, 60), size=19, weight="bold")
    draw_colour_bar(page, WIDTH - MARGIN, top - 0.45, 0.5 * items[0][1].lane_width)
    draw_sheet(page, items, columns, left=MARGIN, top=top, width=INNER_WIDTH)
    return page.figure


def sheet_row(width: float, columns: int) -> float:
    """Return the height of a row of ``columns`` pictures with captions, in inches.

    Args:
        width: width of the row, in inches.
        columns: number of pictures in the row.
    """
    return _picture_width(width, columns) / _ASPECT + _CAPTION_HEIGHT


def _picture_width(width: float, columns: int) -> float:
    """Return the width of each picture in a row of a width, in inches."""
    return (width - _GAP * (columns - 1)) / columns


def draw_sheet(
    page: Paper,
    items: Sequence[SheetItem],
    columns: int,
    *,
    left: float,
    top: float,
    width: float,
) -> None:
    """Draw roads and drives from above, row by row.

    Args:
        page: page to draw on.
        items: the pictures in reading order.
        columns: number of pictures in a row.
        left: left edge of the sheet, in inches from the page's left edge.
        top: upper edge of the sheet, in inches down the page.
        width: width of the sheet, in inches.
    """
    picture_width = _picture_width(width, columns)
    height = picture_width / _ASPECT
    most_letters = int(picture_width / _LETTER_WIDTH)
    for number, (caption, road, drive) in enumerate(items):
        row, column = divmod(number, columns)
        x = left + column * (picture_width + _GAP)
        y = top + row * sheet_row(width, columns)
        is_driven = drive is not None and (isinstance(drive, Drive) or drive.drive is not None)
        judged = judge_drive(road, drive) if drive is not None and is_driven else None
        turn = turn_of(road)
        view = View.showing(
            page.axes(x, y, picture_width, height), box_of(road, judged, turn), turn
        )
        focus = None if judged is None else focus_of(judged)
        draw_scene(view, road, judged, focus, labelled=False)
        page.text(x, y + height + 0.17, one_line(caption, most_letters), size=9, weight="bold")
        text = f"{road.length:.0f} m"
        if judged is not None and judged.result.moobd is None:
            text = f"{judged.result.outcome}, {text}"
        elif judged is not None:
            text += f", MOOBD {oob_words(judged.result.moobd, road.lane_width)}"
        page.text(x, y + height + 0.33, text, size=8, color=QUIET)
