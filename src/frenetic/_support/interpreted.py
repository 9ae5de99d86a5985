"""Kernels as the Python in which they are written, for their first calls.

The first drive on a machine takes 0.1 s in Python, and compiling its kernels takes 10 s. So a
kernel whose calls are short is interpreted until its calls have taken as long as compiling takes:
whatever the number of calls, that is at most twice the time of the better way. A kernel that is on
disk is loaded instead. Both forms give the same results, bit for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, Final

import numpy as np
from numba.extending import is_jitted

_LOOK_INTERVAL: Final = 0.5
"""Time between two looks whether a kernel is on disk by now, in s (our choice)."""


class _Mode:
    """How this process treats kernels whose first calls may be interpreted."""

    def __init__(self) -> None:
        self.may_interpret = True
        self.may_compile = True


_MODE: Final = _Mode()


class _FirstCalls:
    """The first calls of a kernel.

    Args:
        kernel: numba's dispatcher.
        seconds: time that compiling takes, in s.
    """

    def __init__(self, kernel: Any, seconds: float) -> None:
        self._kernel = kernel
        self._seconds_left = seconds
        self._next_look = 0.0
        self._compiled_form: Callable[..., Any] = kernel._compile_for_args
        # Numba calls it where no compiled form fits the arguments, and calls what it returns.
        kernel._compile_for_args = self._form

    @property
    def are_interpreted(self) -> bool:
        """Whether the next call is interpreted."""
        if not (_MODE.may_interpret and _MODE.may_compile):
            return _MODE.may_interpret
        if self._seconds_left <= 0.0:
            return False
        now = time.monotonic()
        if now >= self._next_look:
            self._next_look = now + _LOOK_INTERVAL
            if _is_on_disk(self._kernel):
                self._next_look = self._seconds_left = 0.0
                return False
        return True

    def _form(self, *arguments: Any, **keywords: Any) -> Callable[..., Any]:
        """Return the function that is called with arguments, compiled or not."""
        if self.are_interpreted:
            return self._interpret
        form: Callable[..., Any] = self._compiled_form(*arguments, **keywords)
        return form

    def _interpret(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the kernel in Python; return the result as compiled code does.

        Where Python raises, for example at a division by 0, the compiled form is called instead.
        """
        before = _copy(arguments)
        start = time.thread_time()
        try:
            with np.errstate(all="ignore"):
                return _without_numpy_scalars(_interpreted(self._kernel)(*arguments, **keywords))
        except (ArithmeticError, ValueError, IndexError):
            _restore(arguments, before)
        finally:
            self._seconds_left -= time.thread_time() - start
        return self._compiled_form(*arguments, **keywords)(*arguments, **keywords)


_FIRST_CALLS: Final[dict[Any, _FirstCalls]] = {}


def interpret_first_calls(kernel: Any, seconds: float) -> None:
    """Let calls of a kernel from Python be interpreted until they have taken some seconds.

    Args:
        kernel: numba's dispatcher.
        seconds: time that compiling takes, in s.
    """
    _FIRST_CALLS[kernel] = _FirstCalls(kernel, seconds)


def is_interpreted(kernel: Any) -> bool:
    """Return whether the next call of a kernel from Python is interpreted."""
    return kernel in _FIRST_CALLS and _FIRST_CALLS[kernel].are_interpreted


def end_interpretation() -> None:
    """Let this process compile each kernel from now on when it is first called."""
    _MODE.may_interpret = False


@contextmanager
def without_compiling() -> Iterator[None]:
    """Interpret kernels that are not loaded, so that nothing compiles while a driver is timed."""
    _MODE.may_compile = False
    try:
        yield
    finally:
        _MODE.may_compile = True


def _is_on_disk(kernel: Any) -> bool:
    """Return whether the cache has a compiled form of a kernel."""
    function = kernel.py_func
    pattern = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}-*.nbi"
    return any(Path(kernel.stats.cache_path).glob(pattern))


@cache
def _interpreted(kernel: Any) -> FunctionType:
    """Return a kernel as a function of Python, which calls other kernels as such functions."""
    function = kernel.py_func
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        if is_jitted(names.get(name)):
            names[name] = _interpreted(names[name])
    return FunctionType(function.__code__, names, function.__name__, function.__defaults__)


def _copy(value: Any) -> Any:
    """Return a value with copies of its arrays."""
    if isinstance(value, tuple):
        return tuple(_copy(part) for part in value)
    return value.copy() if isinstance(value, np.ndarray) else value


def _restore(value: Any, before: Any) -> None:
    """Give the arrays of a value the content of their copies."""
    if isinstance(value, tuple):
        for part, part_before in zip(value, before, strict=True):
            _restore(part, part_before)
    elif isinstance(value, np.ndarray) and value.flags.writeable:
        value[...] = before


def _without_numpy_scalars(result: Any) -> Any:
    """Return a result with Python's numbers in place of numpy's scalars."""
    if isinstance(result, tuple):
        return tuple(_without_numpy_scalars(part) for part in result)
    return result.item() if isinstance(result, np.generic) else result
