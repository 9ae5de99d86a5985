"""Public names that a package imports when they are used, so that it is imported at once."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib import import_module
from typing import Any


def import_name(package: str, modules: Mapping[str, str], name: str) -> Any:
    """Import a public name of a package and return its value, for the package's ``__getattr__``.

    The package keeps the value, so ``__getattr__`` is called once for each name.

    Args:
        package: the package's ``__name__``.
        modules: public name -> module that defines it.
        name: the name to import.

    Raises:
        AttributeError: the package has no such public name.
    """
    if name not in modules:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    value = getattr(import_module(modules[name]), name)
    setattr(sys.modules[package], name, value)
    return value
