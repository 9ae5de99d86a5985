"""Paths of a user's files in names and options of parts, made absolute for another folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from frenetic._support.option_text import PROGRAM, join_command, split_command


def path_in(folder: Path | str, name: str) -> Path:
    """Return the path of a user's file, which may be relative to a folder."""
    return Path(folder, Path(name).expanduser())


def absolute_files(options: Mapping[str, Any], folder: Path | str) -> dict[str, Any]:
    """Return options in which the path of each existing file is absolute.

    Args:
        options: options of a part.
        folder: folder to which relative paths refer.
    """
    return {
        option: _absolute_program(value, folder)
        if option == PROGRAM and isinstance(value, str)
        else str(file.absolute())
        if isinstance(value, str) and value and (file := path_in(folder, value)).exists()
        else value
        for option, value in options.items()
    }


def _absolute_program(command: str, folder: Path | str) -> str:
    """Return a command in which the paths of program and files are absolute.

    A program without a slash, such as ``node``, is looked for where the system looks for programs.
    """
    try:
        words = split_command(command)
        paths = [path_in(folder, word).absolute() for word in words]
    except (ValueError, RuntimeError):  # it is refused where the part is made, or has no such home
        return command
    return join_command(
        [
            # Any text may be an argument, also one that is too long for a path.
            str(path) if os.path.isfile(path) and (i or Path(word).name != word) else word  # noqa: PTH113
            for i, (word, path) in enumerate(zip(words, paths, strict=True))
        ]
    )
