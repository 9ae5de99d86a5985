"""`frenetic init`: the files that it writes work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


@pytest.mark.heavy
def test_the_written_driver_passes_its_test_and_most_roads(frenetic: Frenetic) -> None:
    answer = frenetic("init", "parts/lane_keeper.py")
    assert "lane_keeper.py:LaneKeeper" in answer.out
    assert "pytest" in answer.out
    tested = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", "parts"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert tested.returncode == 0, tested.stdout
    assert "5 passed" in tested.stdout
    run = frenetic(
        *("run", "--driver", "parts/lane_keeper.py:LaneKeeper,sight=30"),
        *("--strategy", "random", "--simulations", "8", "--seed", "1", "--workers", "1", "--json"),
    )
    assert run.json["passed"] >= 5


@pytest.mark.parametrize("file", ["driver_contract.py", "controls.py", "test_contract.py"])
def test_the_name_of_the_class_differs_from_imported_names(frenetic: Frenetic, file: str) -> None:
    name = frenetic("init", file, "--json").json["class"]
    assert name == "".join(map(str.capitalize, file[:-3].split("_"))) + "Driver"
    assert f"class {name}:" in Path(file).read_text(encoding="utf-8")
    assert f"from {file[:-3]} import {name}\n" in Path(f"test_{file}").read_text(encoding="utf-8")
