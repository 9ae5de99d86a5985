"""Modules of the user's own: loading them, their folders, and modules that shadow them."""

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
_INSTALLED: Final = frozenset({"site-packages", "dist-packages"})
_STANDARD: Final = tuple({sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")})
_FOLDERS: Final[set[str]] = set()
"""Folders of users' parts that this process has added to the module path."""


def _add_folder(folder: Path) -> None:
    """Put the folder of a user's part at the end of the module path, before earlier parts' folders.

    So a module beside the part comes before modules beside other parts, but after installed
    modules.
    """
    place = str(folder)
    if place in sys.path and place not in _FOLDERS:
        return
    _FOLDERS.add(place)
    earlier = [path for path in sys.path if path in _FOLDERS and path != place]
    sys.path[:] = [*(path for path in sys.path if path not in _FOLDERS), place, *earlier]


def user_folders() -> frozenset[str]:
    """Return the folders of users' parts that this process has added to the module path."""
    return frozenset(_FOLDERS)


def load_own_module(name: str) -> Any:
    """Return a module that the user named, which may lie in the current folder.

    Raises:
        FreneticError: Python would take another module for it or for one of its imports.
    """
    place = Path.cwd()
    _add_folder(place)
    top = name.partition(".")[0]
    if (shadowed := _shadowed(top, place)) is None:
        _check_helpers(files_of(name, [place]), place)
    else:
        raise FreneticError(
            f"Python takes {shadowed.by} for the module {top!r}, not {shadowed.file}: rename that,"
            " or name a file in it, such as path/to/file.py:Class"
        )
    return importlib.import_module(name)


class _Shadowed(NamedTuple):
    """A module of a user's folder in whose place Python takes another of this name."""

    file: Path
    by: str
    """File that Python takes; ``built-in`` or ``frozen`` for a part of Python without a file."""


def _check_helpers(files: Iterable[tuple[str, Path, Path]], folder: Path) -> None:
    """Check that Python imports the modules beside a user's file where the file names them.

    Args:
        files: name, file and folder of each module, as `files_of` gives them.
        folder: folder of the modules beside the file.

    Raises:
        FreneticError: Python would import a standard, installed or other module instead.
    """
    waiting, sources = list(files), set[Path]()
    while waiting:
        module, file, _ = waiting.pop()
        if file in sources:
            continue
        sources.add(file)
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        for imported in imported_names(file.read_text("utf-8", "replace"), package):
            top = imported.partition(".")[0]
            shadowed = _shadowed(top, folder)
            if shadowed is not None and shadowed.file not in sources:
                raise FreneticError(
                    f"{file} imports {top!r}: Python takes {shadowed.by} for it, not"
                    f" {shadowed.file}: rename that"
                )
            waiting += files_of(imported, [folder])


def _shadowed(name: str, folder: Path) -> _Shadowed | None:
    """Return the module of a folder if Python imports another of its name; None otherwise.

    Args:
        name: of the module, without dots.
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
    """Return whether a module's file is neither installed nor of the standard library."""
    is_installed = not _INSTALLED.isdisjoint(file.parts)
    return not is_installed and not any(file.is_relative_to(place) for place in _STANDARD)


def user_files() -> list[str]:
    """Return the files of users' own modules that this process has loaded."""
    return [
        module.__file__
        for name, module in sys.modules.copy().items()  # another thread may be importing
        if name.startswith(USER_MODULE) and module.__file__ is not None
    ]


def load_user_file(name: str) -> Any:
    """Return the module in a user's file, loaded once, under the same name in every process.

    Raises:
        FreneticError: the file does not exist or is no Python, or Python would import another
            module in place of a neighbour of the file.
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
    # The file may import its neighbours, but none of them in the place of an installed module.
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
