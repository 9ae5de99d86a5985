"""No kernel sorts: Numba's names of sorts are unique in one process, but its cache serves all."""

from __future__ import annotations

import ast
from pathlib import Path

import frenetic

SORTS = ("sort(", "sorted(", "unique(", "median(")


def test_no_kernel_sorts() -> None:
    sorting = [
        f"{file.name}: {function.name}"
        for file in Path(frenetic.__file__).parent.rglob("*.py")
        for function in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(function, ast.FunctionDef)
        and any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)
        and any(name in ast.unparse(function) for name in SORTS)
    ]
    assert sorting == [], "two cached sorts would call each other's code"
