"""Replays of drives within other pages, such as notebooks: `animate`."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.campaign.record import Test
from frenetic.oracle.drive import Drive
from frenetic.report.html.page import Report, render
from frenetic.report.html.tests import COLUMNS, drive_data
from frenetic.report.judged_drive import judge_drive, road_of
from frenetic.road import Road
from frenetic.segments.segment import segment_of

_HEIGHT: Final = 900  # [px] of a replay; our choice


@dataclass(frozen=True, repr=False)
class Replay:
    """A replay that a notebook shows; it is self-contained and loads nothing."""

    title: str
    page: str
    """The replay as an HTML page."""

    @property
    def html(self) -> str:
        """The replay as one HTML element, for pages of your own."""
        return (
            f'<iframe title="{html.escape(self.title)}" sandbox="allow-scripts"'
            f' style="width: 100%; height: {_HEIGHT}px; border: 0"'
            f' srcdoc="{html.escape(self.page)}"></iframe>'
        )

    def write(self, path: Path | str) -> Path:
        """Write the page completely or not at all.

        Raises:
            FreneticError: the file cannot be written.
        """
        path = Path(path)
        write_file(path, self.page, remedy="choose another place for the replay")
        return path

    def _repr_html_(self) -> str:
        """Return the replay as Jupyter shows it."""
        return self.html

    def __repr__(self) -> str:
        """Return a text that says how to see the replay."""
        return f"<Replay of {self.title}: a notebook shows it, write('replay.html') keeps it>"


def animate(thing: Drive | Test, *, road: Road | None = None) -> Replay:
    """Return the replay of a drive: from above, in a close-up, and in profiles along the road.

    Args:
        thing: the drive, or a test with its drive.
        road: the driven road, for a drive that does not know it.

    Raises:
        ValueError: the drive does not know its road or has no records, or the test has no drive.
        CampaignError: the test's campaign does not record the parts that drove it.
    """
    test = thing if isinstance(thing, Test) else None
    drive = thing.drive if isinstance(thing, Test) else thing
    if drive is None:
        raise ValueError(
            f"the drive of {thing!r} is missing: it was not driven, or was read without trajectory"
        )
    road = road_of(drive, road)
    judged = judge_drive(road, drive)
    result = judged.result if test is None else test.result
    segment = segment_of(road, judged.drive, result.finding)
    title = "Drive" if test is None else f"Test {test.id}"
    test_id = 0 if test is None else test.id
    data = {
        "replay": test_id,
        "lane_width": road.lane_width,
        "resolutions": COLUMNS,
        "drives": [drive_data(test_id, result, segment)],
    }
    return Replay(title, render(Report(title, sections=(), data=data)))
