"""Twins: a driver in a fast simulator that stands in for a slow one.

Names are imported on use: the modules would slow down ``frenetic calibrate --help``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.plugins.twin.foresight import foresight
    from frenetic.plugins.twin.profile import TwinProfile

__all__ = ["TwinProfile", "foresight"]

_MODULES = {
    "TwinProfile": "frenetic.plugins.twin.profile",
    "foresight": "frenetic.plugins.twin.foresight",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
