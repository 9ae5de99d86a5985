"""Executors of tests."""

from __future__ import annotations

import itertools
import os
from abc import ABC, abstractmethod
from typing import Any, Final
from weakref import WeakValueDictionary

from frenetic.bench.hosting.offered.placeholder import Placeholder

_Key = tuple[int, int]


class Shared:
    """An object that this process has once: its copies are itself, also out of a pickle.

    An optimiser may deep-copy all that it is given, but there is one bench and one budget.
    """

    _key: _Key

    def __new__(cls, *_: Any, **__: Any) -> Any:
        """Return a new object, registered under a key."""
        self = super().__new__(cls)
        self._key = (os.getpid(), next(_numbers))
        _shared[self._key] = self
        return self

    def __copy__(self) -> Any:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        return self

    def __reduce__(self) -> Any:
        return SharedReference, self._key


class SharedReference:
    """What a pickled `Shared` object is in another process, where it cannot be used."""

    def __new__(cls, process: int, number: int) -> Any:
        """Return the object of a key, or else a reference."""
        found = _shared.get((process, number))
        return super().__new__(cls) if found is None else found

    def __init__(self, *key: int) -> None:
        self._key = key

    def __reduce__(self) -> Any:
        return SharedReference, self._key

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # what copying and pickling ask for
            raise AttributeError(name)
        raise RuntimeError(ELSEWHERE)


ELSEWHERE: Final = "the executor only works in the process that the bench has started"

_numbers: Final = itertools.count()
_shared: Final[WeakValueDictionary[_Key, Shared]] = WeakValueDictionary()


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
