"""What the embedded simulator looks at when it is asked whether it works."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from frenetic._support.kernel_cache import VARIABLE
from frenetic.doctor import Check, broken, drive_checks, time_of_drives
from frenetic.drivers import Planner
from frenetic.simulators.embedded import rollout as kernels

if TYPE_CHECKING:
    from frenetic.simulators.embedded.simulator import EmbeddedSimulator

SLOW: Final = 0.1
"""Wall time that no drive of a second needs where kernels are compiled, in s."""
_TIMES: Final = 20


def checks(simulator: EmbeddedSimulator) -> Iterator[Check]:
    """Compiled kernels, their cache, two drives, and how fast it is."""
    start = time.perf_counter()
    try:
        simulator.__enter__()
    except Exception as error:
        yield broken(
            "kernels", error, "reinstall numba; on a new Python it may have to be upgraded"
        )
        return
    yield Check("kernels", True, f"compiled, ready after {time.perf_counter() - start:.1f} s")
    yield _cache_check()
    yield from drive_checks(simulator)
    seconds = time_of_drives(simulator, Planner(), _TIMES)
    yield Check(
        "speed",
        seconds < SLOW,
        f"{1e3 * seconds:.2f} ms a drive",
        "" if seconds < SLOW else "unset NUMBA_DISABLE_JIT; is the machine busy?",
    )


def _cache_check() -> Check:
    """Whether compiled kernels can be kept."""
    compiled = kernels.rollout
    folder = Path(str(getattr(getattr(compiled, "stats", None), "cache_path", "") or ""))
    if not folder.is_dir():
        return Check("cache", False, "kernels are not cached", "unset NUMBA_DISABLE_JIT")
    if not os.access(folder, os.W_OK):
        return Check(
            "cache",
            False,
            f"{folder} cannot be written: kernels are compiled anew after every change",
            f"make it writable, or set {VARIABLE} to a folder that is",
        )
    return Check("cache", True, f"{folder} can be written")
