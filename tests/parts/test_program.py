"""Version and commit of Frenetic itself."""

from __future__ import annotations

import importlib.metadata
import json
import shutil
import subprocess
from pathlib import Path

import pytest

from frenetic.parts import program
from frenetic.parts.program import COMMIT, citation, commit_of, program_commit, program_text
from frenetic.parts.versions import changed_packages, package_versions

SHA = "1f3a9c07" * 5
OTHER = "0badcafe" * 5


def write_git(root: Path, **files: str) -> Path:
    """Write files of git into a clone; in their names, two underscores stand for a slash."""
    for name, text in files.items():
        path = root / ".git" / name.replace("__", "/").replace("packed_refs", "packed-refs")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


def test_the_commit_is_read_of_a_branch_of_packed_branches_and_without_a_branch(
    tmp_path: Path,
) -> None:
    on_main, packed = "ref: refs/heads/main\n", f"# pack-refs with: peeled\n{SHA} refs/heads/main\n"
    branch = write_git(tmp_path / "a", HEAD=on_main, refs__heads__main=f"{SHA}\n")
    both = write_git(
        tmp_path / "b", HEAD=on_main, refs__heads__main=SHA, packed_refs=packed.replace(SHA, OTHER)
    )
    packed_alone = write_git(
        tmp_path / "c", HEAD=on_main, packed_refs=f"{OTHER} refs/heads/not/main\n{packed}"
    )
    detached = write_git(tmp_path / "d", HEAD=f"{SHA}\n")
    assert {commit_of(root) for root in (branch, both, packed_alone, detached)} == {SHA}


def test_without_a_readable_commit_there_is_none(tmp_path: Path) -> None:
    write_git(tmp_path / "a", HEAD="ref: refs/heads/main\n")
    write_git(tmp_path / "b", HEAD="ref: refs/heads/main", refs__heads__main="not one")
    (tmp_path / "c").mkdir()
    (tmp_path / "c" / ".git").write_bytes(b"gitdir: \xff\n")
    assert {commit_of(tmp_path / name) for name in "abcd"} == {None}


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_clones_and_worktrees_of_git_itself_are_read(tmp_path: Path) -> None:
    def git(*words: str, folder: Path = tmp_path / "clone") -> str:
        command = ["git", "-c", "user.name=me", "-c", "user.email=me@example.org", *words]
        return subprocess.run(
            command, cwd=folder, check=True, capture_output=True, text=True
        ).stdout.strip()

    (tmp_path / "clone").mkdir()
    git("init", "--quiet")
    for change in ("first", "second"):
        git("commit", "--quiet", "--allow-empty", "--message", change)
    git("worktree", "add", "--quiet", "-b", "side", str(tmp_path / "side"), "HEAD~1")
    for _ in range(2):
        for folder in (tmp_path / "clone", tmp_path / "side"):
            assert commit_of(folder) == git("rev-parse", "HEAD", folder=folder)
        git("pack-refs", "--all")
    assert commit_of(tmp_path / "clone") != commit_of(tmp_path / "side")


class _Installed:
    """A distribution as pip leaves it."""

    version = "1.2"

    def __init__(self, direct_url: str | None) -> None:
        self.direct_url = direct_url

    def read_text(self, name: str) -> str | None:
        return self.direct_url if name == "direct_url.json" else None


@pytest.mark.parametrize(
    ("direct_url", "commit"),
    [
        (json.dumps({"url": "x", "vcs_info": {"vcs": "git", "commit_id": SHA}}), SHA),
        (json.dumps({"url": "file:///home/me/frenetic", "dir_info": {"editable": True}}), None),
        (json.dumps({"vcs_info": {"commit_id": "$(rm)"}}), None),
        ("[]", None),
        (None, None),
    ],
)
def test_the_commit_of_an_installed_repository_is_what_pip_wrote(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, direct_url: str | None, commit: str | None
) -> None:
    monkeypatch.setattr(program, "_PACKAGE", tmp_path / "site-packages" / "frenetic")
    monkeypatch.setattr(importlib.metadata, "distribution", lambda _: _Installed(direct_url))
    # A repository around the environment is the user's, not Frenetic's.
    write_git(tmp_path, HEAD=OTHER)
    assert program_commit() == commit
    assert program_text().endswith(f", commit {SHA[:12]}") is (commit is not None)
    assert package_versions().get(COMMIT) == commit


def test_versions_and_citation_name_the_commit_of_a_clone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program, "_PACKAGE", tmp_path / "src" / "frenetic")
    (tmp_path / "pyproject.toml").touch()
    write_git(tmp_path, HEAD=OTHER)
    before = package_versions()
    write_git(tmp_path, HEAD=SHA)
    assert changed_packages(before) == [f"{COMMIT} {OTHER}, now {SHA}"]
    assert f"commit {SHA[:12]}; and E. Castellano" in citation()
    assert "The default search, frenetic, is ours" in citation()
