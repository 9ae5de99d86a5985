"""Where modules are imported; what may import what, see import-linter's contracts."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import frenetic

ROOT = Path(frenetic.__file__).parent


def imports_within_functions(path: Path) -> Iterator[int]:
    """The lines, from 0."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            for node in ast.walk(function):
                if isinstance(node, (ast.Import, ast.ImportFrom)):
                    yield node.lineno - 1


def test_an_import_within_a_function_says_why() -> None:
    unexplained = []
    for path in sorted(ROOT.rglob("*.py")):
        if {"cli", "commands", "command"} & {*path.parts, path.stem}:  # help has to come at once
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        unexplained += [
            f"{path.relative_to(ROOT)}:{number + 1}"
            for number in imports_within_functions(path)
            if "#" not in lines[number] + lines[number - 1]
        ]
    assert unexplained == []
