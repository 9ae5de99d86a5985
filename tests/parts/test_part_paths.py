"""Paths of a user's files in options, made absolute for another folder."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from frenetic.parts.paths import absolute_files


@pytest.mark.skipif(sys.platform == "win32", reason="the words are a POSIX shell's")
def test_program_and_files_of_a_command_become_absolute(tmp_path: Path) -> None:
    for name in ("controller", "gains.txt", "node"):
        (tmp_path / name).touch()
    long_text = "x" * 5000
    words = ["./controller", "--gain", "2", "gains.txt", "~nosuchuser/x", long_text, "a b"]
    expected = [str(tmp_path / "controller"), "--gain", "2", str(tmp_path / "gains.txt")]
    for dropped in ([], ["~nosuchuser/x"]):
        command = shlex.join(word for word in words if word not in dropped)
        absolute = absolute_files({"program": command}, tmp_path)["program"]
        if dropped:
            assert shlex.split(absolute) == [*expected, long_text, "a b"]
        else:  # there is no such home, so nothing is known of the paths
            assert absolute == command
    # A program without a folder is looked for where the system looks for programs.
    assert absolute_files({"program": "node x.mjs"}, tmp_path)["program"] == "node x.mjs"
    assert absolute_files({"program": "'open"}, tmp_path)["program"] == "'open"
