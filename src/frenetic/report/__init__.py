"""Reports that people like to look at: pictures of roads and drives.

Names are loaded when they are first used, since Matplotlib takes a moment to import.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from frenetic.report.picture import draw_drive, draw_gallery, draw_road

__all__ = ["draw_drive", "draw_gallery", "draw_road"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("frenetic.report.picture"), name)
