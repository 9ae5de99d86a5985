"""The command line of back-to-back: what a driver's developer sees of it."""

from __future__ import annotations

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
OLD, NEW = 1.25, 0.8
"""Aggressions of the two versions, so different that few roads tell which is better."""
FEW = ("--fresh", "20", "--top", "3")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """Two versions of a driver, each in a folder with a neighbour of the same name."""
    folder = tmp_path_factory.mktemp("back-to-back")
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
    answer = frenetic("back-to-back", old, new, *FEW)
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
    turned = frenetic("back-to-back", new, old, *FEW)
    assert turned.code == 1
    assert turned.out.startswith("new is worse: of 20 fresh roads, it fails on ")


def test_json_holds_the_answer_and_all_behind_it(
    frenetic: Frenetic, versions: tuple[str, str]
) -> None:
    answer = frenetic("back-to-back", *versions, *FEW, "--seed", "9", "--json")
    document = answer.json
    assert answer.code == {"new is better": 0, "cannot tell": 3}[document["verdict"]]
    assert (document["seed"], document["repeats"]) == (9, 1)
    fresh, old, *_ = document["sets"]
    assert (fresh["roads"], fresh["judged"], old["judged"]) == ("fresh roads", 20, 3)
    assert sum(fresh["changes"].values()) == len(fresh["tests"]) == 20
    assert fresh["difference"]["cannot_tell"] == (document["verdict"] == "cannot tell")
    assert {one["fate"] for one in document["distinct_failures"]} >= {"fixed"}


def test_another_driver_takes_the_place_of_a_campaigns(frenetic: Frenetic, campaign: str) -> None:
    answer = frenetic("back-to-back", campaign, "--driver", "aggression=1.3", *FEW)
    assert answer.code in (1, 3)
    assert "new: planner,aggression=1.3" in answer.out
    options = "--driver", "stanley", "--old-driver", "aggression=0.9"
    answer = frenetic("back-to-back", campaign, *options, *FEW)
    assert "old: planner,aggression=0.9 (" in answer.out
    assert "old passes " in answer.out, "it is not the version of the campaign"


def test_a_version_that_crashes_is_no_better(frenetic: Frenetic, versions: tuple[str, str]) -> None:
    old, _ = versions
    answer = frenetic("back-to-back", old, "--driver", "v2/v2.py:Crashing", *FEW)
    assert answer.code == 3
    assert answer.out.startswith("cannot tell which is better: no fresh road could be judged")
    assert "new broke in 23 drives" in answer.out
    assert "ValueError: no way" in answer.out


def test_the_same_command_goes_on_after_ctrl_c(
    frenetic: Frenetic, versions: tuple[str, str]
) -> None:
    old, _ = versions
    answer = frenetic("back-to-back", old, "--driver", "v2/v2.py:Stopping", *FEW)
    assert (answer.code, answer.out) == (130, "")
    assert "Interrupted: 22 drives to go; the same command goes on" in answer.err
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    again = frenetic("back-to-back", old, "--driver", "v2/v2.py:Stopping", *FEW)
    assert "Interrupted: 21 drives to go" in again.err


def rewrite(file: Path, text: str, seconds_later: int) -> None:
    """Write a module as an edit in another second: Python's cache of bytecode tells no finer."""
    file.write_text(text)
    later = file.stat().st_mtime + seconds_later
    os.utime(file, (later, later))


def test_two_versions_of_one_file_are_told_apart(
    frenetic: Frenetic, versions: tuple[str, str]
) -> None:
    old, _ = versions
    edited = Path("v1/v1.py")
    Path("kept").mkdir()
    for name in ("v1.py", "gains.py"):
        Path("kept", name).write_text(Path("v1", name).read_text())
    edited.write_text(edited.read_text() + "\n# better\n")
    answer = frenetic("back-to-back", old, "--driver", "v2/v2.py:Mine", *FEW)
    assert answer.code == 0, "the old version drives as the campaign has kept it"
    # The same names, other files.
    driven = "--old-driver", "kept/v1.py:Mine", "--driver", "v1/v1.py:Mine", *FEW
    first = frenetic("back-to-back", old, *driven, "--json")
    assert "another version than the campaign's" not in first.err, "that is what was asked for"
    assert first.json["sets"][0]["changes"]["passes now"] == 0
    rewrite(Path("v1/gains.py"), "AGGRESSION = 0.7\n", seconds_later=2)
    second = frenetic("back-to-back", old, *driven, "--json")
    assert second.json["sets"][0]["changes"]["passes now"] > 0, "an edited neighbour drives anew"
    rewrite(Path("v1/gains.py"), f"AGGRESSION = {OLD}\n", seconds_later=4)
    edited.write_text(Path("kept/v1.py").read_text())
    assert frenetic("back-to-back", old, *driven).refuses("both versions are the same")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), ("say what the new version is", "--driver")),
        (("c",), ("c is there twice",)),
        (("elsewhere",), ("elsewhere does not exist",)),
        (("--driver", "planner"), ("both versions are the same",)),
        (("--driver", "missing.py:Mine"), ("there is no file 'missing.py'",)),
        (("--driver", "agression=1"), ("did you mean 'aggression'?",)),
        (("--driver", "stanley", "--seed", "3"), ("seed 3 is that of a campaign",)),
        (("--driver", "stanley", "--simulator", "host=h"), ("which is nowhere else",)),
    ],
)
def test_mistakes(
    frenetic: Frenetic, campaign: str, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert frenetic("back-to-back", campaign, *arguments).refuses(*words)
    assert not Path(campaign, "fresh").exists(), "nothing is half-written"


def test_campaigns_that_differ_in_more_than_the_driver_are_refused(
    frenetic: Frenetic, campaign: str
) -> None:
    other = ("run", "--simulations", "2", "--seed", "1", "--workers", "1", "--out", "other")
    frenetic(*other, "--driver", "stanley", "--speed-limit", "60", "--json")
    answer = frenetic("back-to-back", campaign, "other")
    assert answer.refuses("c and other differ in rules: only versions of a driver can be compared")
