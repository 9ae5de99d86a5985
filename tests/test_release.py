"""Files of a release name the same version."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize(
    ("file", "pattern"),
    [("CITATION.cff", r"^version: (\S+)$"), ("CHANGELOG.md", r"^## (\S+) \(.+\)$")],
)
def test_the_version_is_that_of_the_project(file: str, pattern: str) -> None:
    version = re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert version is not None
    assert version[1] == PROJECT["version"]


def test_the_program_starts_in_a_main_that_answers_ctrl_c() -> None:
    assert PROJECT["scripts"] == {"frenetic": "frenetic.__main__:main"}
