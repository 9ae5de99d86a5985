"""The decorator of the kernels that run without numba, too.

The kernels of `frenetic.road` are plain Python that numba compiles. They are needed where numba is
not: in the official competition pipeline, whose Python is old and whose packages are pinned. There
a road takes about a tenth of a second instead of a millisecond, of a budget that gives it half a
minute. Everything that drives a car needs numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

try:
    from numba import njit as _njit
except ImportError:
    IS_COMPILED = False
else:
    IS_COMPILED = True
    """Whether the kernels are compiled."""

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def njit(*, cache: bool) -> Callable[[_Kernel], _Kernel]:
    """Numba's decorator of the same name; without numba, one that changes nothing."""
    if not IS_COMPILED:
        return lambda kernel: kernel
    return cast("Callable[[_Kernel], _Kernel]", _njit(cache=cache))
