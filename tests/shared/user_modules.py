"""Modules of users, which one process can load in two versions."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from frenetic.parts.user_modules import USER_MODULE, is_local


@contextmanager
def own_modules() -> Iterator[None]:
    """Unload, at the end, the modules of users that were loaded inside `with`.

    So one process can load two versions of a module, and of its neighbours, one after the other.
    """
    path, known = list(sys.path), set(sys.modules)
    try:
        yield
    finally:
        new = sys.modules.keys() - known
        # The list is complete before anything is unloaded: a package needs its parent to be found.
        for name in [name for name in new if name.startswith(USER_MODULE) or _is_own(name)]:
            del sys.modules[name]
        sys.path[:] = path
        importlib.invalidate_caches()


def _is_own(name: str) -> bool:
    """Return whether a loaded module is local and not part of Frenetic."""
    module = sys.modules[name]
    file = getattr(module, "__file__", None)
    # A folder without __init__.py is a package, too.
    places = [Path(place) for place in ([file] if file else getattr(module, "__path__", ()))]
    if name.partition(".")[0] == "frenetic" or not places:
        return False
    return all(map(is_local, places))
