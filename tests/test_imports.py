"""Imports within functions and on use; `lint-imports` checks which room imports which."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

import frenetic
from frenetic.parts.registry import OBJECTIVES

ROOT = Path(frenetic.__file__).parent


def imports_within_functions(path: Path) -> Iterator[int]:
    """Yield the lines of imports within functions, from 0."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            for node in ast.walk(function):
                if isinstance(node, (ast.Import, ast.ImportFrom)):
                    yield node.lineno - 1


def test_an_import_within_a_function_says_why() -> None:
    unexplained = []
    for path in sorted(ROOT.rglob("*.py")):
        if {"cli", "commands", "command"} & {*path.parts, path.stem}:  # so that help comes at once
            continue
        lines = path.read_text(encoding="utf-8").splitlines()
        unexplained += [
            f"{path.relative_to(ROOT)}:{number + 1}"
            for number in imports_within_functions(path)
            if "#" not in lines[number] + lines[number - 1]
        ]
    assert unexplained == []


def package_of(init: Path) -> str:
    return ".".join(["frenetic", *init.parent.relative_to(ROOT).parts])


LAZY_PACKAGES = [
    package_of(init)
    for init in sorted(ROOT.rglob("__init__.py"))
    if "\n_MODULES = " in init.read_text(encoding="utf-8")
]


def names_for_type_checkers(package: str) -> dict[str, str]:
    """Return the names that a package imports below ``if TYPE_CHECKING``, each with its module."""
    path = import_module(package).__file__
    assert path is not None
    tree = ast.parse(Path(path).read_text(encoding="utf-8"))
    return {
        alias.name: node.module or ""
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom) and node.module != "typing"
        for alias in node.names
    }


@pytest.mark.parametrize("package", LAZY_PACKAGES)
def test_names_imported_on_use_equal_those_of_type_checkers(package: str) -> None:
    module = import_module(package)
    assert names_for_type_checkers(package) == module._MODULES
    assert sorted(module.__all__) == sorted(module._MODULES)


@pytest.mark.parametrize("package", LAZY_PACKAGES)
def test_each_name_imported_on_use_exists(package: str) -> None:
    module = import_module(package)
    for name in module._MODULES:
        assert getattr(module, name) is not None


def test_the_packages_with_slow_imports_import_names_on_use() -> None:
    assert {"frenetic", "frenetic.drivers", "frenetic.oracle", "frenetic.report"} <= {
        *LAZY_PACKAGES
    }


def test_an_unknown_name_of_a_package_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'frenetic' has no attribute 'Plan'"):
        _ = frenetic.Plan


def leads_somewhere(reference: str) -> bool:
    """Return whether a name such as ``frenetic.search.Frenetic.ask`` is there."""
    parts = reference.split(".")
    for count in range(len(parts), 0, -1):
        try:
            target: Any = import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            if not str(error.name).startswith("frenetic"):
                return True  # it needs a package that is not installed
            continue
        for name in parts[count:]:
            target = getattr(target, name, None)
        return target is not None
    return False


def test_names_in_docstrings_lead_somewhere() -> None:
    named = {
        (str(path.relative_to(ROOT)), reference)
        for path in ROOT.rglob("*.py")
        for reference in re.findall(r"`(frenetic(?:\.\w+)+)`", path.read_text(encoding="utf-8"))
    }
    assert len(named) > 100
    groups = {*entry_points().groups, OBJECTIVES.group}
    names = [name for name in sorted(named) if name[1] not in groups]
    assert [name for name in names if not leads_somewhere(name[1])] == []
