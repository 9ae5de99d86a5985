"""Python environments of their own, for tools whose packages do not go with ours."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

import pytest

ASAM_CHECKS = Path(__file__).with_name("asam_checks.py")
"""Script that runs one of ASAM's checkers."""


def python_with(package: str, request: pytest.FixtureRequest) -> str:
    """The path of a Python that has a package, in an environment that is kept between runs.

    Where it cannot be installed, the test fails in CI and is skipped elsewhere.
    """
    name = f"{package.split('=')[0]}-{sys.version_info.major}.{sys.version_info.minor}"
    folder = request.config.cache.mkdir(name)
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    complete = folder / "complete"
    if not (complete.exists() and complete.read_text() == package):
        venv.create(folder, clear=True, with_pip=True)
        command = [str(python), "-m", "pip", "install", "--quiet", package]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            reason = f"{' '.join(command)} failed: {done.stderr.strip()[-300:]}"
            (pytest.fail if os.environ.get("CI") else pytest.skip)(reason)
        complete.write_text(package)
    return str(python)


def answers(python: str, script: Path, *arguments: str | Path) -> dict[str, Any]:
    """What a script prints as JSON when another Python runs it."""
    command = [python, str(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document
