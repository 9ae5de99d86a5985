"""Stand-in for the pipeline's road tests."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, ClassVar


class RoadTest:
    """A road test; an executed one has ``execution_data``, ``test_outcome`` and ``description``.

    Args:
        road_points: x and y of each road point, in m; the list is copied.
        number: number of the test, from 1.

    """

    def __init__(self, road_points: Iterable[Sequence[float]], number: int) -> None:
        self.id = number
        self.road_points = list(road_points)
        self.is_valid: bool | None = None
        """Validity, None until it is checked."""
        self.validation_message: str | None = None

    def set_validity(self, is_valid: bool, validation_message: str) -> None:
        """Note whether the test is valid, and if not, why."""
        self.is_valid = is_valid
        self.validation_message = validation_message


class RoadTestFactory:
    """A factory of road tests, numbered from 1."""

    _numbers: ClassVar[Iterator[int]] = itertools.count(1)

    @staticmethod
    def create_road_test(road_points: Iterable[Sequence[float]]) -> Any:
        """Return the next road test, with x and y of each road point in m."""
        return RoadTest(road_points, next(RoadTestFactory._numbers))
