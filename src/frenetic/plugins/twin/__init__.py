"""Twins: a driver in a fast simulator that stands in for a slow one.

The names are imported on use, so that the help of its commands comes at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.plugins.twin.foresight import foresight
    from frenetic.plugins.twin.profile import TwinProfile

__getattr__ = lazy_names(__name__)

__all__ = ["TwinProfile", "foresight"]
