"""Road tests, and counts of their outcomes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from frenetic.bench.hosting.validity import validity

GROUND: Final = -28.0
"""Height of the flat map, in m."""
WIDTH: Final = 8.0
"""Width of the road, in m."""


class RoadTest:
    """A road test.

    Args:
        road_points: x, y in m; copied.
        number: of the test, from 1.

    """

    # Only an executed test has these.
    execution_data: list[Any]
    test_outcome: str
    """PASS, FAIL or ERROR."""
    description: str

    def __init__(self, road_points: Any, number: int) -> None:
        self.id = number
        self.road_points = list(road_points) if isinstance(road_points, Iterable) else road_points
        self.is_valid: bool | None = None
        """Validity, None until it is checked."""
        self.validation_message: str | None = None

    @cached_property
    def interpolated_points(self) -> list[tuple[float, float, float, float]]:
        """The road every metre or so: x, y, height, width in m.

        Raises:
            RoadError: No line passes through the road points.

        """
        points = validity().interpolate(self.road_points)
        return [(x, y, GROUND, WIDTH) for x, y in points.tolist()]

    def get_road_length(self, interpolate_road_points: bool = False) -> float:
        """Return m along the interpolated points.

        Args:
            interpolate_road_points: whether they are interpolated once more.

        Raises:
            RoadError: No line passes through the road points.

        """
        points = np.array(self.interpolated_points)[:, :2]
        if interpolate_road_points:
            points = validity().interpolate(points)
        steps = np.diff(points, axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def set_validity(self, is_valid: bool, validation_message: str) -> None:
        """Note whether the test is valid, and if not, why."""
        self.is_valid = is_valid
        self.validation_message = validation_message

    def to_json(self) -> str:
        """Return the test as a JSON object, with its result if it was executed."""
        return json.dumps(vars(self), default=str)


_Test = RoadTest  # which is another name in the next class


class RoadTestFactory:
    """Makes road tests, numbered from 1."""

    RoadTest = RoadTest
    _numbers: ClassVar[Iterator[int]] = itertools.count(1)

    @staticmethod
    def create_road_test(road_points: Iterable[Sequence[float]]) -> _Test:
        """Return the next road test; road points are x, y in m."""
        return RoadTest(road_points, next(RoadTestFactory._numbers))


@dataclass
class TestGenerationStatistic:
    """Counts of the tests' outcomes, and their times; a generator may change them."""

    __test__: ClassVar[bool] = False  # no test class of pytest's

    test_generated: int = 0
    """All submitted tests."""
    test_valid: int = 0
    test_invalid: int = 0
    test_passed: int = 0
    test_failed: int = 0
    test_in_error: int = 0
    obes: int = 0
    """Tests in which the car left its lane."""
    test_generation_real_times: list[float] = field(default_factory=list)
    """Generator's time for each submitted test, in s."""
    test_execution_real_times: list[float] = field(default_factory=list)
    """Virtual time of the bench that each executed test cost, in s."""
    test_execution_simulation_times: list[float] = field(default_factory=list)
    """Simulated time of each driven test, in s."""
