"""Files with entries: TOML of a run, and roads with how they were driven."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import tomli_w
from msgspec import ValidationError, convert, to_builtins

from frenetic._support.bounds import check
from frenetic._support.files import read_bounded, write_file
from frenetic._support.outside_text import read_json, read_toml
from frenetic._support.scalars import without_numpy
from frenetic.errors import FreneticError
from frenetic.parts.registry import hint

DRIVEN: Final = "driven"
"""Entry of a road's file with the spec that drove it, see `frenetic.spec.Spec.driving_spec`."""
SIGNED: Final = "signed"
"""Entry with the user's signature, see `frenetic.spec.Signed`."""


def converted_entries(entries: Mapping[str, Any], kind: type[Any]) -> Any:
    """Return entries as a struct of this kind.

    Raises:
        ValueError: an entry is unknown, missing, of another kind or out of range; the message
            names it.
    """
    known: tuple[str, ...] = kind.__struct_encode_fields__
    if unknown := [name for name in entries if name not in known]:
        attribute = dict(zip(kind.__struct_fields__, known, strict=True)).get(unknown[0])
        close = f": it is {attribute!r}" if attribute else hint(unknown[0], known)
        others = f"; there are {', '.join(known)}" if close == "." else close
        raise ValueError(f"there is no entry {unknown[0]!r}{others}")
    check(entries, kind)
    try:
        return convert(without_numpy(entries), kind)
    except ValidationError as error:
        raise ValueError(str(error)) from None


def read_table(path: Path, about: str) -> dict[str, Any]:
    """Return the entries of a file in TOML, not validated.

    Args:
        path: path of the file.
        about: what the file says, for messages.

    Raises:
        FreneticError: there is no such file, or it is no TOML.
    """
    data = read_bounded(path)
    try:
        return read_toml(data)
    except ValueError as error:
        raise FreneticError(f"{path} does not say {about}: {error}") from None


def read_entries(path: Path, kind: type[Any], about: str) -> Any:
    """Return the entries of a file in TOML as a struct.

    Args:
        path: of the file.
        kind: class of the struct.
        about: words for the content, for messages.

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
    """Write a signature into the entry `DRIVEN` of a file in JSON, which is replaced whole.

    Raises:
        FreneticError: the file cannot be read or written.
    """
    try:
        content = read_json(read_bounded(path))
        content[DRIVEN][SIGNED] = to_builtins(signed)
    except (ValueError, TypeError, LookupError):
        raise FreneticError(f"{path} holds several roads, so --trust cannot sign it") from None
    write_file(path, f"{json.dumps(content)}\n", remedy="let it be written, or name the part")


def write_entries(entries: Mapping[str, Any], path: Path, about: str) -> None:
    """Write a file in TOML, without empty entries, under a line about it.

    Raises:
        FreneticError: the file cannot be written.
    """
    filled = {name: value for name, value in entries.items() if value not in (None, {}, [])}
    text = f"# {about}\n{tomli_w.dumps(filled)}"
    write_file(path, text, remedy="make room, or let it be written")
