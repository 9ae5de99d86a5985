"""Whether a road test is valid."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, Final

from frenetic.competition.hosting.offered.code_pipeline.tests_generation import RoadTest
from frenetic.errors import RoadError
from frenetic.road import check_validity, validity

WRONG_TYPE: Final = "Wrong type"
"""What is said of what is no road test."""
FEET_PER_METRE: Final = 3.280839895


class TestValidator:
    """Tells whether a test is valid, by the rules by which the bench decides it.

    Args:
        map_size: m, side of the square map.

    """

    __test__: ClassVar[bool] = False  # not a test class, whatever a test runner may think

    def __init__(self, map_size: float) -> None:
        self.map_size = map_size

    def validate_test(self, the_test: Any) -> tuple[bool, str]:
        """Return whether a test is valid, and the first rule that it breaks."""
        if not isinstance(the_test, RoadTest):
            return False, WRONG_TYPE
        try:
            points = [tuple(point) for point in the_test.road_points]
            verdict = check_validity(points, self.map_size)
        except (RoadError, TypeError) as error:
            return False, str(error)
        return verdict.valid, verdict.message


def min_radius(points: Iterable[Sequence[float]]) -> float:
    """Return the radius at the sharpest place of a road in feet, infinity if it is straight.

    Args:
        points: the interpolated points of a test; of each the first two values count, x and y in m.

    """
    return validity.min_radius([(point[0], point[1]) for point in points]) * FEET_PER_METRE
