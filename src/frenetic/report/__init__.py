"""Reports: pictures of roads and drives, a campaign as an HTML page, a search in one call.

Names are imported on use, since Matplotlib imports slowly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.report.html import write_comparison_page, write_report
    from frenetic.report.html.replay import Replay, animate
    from frenetic.report.picture import draw_drive, draw_gallery, draw_road
    from frenetic.report.plots import plot, plot_progress
    from frenetic.report.results import Findings, Results, Step, resume, run

__getattr__ = lazy_names(__name__)

__all__ = [
    "Findings",
    "Replay",
    "Results",
    "Step",
    "animate",
    "draw_drive",
    "draw_gallery",
    "draw_road",
    "plot",
    "plot_progress",
    "resume",
    "run",
    "write_comparison_page",
    "write_report",
]
