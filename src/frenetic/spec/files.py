"""Reading and writing entries: the TOML of a run, and a road's file that says who drove it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeVar

import tomli_w
from msgspec import ValidationError, convert, to_builtins

from frenetic._support.bounds import check
from frenetic._support.files import read_bounded, write_file
from frenetic._support.outside_text import read_json, read_toml
from frenetic._support.scalars import without_numpy
from frenetic.errors import FreneticError
from frenetic.parts.registry import hint

EntriesType = TypeVar("EntriesType")

DRIVEN: Final = "driven"
"""Entry of a road's file with the spec of its drive, see `frenetic.spec.Spec.driving_spec`."""
SIGNED: Final = "signed"
"""Entry with the user's signature, see `frenetic.spec.Signed`."""


def converted_entries(entries: Mapping[str, Any], kind: type[EntriesType]) -> EntriesType:
    """Return entries as a struct.

    Args:
        entries: values by their names in a file.
        kind: class of the struct, a subclass of `msgspec.Struct`.

    Raises:
        ValueError: an entry is unknown, missing, of another kind or out of range; the message
            names it.
    """
    struct: Any = kind
    known: tuple[str, ...] = struct.__struct_encode_fields__
    if unknown := [name for name in entries if name not in known]:
        # Some attributes of Python are named otherwise than their entry, such as `conditions`.
        entry_of_attribute = dict(zip(struct.__struct_fields__, known, strict=True))
        entry = entry_of_attribute.get(unknown[0])
        advice = f": it is {entry!r}" if entry else hint(unknown[0], known)
        if advice == ".":  # no known name is close
            advice = f"; there are {', '.join(known)}"
        raise ValueError(f"there is no entry {unknown[0]!r}{advice}")
    check(entries, kind)
    try:
        return convert(without_numpy(entries), kind)
    except ValidationError as error:
        raise ValueError(str(error)) from None


def read_table(path: Path, about: str) -> dict[str, Any]:
    """Return the entries of a TOML file without checking them.

    Args:
        path: path of the file.
        about: noun for the content, such as "a run", for messages.

    Raises:
        FreneticError: the file does not exist, or is no TOML.
    """
    data = read_bounded(path)
    try:
        return read_toml(data)
    except ValueError as error:
        raise FreneticError(f"{path} does not say {about}: {error}") from None


def read_entries(path: Path, kind: type[EntriesType], about: str) -> EntriesType:
    """Return the entries of a TOML file as a struct.

    Args:
        path: path of the file.
        kind: class of the struct, a subclass of `msgspec.Struct`.
        about: noun for the content, such as "a run", for messages.

    Raises:
        FreneticError: the file does not exist, or an entry is wrong; the message names it.
    """
    entries = read_table(path, about)
    try:
        return converted_entries(entries, kind)
    except ValueError as error:
        raise FreneticError(f"{path} does not say {about}: {error}") from None
    except FreneticError as error:
        raise FreneticError(f"{path}: {error}") from None


def sign_driven(path: Path, signed: object) -> None:
    """Write a signature into the entry `DRIVEN` of a road's file, which is replaced whole.

    Args:
        path: path of a file in JSON.
        signed: a `frenetic.spec.Signed`.

    Raises:
        FreneticError: the file cannot be read or written, or holds several roads.
    """
    try:
        content = read_json(read_bounded(path))
        content[DRIVEN][SIGNED] = to_builtins(signed)
    except (ValueError, TypeError, LookupError):
        raise FreneticError(f"{path} holds several roads, so --trust cannot sign it") from None
    write_file(path, f"{json.dumps(content)}\n", remedy="let it be written, or name the part")


def write_entries(entries: Mapping[str, Any], path: Path, about: str) -> None:
    """Write the entries that are not empty into a TOML file.

    Args:
        entries: values by name.
        path: path of the file.
        about: comment for the file's first line.

    Raises:
        FreneticError: the file cannot be written.
    """
    filled = {name: value for name, value in entries.items() if value not in (None, {}, [])}
    text = f"# {about}\n{tomli_w.dumps(filled)}"
    write_file(path, text, remedy="make room, or let it be written")
