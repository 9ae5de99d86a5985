"""Reports: pictures of roads and drives, HTML pages of campaigns, and a search in one call.

Names are imported on use, since Matplotlib imports slowly.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.report.html import write_comparison_page, write_report
    from frenetic.report.html.replay import Replay, animate
    from frenetic.report.manoeuvre_picture import draw_manoeuvre
    from frenetic.report.picture import draw_drive, draw_gallery, draw_road
    from frenetic.report.plots import plot, plot_progress
    from frenetic.report.results import Findings, Results, Step, resume, run

__all__ = [
    "Findings",
    "Replay",
    "Results",
    "Step",
    "animate",
    "draw_drive",
    "draw_gallery",
    "draw_manoeuvre",
    "draw_road",
    "plot",
    "plot_progress",
    "resume",
    "run",
    "write_comparison_page",
    "write_report",
]

_MODULES = {
    "Findings": "frenetic.report.results",
    "Replay": "frenetic.report.html.replay",
    "Results": "frenetic.report.results",
    "Step": "frenetic.report.results",
    "animate": "frenetic.report.html.replay",
    "draw_drive": "frenetic.report.picture",
    "draw_gallery": "frenetic.report.picture",
    "draw_manoeuvre": "frenetic.report.manoeuvre_picture",
    "draw_road": "frenetic.report.picture",
    "plot": "frenetic.report.plots",
    "plot_progress": "frenetic.report.plots",
    "resume": "frenetic.report.results",
    "run": "frenetic.report.results",
    "write_comparison_page": "frenetic.report.html",
    "write_report": "frenetic.report.html",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
