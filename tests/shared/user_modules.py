"""Users' own modules, loaded anew as by another process."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from frenetic.parts.user_modules import USER_MODULE, is_local


@contextmanager
def own_modules() -> Iterator[None]:
    """Forgets, in the end, the modules of users' own that were loaded meanwhile.

    So one process can load two versions of a module, and of its neighbours, one after the other.
    """
    path, known = list(sys.path), set(sys.modules)
    try:
        yield
    finally:
        new = sys.modules.keys() - known
        # All are looked at first: a package without its parent cannot say where it lies.
        for name in [name for name in new if name.startswith(USER_MODULE) or _is_own(name)]:
            del sys.modules[name]
        sys.path[:] = path
        importlib.invalidate_caches()


def _is_own(name: str) -> bool:
    """Whether a loaded module is local, and not ours."""
    module = sys.modules[name]
    file = getattr(module, "__file__", None)
    # A folder without __init__.py is a package, too.
    places = [Path(place) for place in ([file] if file else getattr(module, "__path__", ()))]
    if name.partition(".")[0] == "frenetic" or not places:
        return False
    return all(map(is_local, places))
