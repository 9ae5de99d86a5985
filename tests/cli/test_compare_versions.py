"""Comparing two versions of a driver on the command line."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

DRIVER = """
from frenetic import Planner
from gains import AGGRESSION


class Mine(Planner):
    def __init__(self, aggression=AGGRESSION):
        super().__init__(aggression=aggression)

    def act(self, observation):
        import gains  # only now

        assert gains.AGGRESSION == AGGRESSION, "the neighbour of another version"
        return super().act(observation)


class Crashing(Planner):
    def act(self, observation):
        raise ValueError("no " + "way")


class Stopping(Planner):
    def reset(self, setup):
        import os, signal

        os.kill(PID, signal.SIGINT)  # its own process does not hear Ctrl-C
        super().reset(setup)

    def act(self, observation):
        return super().act(observation)
"""
AS = {
    "driver": "stanley",
    "driver_options": {"aggression": 1.5},
    "simulator": "embedded",
    "map_size": 200.0,
    "speed_limit": 70.0,
    "oob_tolerance": 0.95,
    "wall_limit": 60.0,
}
OLD, NEW = 1.25, 0.8
"""Aggressions of the two versions, so different that few roads tell which is better."""
FEW = ("--fresh", "20")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """Two versions of a driver, each in a folder with a neighbour of the same name."""
    folder = tmp_path_factory.mktemp("versions")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, aggression in (("v1", OLD), ("v2", NEW)):
            Path(name).mkdir()
            Path(name, f"{name}.py").write_text(f"PID = {os.getpid()}\n{DRIVER}")
            Path(name, "gains.py").write_text(f"AGGRESSION = {aggression}\n")
            run = ("run", "--driver", f"{name}/{name}.py:Mine", "--out", f"night-{name}")
            prepare(*run, "--simulations", "12", "--seed", "3", "--workers", "1")
    return folder


@pytest.fixture
def versions(made: Path, tmp_path: Path) -> tuple[str, str]:
    """A copy of these in the folder of the command line."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    return "night-v1", "night-v2"


def test_the_first_line_says_which_is_better(frenetic: Frenetic, versions: tuple[str, str]) -> None:
    old, new = versions
    answer = frenetic("compare", old, "--driver", "v2/v2.py:Mine", *FEW)
    assert answer.code == 0
    first, *rest = answer.out.splitlines()
    assert first.startswith("new is better but ")
    assert "slower: of 20 fresh roads, it fails on " in first
    for text, line in zip(
        ("old: v1/v1.py:Mine (source ", "new: v2/v2.py:Mine ("), rest, strict=False
    ):
        assert line.startswith(text)
    for text in ("old's failing roads", "Time where both pass", "distinct failures", "Note: "):
        assert text in answer.out
    found = frenetic("compare", old, "--driver", "v2/v2.py:Mine", *FEW, "--json").json
    assert (found["verdict"], found["sets"][0]["judged"]) == ("new is better", 20)
    turned = frenetic("compare", new, "--driver", "v1/v1.py:Mine", *FEW)
    assert turned.code == 1
    assert turned.out.startswith("new is worse: of 20 fresh roads, it fails on ")


def test_another_driver_takes_the_place_of_a_campaigns(frenetic: Frenetic, campaign: str) -> None:
    answer = frenetic("compare", campaign, "--driver", "aggression=1.3", *FEW)
    assert answer.code in (1, 3)
    assert "new: planner,aggression=1.3" in answer.out
    Path("new.json").write_text(json.dumps({"driven": AS}))
    answer = frenetic("compare", campaign, "--as", "new.json", "--driver", "aggression=1.4", *FEW)
    assert "old: planner (" in answer.out
    assert "new: stanley,aggression=1.4 (" in answer.out


def test_a_version_that_crashes_is_no_better(frenetic: Frenetic, versions: tuple[str, str]) -> None:
    old, _ = versions
    answer = frenetic("compare", old, "--driver", "v2/v2.py:Crashing", *FEW)
    assert answer.code == 3
    assert answer.out.startswith("cannot tell which is better: no fresh road could be judged")
    assert "new broke in " in answer.out
    assert "ValueError: no way" in answer.out


def test_the_same_command_goes_on_after_ctrl_c(
    frenetic: Frenetic, versions: tuple[str, str]
) -> None:
    old, _ = versions
    answer = frenetic("compare", old, "--driver", "v2/v2.py:Stopping", *FEW)
    assert (answer.code, answer.out) == (130, "")
    first = int(answer.err.partition("Interrupted: ")[2].split()[0])
    assert "drives to go; the same command goes on" in answer.err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    again = frenetic("compare", old, "--driver", "v2/v2.py:Stopping", *FEW)
    assert f"Interrupted: {first - 1} drives to go" in again.err
