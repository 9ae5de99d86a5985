"""Road tests, and the counts of what became of them."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from frenetic.competition.hosting.offered.self_driving.road_polygon import RoadPolygon
from frenetic.competition.hosting.offered.self_driving.simulation_data import SimulationDataRecord
from frenetic.road.validity import interpolate

GROUND: Final = -28.0
"""m, height of the flat map."""
WIDTH: Final = 8.0
"""m, of the road."""

Point = Sequence[float]
Node = tuple[float, float, float, float]


class RoadTest:
    """A road to be driven.

    Args:
        road_points: x, y in m.
        number: of the test, from 1.

    """

    # Only an executed test has these.
    execution_data: list[SimulationDataRecord]
    test_outcome: str
    """PASS, FAIL, ERROR or INVALID."""
    description: str
    features: dict[str, float] | None

    def __init__(self, road_points: Sequence[Point], number: int) -> None:
        self.id = number
        self.road_points = road_points
        self.is_valid: bool | None = None
        """None until somebody has looked."""
        self.validation_message: str | None = None

    @cached_property
    def interpolated_points(self) -> list[Node]:
        """The road every metre or so: x, y, height, width in m.

        Raises:
            RoadError: No line passes through the road points.

        """
        points = [(point[0], point[1]) for point in self.road_points]
        return [(x, y, GROUND, WIDTH) for x, y in interpolate(points).tolist()]

    @cached_property
    def road_polygon(self) -> RoadPolygon:
        """The road's area.

        Raises:
            RoadError: No line passes through the road points.

        """
        return RoadPolygon.from_nodes(self.interpolated_points)

    def get_road_polygon(self) -> RoadPolygon:
        """Return the road's area."""
        return self.road_polygon

    def get_road_length(self, interpolate_road_points: bool = False) -> float:
        """Return m from the first road point to the last, straight from each point to the next.

        Args:
            interpolate_road_points: whether to go along the interpolated points instead.

        """
        points: Sequence[Point] = self.road_points
        if interpolate_road_points:
            points = self.interpolated_points
        steps = np.diff([(point[0], point[1]) for point in points], axis=0).reshape(-1, 2)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def set_validity(self, is_valid: bool, validation_message: str) -> None:
        """Note whether the test is valid, and if not, why."""
        self.is_valid = is_valid
        self.validation_message = validation_message

    def to_json(self) -> str:
        """Return the test as a JSON object, with what became of it if it was executed.

        Raises:
            RoadError: No line passes through the road points.

        """
        document: dict[str, Any] = {
            "id": self.id,
            "is_valid": self.is_valid,
            "validation_message": self.validation_message,
            "road_points": [[float(value) for value in point] for point in self.road_points],
            "interpolated_points": self.interpolated_points,
        }
        for name in ("test_outcome", "description", "execution_data", "features"):
            if hasattr(self, name):
                document[name] = getattr(self, name)
        return json.dumps(document)


class RoadTestFactory:
    """Makes road tests, numbered from 1."""

    _numbers: ClassVar[Iterator[int]] = itertools.count(1)

    @staticmethod
    def create_road_test(road_points: Sequence[Point]) -> RoadTest:
        """Return the next road test; road points are x, y in m."""
        return RoadTest(road_points, next(RoadTestFactory._numbers))


@dataclass
class TestGenerationStatistic:
    """How many tests came to what, and how long they took; a generator may change them."""

    __test__: ClassVar[bool] = False  # not a test class, whatever a test runner may think

    test_generated: int = 0
    """All that were handed over."""
    test_valid: int = 0
    test_invalid: int = 0
    test_passed: int = 0
    test_failed: int = 0
    test_in_error: int = 0
    obes: int = 0
    """Tests in which the car left its lane."""
    test_generation_real_times: list[float] = field(default_factory=list)
    """s that the generator took for each test handed over."""
    test_execution_real_times: list[float] = field(default_factory=list)
    """s that each executed test cost, in the virtual time of the bench."""
    test_execution_simulation_times: list[float] = field(default_factory=list)
    """s of simulated time of each executed test."""
