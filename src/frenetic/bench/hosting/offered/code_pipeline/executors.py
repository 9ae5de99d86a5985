"""Executors of tests."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from frenetic.bench.hosting.offered.placeholder import Placeholder


class AbstractTestExecutor(ABC):
    """Base class of a generator's executor."""

    @abstractmethod
    def execute_test(self, the_test: Any) -> tuple[str, str, Any]:
        """Return outcome, description and records of a test."""

    @abstractmethod
    def validate_test(self, the_test: Any) -> tuple[bool, str]:
        """Return whether a test is valid, and if not, why."""

    @abstractmethod
    def is_over(self) -> bool:
        """Return whether the budget is spent."""

    @abstractmethod
    def get_remaining_time(self) -> Any:
        """Return what remains of the budget, in s."""

    @abstractmethod
    def get_stats(self) -> Any:
        """Return the counts so far."""

    @abstractmethod
    def close(self) -> None:
        """Release what the executor holds."""


class MockExecutor(Placeholder):
    """The pipeline's executor without a simulator."""
