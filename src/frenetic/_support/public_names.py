"""Public names that a package imports on use."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any


@cache
def lazy_names(package: str) -> Callable[[str], Any]:
    """The ``__getattr__`` of a package whose import imports nothing else.

    What it imports for type checkers, below ``if TYPE_CHECKING``, it has when it is asked for.

    Args:
        package: its ``__name__``.
    """

    @cache
    def homes() -> dict[str, str]:
        import ast  # not for those who want nothing else
        import inspect

        tree = ast.parse(inspect.getsource(sys.modules[package]))
        blocks = [one.body for one in tree.body if isinstance(one, ast.If)]
        imports = [one for block in blocks for one in block if isinstance(one, ast.ImportFrom)]
        return {name.name: one.module or "" for one in imports for name in one.names}

    def get(name: str) -> Any:
        if name.startswith("__") or name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes()[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return get
