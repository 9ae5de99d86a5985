"""A road as three lines of points: its middle and its edges."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError

Place = tuple[float, float]
Node = Sequence[float]
# Names for annotations, which generators import.
List4DTuple = list[tuple[float, float, float, float]]
List2DTuple = list[tuple[float, float]]


class RoadPoints:
    """The middle of a road and its edges, all of equally many points x, y in m.

    An edge lies half the road's width beside the middle, at right angles to the step to the next
    node, at the last node to the step before.

    Args:
        nodes: x, y, height and width of the road in m, two or more.

    Raises:
        RoadError: There are too few nodes, or they are no such numbers.

    """

    def __init__(self, nodes: Iterable[Node]) -> None:
        self.nodes = [tuple(node) for node in nodes]
        table = _table(self.nodes)
        middle = table[:, :2]
        steps = np.diff(middle, axis=0)
        steps = np.vstack([steps, steps[-1:]])
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        self.moves = bool((lengths > 0.0).all())
        """Whether no two consecutive nodes are the same."""
        # Where a step has no length, the edges are at the node itself.
        half = 0.5 * table[:, 3] / np.where(lengths > 0.0, lengths, 1.0)
        sideways = np.column_stack([-steps[:, 1] * half, steps[:, 0] * half])
        self.middle = _places(middle)
        self.left = _places(middle + sideways)
        self.right = _places(middle - sideways)

    @classmethod
    def from_nodes(cls, nodes: Iterable[Node]) -> RoadPoints:
        """Return the lines of a road whose nodes are x, y, height and width in m."""
        return cls(nodes)

    def plot_on_ax(self, ax: Any) -> None:
        """Draw the three lines on Matplotlib's axes, with equal scales."""
        for line, colour in ((self.middle, "gold"), (self.left, "white"), (self.right, "white")):
            ax.plot(*np.transpose(line), color=colour)
        ax.set_facecolor("darkseagreen")
        ax.set_aspect("equal", adjustable="datalim")


def _table(nodes: list[tuple[float, ...]]) -> FloatArray:
    """(N, 4) m."""
    if len(nodes) < 2:
        raise RoadError(f"a road needs at least 2 nodes, but there are {len(nodes)}")
    try:
        table = np.array(nodes, dtype=np.float64)
    except (TypeError, ValueError):
        table = np.empty(0)
    if table.ndim != 2 or table.shape[1] != 4 or not np.isfinite(table).all():
        raise RoadError("a road's nodes must be x, y, height and width, all finite numbers of m")
    return table


def _places(points: FloatArray) -> list[Place]:
    return [(x, y) for x, y in points.tolist()]
