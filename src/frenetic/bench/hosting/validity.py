"""The rules of road tests, imported when a generator first needs them."""

from __future__ import annotations

from functools import cache
from types import ModuleType


@cache
def validity() -> ModuleType:
    """Return the module `frenetic.road.validity`.

    Numba, which it imports, takes longer than all the rest of the process's start. A generator that
    brings a package called `frenetic` has it imported before its own.
    """
    from frenetic.road import validity  # numba takes its time

    return validity
