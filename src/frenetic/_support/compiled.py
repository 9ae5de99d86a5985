"""The decorator of all kernels, which numba compiles.

The kernels of `frenetic.road` also run without numba, which the official competition pipeline with
its old Python and pinned packages lacks. There a road takes about a tenth of a second instead of a
millisecond; the budget gives it half a minute. Everything that drives a car needs numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, TypeVar, cast

try:
    import numba
except ImportError:
    IS_COMPILED = False
else:
    IS_COMPILED = True
    """Whether the kernels are compiled."""

_Kernel = TypeVar("_Kernel", bound=Callable[..., Any])


def njit(*, error_model: Literal["python", "numpy"] = "python") -> Callable[[_Kernel], _Kernel]:
    """Numba's decorator of the same name, with a cache on disk that processes may share.

    Without numba it leaves the function as it is.
    """
    if not IS_COMPILED:
        return lambda kernel: kernel
    from frenetic._support.shared_kernels import SharedCache

    def compile_lazily(kernel: _Kernel) -> _Kernel:
        dispatcher: Any = numba.njit(error_model=error_model)(kernel)
        dispatcher._cache = SharedCache(kernel)  # as its enable_caching() does with numba's own
        return cast("_Kernel", dispatcher)

    return compile_lazily
