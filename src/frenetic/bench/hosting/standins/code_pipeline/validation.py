"""Whether a road test is valid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Final

from frenetic.bench.hosting.validity import pairs_of, validity

from .tests_generation import RoadTest

WRONG_TYPE: Final = "Wrong type"
"""Message for an object that is no road test, or whose points are no pairs of finite numbers."""
FEET_PER_METRE: Final = 3.280839895


class TestValidator:
    """Validates tests by the bench's rules.

    Args:
        map_size: m, side of the square map.

    """

    __test__: ClassVar[bool] = False  # no test class of pytest's

    def __init__(self, map_size: float) -> None:
        self.map_size = map_size

    def validate_test(self, the_test: Any) -> tuple[bool, str]:
        """Return whether a test is valid, and the first rule that it breaks."""
        points = pairs_of(the_test.road_points) if isinstance(the_test, RoadTest) else None
        if points is None:
            return False, WRONG_TYPE
        verdict = validity().check_validity(points, self.map_size)
        return verdict.valid, verdict.message


def min_radius(points: Iterable[Sequence[float]]) -> float:
    """Return the radius at the sharpest place of a road in feet, infinity if it is straight.

    Args:
        points: the interpolated points of a test; of each the first two values count, x and y in m.

    """
    radius: float = validity().min_radius([(point[0], point[1]) for point in points])
    return radius * FEET_PER_METRE
