"""Version and commit of Frenetic itself, and how to cite it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from msgspec import Struct, ValidationError
from msgspec.json import decode

DISTRIBUTION: Final = "frenetic-roads"
"""Name of Frenetic's distribution."""
COMMIT: Final = "frenetic commit"
"""Name of the commit among the versions that a campaign records."""
PAPER: Final = (
    'E. Castellano et al., "Frenetic at the SBST 2021 Tool Competition", SBST 2021,'
    " doi:10.1109/SBST52555.2021.00016"
)
"""Paper of the algorithm that is the strategy `frenetic-2021`."""
_SHORT: Final = 12
"""Number of characters of a commit that people see (our choice)."""
_PACKAGE: Final = Path(__file__).parents[1]
"""Folder of the package `frenetic`."""
_COMMIT: Final = re.compile("[0-9a-f]{40}(?:[0-9a-f]{24})?")
_REFERENCE: Final = "ref: "
"""Beginning of a file of git that names another file with the commit."""
_GIT_FOLDER: Final = "gitdir: "
"""Beginning of a file `.git` that names a folder, as in a worktree."""


class _VersionControl(Struct, frozen=True):
    """Part of `direct_url.json` about a repository, see PEP 610."""

    commit_id: str = ""


class _DirectUrl(Struct, frozen=True):
    """Part of `direct_url.json`, which pip writes into an installed distribution."""

    vcs_info: _VersionControl = _VersionControl()


def installed_version(distribution: str) -> str | None:
    """Return the version of a distribution; None if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version  # takes its time

    try:
        return version(distribution)
    except PackageNotFoundError:
        return None


def program_commit() -> str | None:
    """Return the commit of Frenetic, 40 or 64 hexadecimal digits; None if it is not known.

    It is known in a clone, whose changed files are not noticed, and if pip installed a repository.
    """
    root = _PACKAGE.parents[1]
    is_clone = _PACKAGE.parent.name == "src" and (root / "pyproject.toml").is_file()
    return (commit_of(root) if is_clone else None) or _installed_commit()


def program_text() -> str:
    """Return name, version and, if known, commit: ``frenetic 0.1.0, commit 1f3a9c07b2d4``."""
    version, commit = installed_version(DISTRIBUTION) or "of unknown version", program_commit()
    return f"frenetic {version}" + (f", commit {commit[:_SHORT]}" if commit else "")


def citation() -> str:
    """Return how to cite Frenetic, in two sentences."""
    return (
        f"To cite: The Frenetic developers, {program_text()}; and {PAPER}. The default search,"
        " frenetic, is ours; the paper's is frenetic-2021."
    )


def commit_of(root: Path) -> str | None:
    """Return the commit that is checked out in a clone; None if the folder is no clone.

    Git is not run: its files are read, also in a worktree or a submodule. Its newer format
    `reftable` is not read.

    Args:
        root: top folder of the clone.
    """
    try:
        git = root / ".git"
        if git.is_file():
            git = root / git.read_text("utf-8").removeprefix(_GIT_FOLDER).strip()
        head = (git / "HEAD").read_text("utf-8").strip()
        if head.startswith(_REFERENCE):
            head = _commit_of_reference(git, head.removeprefix(_REFERENCE))
    except (OSError, ValueError):
        return None
    return head if _COMMIT.fullmatch(head) else None


def _commit_of_reference(git: Path, name: str) -> str:
    """Return the commit of a branch; empty if it has none.

    Args:
        git: git's folder of the clone or worktree.
        name: name of the branch, such as ``refs/heads/main``.

    Raises:
        OSError: a file cannot be read.
    """
    common = git / "commondir"  # a worktree shares the branches of its clone
    shared = git / common.read_text("utf-8").strip() if common.is_file() else git
    for folder in (git, shared):
        if (folder / name).is_file():
            return (folder / name).read_text("utf-8").strip()
    packed = shared / "packed-refs"
    lines = packed.read_text("utf-8").splitlines() if packed.is_file() else []
    commits = [line.removesuffix(f" {name}") for line in lines if line.endswith(f" {name}")]
    return commits[0] if commits else ""


def _installed_commit() -> str | None:
    """Return the commit of the repository that pip installed; None for another installation."""
    from importlib.metadata import PackageNotFoundError, distribution  # takes its time

    try:
        text = distribution(DISTRIBUTION).read_text("direct_url.json") or "{}"
        commit = decode(text, type=_DirectUrl).vcs_info.commit_id
    except (PackageNotFoundError, ValidationError, ValueError, OSError):
        return None
    return commit if _COMMIT.fullmatch(commit) else None
