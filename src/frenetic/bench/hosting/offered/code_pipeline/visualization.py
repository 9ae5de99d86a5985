"""Pictures of tests, which are not drawn: the bench has its own report."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any


class RoadTestVisualizer:
    """Draws nothing.

    Args:
        map_size: m, side of the square map.

    """

    def __init__(self, map_size: float) -> None:
        self.map_size = map_size

    def visualize_road_test(self, the_test: Any) -> None:
        """Do nothing."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        if name.startswith("_"):
            raise AttributeError(name)
        return self._draw_nothing

    def _draw_nothing(self, *_: Any, **__: Any) -> None:
        pass
