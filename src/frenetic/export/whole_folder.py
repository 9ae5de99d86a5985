"""A folder of files that is there either completely or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from frenetic.errors import FreneticError


@contextmanager
def whole_folder(target: Path) -> Iterator[Path]:
    """Gives a new folder beside ``target`` to write into, which takes its name in the end.

    If anything is raised meanwhile, nothing is left of it.

    Raises:
        FreneticError: there is something at ``target`` but an empty folder, or the disk is full or
            cannot be written.
    """
    target = target.absolute()
    try:
        if os.path.lexists(target) and (not target.is_dir() or any(target.iterdir())):
            raise FreneticError(
                f"{target} exists already: choose another folder with --out, or remove it"
            )
        partial = target.with_name(f"{target.name}.part-{os.getpid()}")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        try:
            yield partial
            if target.is_dir():  # and empty, so that no platform minds
                target.rmdir()
            partial.rename(target)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise FreneticError(
            f"{target} cannot be written: {error.strerror or error}; choose another folder with"
            " --out"
        ) from error
