"""Imports of a Python source, read from its text: nothing is run."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path


def imported_names(text: str, package: str) -> Iterator[str]:
    """Yield the names of modules that a source may import, also inside functions.

    ``from a import b`` yields ``a.b``, since b may be a module. A source with an error in its
    syntax yields nothing.

    Args:
        text: the source.
        package: package that holds the source's module, to which relative imports refer.
    """
    try:
        nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            # One dot is the package itself, each further dot a package above it.
            above = package.split(".")[: package.count(".") + 2 - node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def files_of(name: str, folders: Iterable[Path]) -> Iterator[tuple[str, Path, Path]]:
    """Yield each file that importing a module loads: its packages' files, then its own.

    Args:
        name: name of the module, with dots; nothing is yielded for a module of Frenetic.
        folders: folders of the module path; the first that holds the top package is taken.

    Yields:
        Name of a module, its file, and the folder of its top package.
    """
    names = name.split(".")
    if names[0] in ("", "frenetic"):
        return
    for folder in folders:
        top = folder / names[0]
        if not (top.is_dir() or top.with_suffix(".py").is_file()):
            continue
        for depth in range(1, len(names) + 1):
            stem = folder.joinpath(*names[:depth])
            for file in (stem / "__init__.py", stem.with_suffix(".py")):
                if file.is_file():
                    yield ".".join(names[:depth]), file, folder
                    break
        return
