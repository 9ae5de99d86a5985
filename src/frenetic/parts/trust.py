"""Trust: which code that a file names may be loaded, since its user has signed, listed or named it.

A campaign, a road's file, a TOML or a profile names its driver, simulator and strategy, and a
stranger may have written it. `named_code` finds the parts that name code; such code is loaded

- if the command names the part itself, or with ``--trust``: from the current folder;
- if this user's own commands wrote the file (`frenetic.parts.signatures`): from the folder that the
  signature names, and from no other;
- if this user has named or trusted it before in this very file of TOML
  (`frenetic.parts.allowed_files`), in the same current folder.

Each command calls `require_trusted` before it makes a part; workers, clusters and the child process
of `compare` load only code that passed. A script in Python that makes the parts of a file has no
such check.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from frenetic._support.option_text import PROGRAM, part_word
from frenetic._support.printable import shortened
from frenetic.errors import FreneticError
from frenetic.parts.allowed_files import allow, is_allowed
from frenetic.parts.named_code import REGISTRIES, Parts, named_code, without_number
from frenetic.parts.signatures import is_signed
from frenetic.parts.versions import sources_named

_MAX_TEXT: Final = 300  # characters of a part or a folder in a message; our choice


def is_here(folder: Path) -> bool:
    """Return whether a folder is the current folder."""
    return folder.resolve() == Path.cwd()


class CodeClaim(NamedTuple):
    """The parts that a file names, and the signature that it holds; nothing here is checked yet."""

    parts: Parts
    """All parts that the file names, as it names them."""
    signature: object = None
    """Signature in the file; None without a signature."""
    folder: object = None
    """Folder from which the file says that the code was loaded."""
    sources: object = None
    """Sources of the parts that the file stores, as for `sign`."""


def require_trusted(
    source: Path | str,
    claim: CodeClaim,
    *,
    named: Parts = MappingProxyType({}),
    needed: Parts | None = None,
    is_trusted: bool = False,
    is_toml: bool = False,
    optional: Collection[str] = tuple(REGISTRIES),
) -> Path:
    """Check that the code that a file or campaign names may be loaded, and return its folder.

    Code that the command names itself is loaded from the current folder, whatever is returned.

    Args:
        source: the file or campaign.
        claim: parts and signature in the source.
        named: parts that the command names itself, with the options that it sets.
        needed: parts that the command makes; by default the parts of the source, except that a
            named part replaces the source's part of its kind. An option of a named part that comes
            from the source has to be trusted, too. Parts of another file need another call.
        is_trusted: whether the command trusts the source, by ``--trust``. The caller then signs a
            campaign or a road's file, with the returned folder.
        is_toml: whether a person may have written the source, as TOML. Named or trusted code is
            then noted, see `frenetic.parts.allowed_files`.
        optional: kinds of parts for which the command has an option, for the message.

    Returns:
        The signed folder if a signature decides, else the current folder.

    Raises:
        FreneticError: the source names code that the user has neither signed nor allowed; one line
            says which, and what to do.
    """
    code, command_code = named_code(claim.parts), named_code(named)
    needed_code = named_code({**claim.parts, **named} if needed is None else needed)
    untrusted = [kind for kind in needed_code if command_code.get(kind) != needed_code[kind]]
    folder = claim.folder
    if untrusted and is_signed(claim.signature, code, folder, claim.sources):
        signed_folder = Path(str(folder))
        if signed_folder.is_dir():
            return signed_folder
        if not is_trusted:
            texts, remedy = _texts_and_remedy(untrusted, needed_code, optional)
            raise FreneticError(
                f"{source} names {texts}, code that was in {shortened(str(folder), _MAX_TEXT)},"
                f" which is no folder now: if it is here, {remedy}"
            )
    if is_trusted or not untrusted:
        is_named = all(command_code.get(kind) == code[kind] for kind in code)
        if is_toml and code and (is_trusted or is_named):
            allow(source, code)
        return Path.cwd()
    if is_toml and is_allowed(source, code):
        return Path.cwd()
    texts, remedy = _texts_and_remedy(untrusted, needed_code, optional)
    if folder and any(
        _is_missing(without_number(kind), needed_code[kind][0]) for kind in untrusted
    ):
        folder_text = shortened(str(folder), _MAX_TEXT)
        remedy = f"go to where it was as that says, {folder_text}, and {remedy}"
    raise FreneticError(
        f"{source} names {texts}, code that you have not trusted: if you do, {remedy}"
    )


def _texts_and_remedy(
    kinds: Iterable[str], parts: Parts, optional: Collection[str]
) -> tuple[str, str]:
    """Return the text of parts for a message, and what makes the command load them.

    Args:
        kinds: kinds of the parts.
        parts: kind -> name and options.
        optional: kinds of parts for which the command has an option.
    """
    texts, arguments, have_options = [], [], True
    for kind in kinds:
        word, (name, options) = without_number(kind), parts[kind]
        text, argument = shortened(name, _MAX_TEXT), shortened(part_word(name, options), _MAX_TEXT)
        if PROGRAM in options:  # all of it will run
            text = argument = part_word(name, options)
        texts.append(f"the {word} {text!r}")
        if word in optional:
            arguments += [f"--{word}", argument]
        else:
            have_options = False
    remedy = f"name it yourself, {shlex.join(arguments)}, or add --trust"
    return " and ".join(texts), remedy if have_options else "add --trust"


def _is_missing(kind: str, name: str) -> bool:
    """Return whether the file or module of a part is missing; import nothing."""
    registry, source = REGISTRIES.get(kind), name.rpartition(":")[0] or name
    if registry is None or name in {entry.name for entry in registry.entries()}:
        return False
    try:
        if source.endswith(".py") or Path(source).suffix.lower() in registry.files:
            return not Path(source).expanduser().is_file()
        return not sources_named(name) and find_spec(source.partition(".")[0]) is None
    except (OSError, ValueError, RuntimeError):
        return False
