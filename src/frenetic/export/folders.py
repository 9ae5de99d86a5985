"""Folders of exported files, which are complete or missing."""

from __future__ import annotations

import glob
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from frenetic.errors import FreneticError

EXPORTS: Final = "exports"
"""Folder for exports in a campaign's folder."""


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Yield a new folder beside ``target`` to write into; rename it to ``target`` at the end.

    If an error is raised meanwhile, the new folder is removed. After a kill, the next call removes
    it.

    Raises:
        FreneticError: ``target`` is not empty, or the disk is full or cannot be written.
    """
    target = target.absolute()
    try:
        if os.path.lexists(target) and (not target.is_dir() or any(target.iterdir())):
            raise FreneticError(f"{target} exists already: choose another place, or remove it")
        for leftover in target.parent.glob(f".{glob.escape(target.name)}-[0-9]*.part"):
            shutil.rmtree(leftover, ignore_errors=True)
        partial = target.with_name(f".{target.name}-{os.getpid()}.part")
        partial.mkdir(parents=True)
        try:
            yield partial
            if target.is_dir():  # it is empty; some platforms rename onto no existing folder
                target.rmdir()
            partial.rename(target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise FreneticError(
            f"{target} cannot be written: {error.strerror or error}; choose another place"
        ) from error


@contextmanager
def added_to(target: Path) -> Iterator[Path]:
    """Yield a folder to which files are added, and make it if it is missing.

    Raises:
        FreneticError: the folder cannot be made, or the disk is full or cannot be written.
    """
    try:
        target.mkdir(parents=True, exist_ok=True)
        yield target
    except OSError as error:
        raise FreneticError(
            f"{target} cannot be written: {error.strerror or error}; choose another place"
        ) from error
