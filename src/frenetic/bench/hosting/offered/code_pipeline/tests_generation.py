"""Road tests, and counts of their results."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Final

import numpy as np

from frenetic.bench.hosting.offered.code_pipeline.test_analysis import compute_all_features
from frenetic.bench.hosting.offered.given_points import (
    number_pairs,
    plain_points,
    snapshot,
)
from frenetic.bench.hosting.offered.self_driving.road_polygon import RoadPolygon
from frenetic.bench.hosting.offered.self_driving.simulation_data import SimulationDataRecord
from frenetic.bench.hosting.validity import validity
from frenetic.errors import RoadError

GROUND: Final = -28.0
"""Height of the flat map, in m."""
WIDTH: Final = 8.0
"""Width of the road, in m."""

Point = Sequence[float]
Node = tuple[float, float, float, float]


class RoadTest:
    """A road test.

    Args:
        road_points: x, y in m; copied.
        number: of the test, from 1.

    """

    # Only an executed test has these.
    execution_data: list[SimulationDataRecord]
    test_outcome: str
    """PASS, FAIL or ERROR."""
    description: str

    def __init__(self, road_points: Iterable[Point], number: int) -> None:
        self.id = number
        self.road_points = snapshot(road_points)
        self.is_valid: bool | None = None
        """Validity, None until it is checked."""
        self.validation_message: str | None = None

    @cached_property
    def interpolated_points(self) -> list[Node]:
        """The road every metre or so: x, y, height, width in m.

        Raises:
            RoadError: No line passes through the road points.

        """
        points = number_pairs(self.road_points)
        if points is None:
            raise RoadError("road points must be a list of pairs x, y of finite numbers")
        return [(x, y, GROUND, WIDTH) for x, y in validity().interpolate(points).tolist()]

    @cached_property
    def road_polygon(self) -> RoadPolygon:
        """The road's area.

        Raises:
            RoadError: No line passes through the road points.

        """
        return RoadPolygon.from_nodes(self.interpolated_points)

    @cached_property
    def features(self) -> dict[str, float]:
        """Features of an executed test, see `compute_all_features`.

        Raises:
            AttributeError: The test was not executed.

        """
        if not hasattr(self, "execution_data"):
            raise AttributeError("a test that was not executed has no features")
        return compute_all_features(self, self.execution_data)

    def get_road_polygon(self) -> RoadPolygon:
        """Return the road's area."""
        return self.road_polygon

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
        """Return the test as a JSON object, with its result if it was executed.

        Road points that are no numbers are null; without a line through them, there are no
        interpolated points.
        """
        try:
            interpolated = self.interpolated_points
        except RoadError:
            interpolated = []
        document: dict[str, Any] = {
            "id": self.id,
            "is_valid": self.is_valid,
            "validation_message": self.validation_message,
            "road_points": plain_points(self.road_points),
            "interpolated_points": interpolated,
        }
        for name in ("test_outcome", "description", "execution_data", "features"):
            with suppress(AttributeError, RoadError):
                document[name] = getattr(self, name)
        return json.dumps(document, default=str)


_Test = RoadTest  # which is another name in the next class


class RoadTestFactory:
    """Makes road tests, numbered from 1."""

    RoadTest = RoadTest
    _numbers: ClassVar[Iterator[int]] = itertools.count(1)

    @staticmethod
    def create_road_test(road_points: Iterable[Point]) -> _Test:
        """Return the next road test; road points are x, y in m."""
        return RoadTest(road_points, next(RoadTestFactory._numbers))


@dataclass
class TestGenerationStatistic:
    """Counts of the tests' results, and their times; a generator may change them."""

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
    """Simulated time of each executed test, in s."""

    def __str__(self) -> str:
        lines = [f"{name.replace('_', ' ', 1)}: {getattr(self, name)}" for name in _COUNTS]
        lines += [
            f"seconds of generating: {sum(self.test_generation_real_times)}",
            f"seconds of executing: {sum(self.test_execution_real_times)}",
            f"seconds of simulated time: {sum(self.test_execution_simulation_times)}",
        ]
        return "".join(f"{line}\n" for line in lines)

    def as_csv(self) -> str:
        """Return a line of names and a line of values; times are sums in s."""
        row = {name: getattr(self, name) for name in _COUNTS}
        row["real_time_generation"] = sum(self.test_generation_real_times)
        row["real_time_execution"] = sum(self.test_execution_real_times)
        row["simulated_time_execution"] = sum(self.test_execution_simulation_times)
        return "\n".join([",".join(row), ",".join(map(str, row.values()))])


_COUNTS: Final = (
    "test_generated",
    "test_valid",
    "test_invalid",
    "test_passed",
    "test_failed",
    "test_in_error",
)
