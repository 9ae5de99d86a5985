"""A cache folder for compiled kernels where numba has none, as in a read-only container."""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Callable, MutableMapping
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"
"""Environment variable with the folder in which numba keeps compiled kernels."""


def ensure_kernel_cache(
    environment: MutableMapping[str, str] = os.environ,
    is_writable: Callable[[Path], bool] = lambda folder: os.access(folder, os.W_OK),
) -> None:
    """Set `VARIABLE` to a temporary folder if numba could keep kernels nowhere else.

    Numba keeps kernels beside the sources, or else in the user's cache folder, and refuses to
    compile where it can write to neither. The temporary folder lasts as long as the process, so
    every process compiles its kernels again; a user who sets the variable keeps them.

    Args:
        environment: environment variables, which are changed.
        is_writable: says whether a folder can be written.
    """
    if environment.get(VARIABLE) or is_writable(Path(__file__).parent):
        return
    cache = environment.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    folder = Path(cache) if cache else Path("~").expanduser() / ".cache"
    # Numba makes the folder, so the first folder above it that exists has to be writable.
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if is_writable(folder):
        return
    import shutil  # rarely needed; both import slowly
    import tempfile

    temporary = tempfile.mkdtemp(prefix="frenetic-kernels-")
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    environment[VARIABLE] = temporary
