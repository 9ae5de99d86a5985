"""Separate Python environments, for tools that need other versions of our packages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

import pytest

OPENDRIVE_CHECKER = "asam-qc-opendrive==1.0.0"
OPENSCENARIO_CHECKER = "asam-qc-openscenarioxml==1.0.0"
COMMONROAD = "commonroad-scenario-designer==0.8.5"
ASAM_CHECKS = Path(__file__).with_name("asam_checks.py")
"""Script that runs one of ASAM's checkers."""


def python_with(package: str, request: pytest.FixtureRequest) -> str:
    """Return the path of a Python with a package, in an environment that later runs reuse.

    Raises:
        OSError: the package cannot be installed.
    """
    return installed(package, request.config.cache.mkdir(_name(package)))


def installed(package: str, folder: Path) -> str:
    """Return the path of the Python in an environment with a package; make what is missing.

    Raises:
        OSError: the package cannot be installed.
    """
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    complete = folder / "complete"
    if not (complete.exists() and complete.read_text() == package):
        venv.create(folder, clear=True, with_pip=True)
        # Compiling all modules takes longer than installing them; few are imported.
        command = [str(python), "-m", "pip", "install", "--quiet", "--no-compile", package]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode != 0:
            raise OSError(f"{' '.join(command)} failed: {done.stderr.strip()[-300:]}")
        complete.write_text(package)
    return str(python)


def _name(package: str) -> str:
    return f"{package.split('=')[0]}-{sys.version_info.major}.{sys.version_info.minor}"


def answers(python: str, script: Path, *arguments: str | Path) -> dict[str, Any]:
    """Run a script with another Python and return the JSON that it prints."""
    command = [python, str(script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document
