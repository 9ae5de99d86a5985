"""Loading of a user's own modules, with a refusal if Python would import another in their place."""

from __future__ import annotations

import hashlib
import importlib
import importlib.machinery
import importlib.util
import os
import sys
import sysconfig
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final, NamedTuple

from frenetic.errors import FreneticError
from frenetic.parts.source_imports import files_of, imported_names

USER_MODULE: Final = "frenetic_user_"
"""Prefix of the names of modules loaded from a user's file."""
_INSTALL_FOLDERS: Final = frozenset({"site-packages", "dist-packages"})
"""Names of the folders that hold installed packages."""
_STANDARD_FOLDERS: Final = tuple({sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")})
"""Folders of the standard library."""
_ADDED_FOLDERS: Final[set[str]] = set()
"""Folders of users' parts that this process has added to the module path."""


def _add_folder(folder: Path) -> None:
    """Put the folder of a user's part at the end of the module path, before earlier parts' folders.

    A module beside the part then comes before modules beside other parts, but after installed
    modules.
    """
    added = str(folder)
    if added in sys.path and added not in _ADDED_FOLDERS:
        return
    _ADDED_FOLDERS.add(added)
    earlier = [path for path in sys.path if path in _ADDED_FOLDERS and path != added]
    sys.path[:] = [*(path for path in sys.path if path not in _ADDED_FOLDERS), added, *earlier]


def user_folders() -> frozenset[str]:
    """Return the folders of users' parts that this process has added to the module path."""
    return frozenset(_ADDED_FOLDERS)


def load_own_module(name: str) -> Any:
    """Import a module that the user named, which may lie in the current folder, and return it.

    Raises:
        FreneticError: Python would import another module in place of the named one or of a module
            that it imports.
    """
    folder = Path.cwd()
    _add_folder(folder)
    top = name.partition(".")[0]
    if (shadowed := _shadowed(top, folder)) is not None:
        raise FreneticError(
            f"Python takes {shadowed.by} for the module {top!r}, not {shadowed.file}: rename that,"
            " or name a file in it, such as path/to/file.py:Class"
        )
    _check_helpers(files_of(name, [folder]), folder)
    return importlib.import_module(name)


class _Shadowed(NamedTuple):
    """A module of a user's folder that another module of the same name shadows."""

    file: Path
    """File of the user's module."""
    by: str
    """File that Python imports; ``built-in`` or ``frozen`` for a module without a file."""


def _check_helpers(files: Iterable[tuple[str, Path, Path]], folder: Path) -> None:
    """Check that Python imports the modules beside a user's file, where the file imports them.

    Args:
        files: name, file and folder of each module, as `files_of` gives them.
        folder: folder of the modules beside the file.

    Raises:
        FreneticError: Python would import a standard, installed or other module instead.
    """
    waiting, read_files = list(files), set[Path]()
    while waiting:
        module, file, _ = waiting.pop()
        if file in read_files:
            continue
        read_files.add(file)
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        for imported in imported_names(file.read_text("utf-8", "replace"), package):
            top = imported.partition(".")[0]
            shadowed = _shadowed(top, folder)
            if shadowed is not None and shadowed.file not in read_files:
                raise FreneticError(
                    f"{file} imports {top!r}: Python takes {shadowed.by} for it, not"
                    f" {shadowed.file}: rename that"
                )
            waiting += files_of(imported, [folder])


def _shadowed(name: str, folder: Path) -> _Shadowed | None:
    """Return the module of a folder if Python imports another module of its name; else None.

    Args:
        name: name of the module, without dots.
        folder: a folder on the module path.
    """
    stems = (f"{name}/__init__", name) if name else ()
    suffixes = importlib.machinery.all_suffixes()
    files = [folder / f"{stem}{suffix}" for stem in stems for suffix in suffixes]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        return None
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # `__main__` has no spec
        return None
    if spec is None or (spec.has_location and Path(spec.origin or "").resolve() == file.resolve()):
        return None
    return _Shadowed(file, spec.origin or f"another {name}")


def is_local(file: Path) -> bool:
    """Return whether a module's file is neither installed nor part of the standard library."""
    is_installed = not _INSTALL_FOLDERS.isdisjoint(file.parts)
    return not is_installed and not any(file.is_relative_to(place) for place in _STANDARD_FOLDERS)


def user_files() -> list[str]:
    """Return the files of users' own modules that this process has loaded."""
    return [
        module.__file__
        for name, module in sys.modules.copy().items()  # another thread may be importing
        if name.startswith(USER_MODULE) and module.__file__ is not None
    ]


def load_user_file(name: str) -> Any:
    """Return the module in a user's file, which is loaded once in each process.

    Raises:
        FreneticError: the file does not exist or is no Python, or Python would import another
            module in place of one beside the file.
    """
    path = Path(name).expanduser()
    if not path.is_file():
        raise FreneticError(f"there is no file {name!r}")
    path = path.resolve()
    # The same name in every process, so that its objects can be sent between processes.
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:12]
    module_name = f"{USER_MODULE}{path.stem}_{digest}"
    if module_name in sys.modules:
        return sys.modules[module_name]
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise FreneticError(f"{name!r} cannot be read as Python")
    # The file may import modules beside it, unless an installed module has the same name.
    _add_folder(path.parent)
    _check_helpers([("", path, path.parent)], path.parent)
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[module_name]
        raise
    return module
