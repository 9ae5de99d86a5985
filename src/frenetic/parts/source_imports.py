"""Imports of a Python source, read from its text: nothing is run."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path


def imported_names(text: str, package: str) -> Iterator[str]:
    """Yield names of modules that a source may import, also inside functions."""
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: package.count(".") + 2 - node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def files_of(name: str, places: Iterable[Path]) -> Iterator[tuple[str, Path, Path]]:
    """Yield name, file and folder of each file that importing a module loads, packages included."""
    parts = name.split(".")
    if parts[0] in ("", "frenetic"):
        return
    for place in places:
        top = place / parts[0]
        if not (top.is_dir() or top.with_suffix(".py").is_file()):
            continue
        for number in range(1, len(parts) + 1):
            at = place.joinpath(*parts[:number])
            for file in (at / "__init__.py", at.with_suffix(".py")):
                if file.is_file():
                    yield ".".join(parts[:number]), file, place
                    break
        return
