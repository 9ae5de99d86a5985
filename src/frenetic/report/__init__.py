"""Reports: pictures of roads and drives, a campaign as an HTML page.

Names are imported on use, since Matplotlib imports slowly.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from frenetic.report.html import write_comparison_page, write_report
    from frenetic.report.picture import draw_drive, draw_gallery, draw_road

_HOME = {
    "draw_drive": "frenetic.report.picture",
    "draw_gallery": "frenetic.report.picture",
    "draw_road": "frenetic.report.picture",
    "write_comparison_page": "frenetic.report.html",
    "write_report": "frenetic.report.html",
}

__all__ = ["draw_drive", "draw_gallery", "draw_road", "write_comparison_page", "write_report"]


def __getattr__(name: str) -> object:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)
