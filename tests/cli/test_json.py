"""Every command gives one JSON document on stdout, and each mistake is one line on stderr."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
import pytest

from frenetic.cli import cli

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

ROAD: Final = {"curvatures": [0.0, 0.02, 0.03, 0.0, -0.02, -0.02, 0.0, 0.0]}
ONE: Final = ("--workers", "1")
CALLS: Final[dict[str, tuple[str, ...]]] = {
    "init": ("keeps_its_lane.py",),
    "run": ("--simulations", "3", "--seed", "1", *ONE, "--out", "new"),
    "resume": ("c", "--simulations", "2", *ONE),
    "show": ("c",),
    "report": ("c",),
    "check": ("c",),
    "export": ("c", "--format", "csv"),
    "rerun": ("c", "--top", "1", "--times", "2"),
    "minimise": ("c", "--max-drives", "5"),
    "calibrate": (
        "c",
        "--driver",
        "planner",
        "--fit",
        "braking",
        "--evaluations",
        "1",
        "--folds",
        "2",
        *ONE,
    ),
    "compare": ("one=c", "two=d"),
    "bench": ("--strategy", "random", "--simulations", "3", "--repeats", "1", *ONE, "--out", "b"),
    "drive": ("road.json",),
    "rank": ("road.json",),
    "list": (),
    "doctor": ("--simulator", "embedded"),
}
"""Command -> its arguments, in a folder with a road and the campaigns c and d."""
MISTAKES: Final[dict[str, tuple[str, ...]]] = {
    "init": ("no-module.py",),
    "run": ("--simulations", "0"),
    "calibrate": ("nowhere", "--driver", "planner", "--fit", "braking"),
    "compare": ("nowhere", "nowhere"),
    "bench": ("--simulations", "0"),
    "export": ("nowhere", "--format", "csv"),
    "doctor": ("--simulator", "nowhere"),
    "list": ("nowhere",),
}
"""Command -> arguments that are a mistake; of the others, the folder or file nowhere."""


def test_every_command_has_its_call_here() -> None:
    assert CALLS.keys() == {*cli.list_commands(click.Context(cli))} - {"ask-tell"}, (
        "which talks in JSON"
    )


@pytest.mark.parametrize("name", CALLS)
def test_every_command_prints_one_document(
    frenetic: Frenetic, campaign: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("road.json").write_text(json.dumps(ROAD))
    if name == "compare":
        frenetic("run", "--simulations", "3", "--seed", "2", *ONE, "--out", "d", "--json")
    answer = frenetic(name, *CALLS[name], "--json")
    assert answer.code in (0, 1, 3)
    document = answer.json  # raises if there is anything beside it
    assert isinstance(document, dict | list)
    assert document


TALKS: Final = """
print("imported")

class Talks:
    def __init__(self):
        print("made")

    def reset(self, setup):
        print("reset")

    def act(self, observation):
        print("asked")
        raise ValueError

def objective(road, drive):
    print("judged")
    return 0.0
"""


ONE_BY_ONE: Final = """
import json, sys
from frenetic.cli import main

for arguments in json.loads(sys.argv[1]):
    try:
        main(arguments)
    except SystemExit as stop:
        assert stop.code == 1, stop.code
    for stream in (sys.stdout, sys.stderr):
        print("-" * 20, file=stream, flush=True)
"""


def test_what_a_driver_prints_is_not_among_the_results(tmp_path: Path) -> None:
    (tmp_path / "talks.py").write_text(TALKS)
    (tmp_path / "road.json").write_text(json.dumps(ROAD))
    run = ("run", "--simulations", "2", "--seed", "1")
    calls = [
        (*run, "--workers", "1", "--out", "one"),
        (*run, "--workers", "2", "--out", "two"),
        ("drive", "road.json"),
    ]
    talking = [(*call, "--driver", "talks.py:Talks", "--json") for call in calls]
    done = subprocess.run(
        [sys.executable, "-c", ONE_BY_ONE, json.dumps(talking)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    for stream, is_right in ((done.stdout, is_a_document), (done.stderr, says_all)):
        *each, rest = stream.split(f"{'-' * 20}\n")
        assert [is_right(one) for one in each] == [True] * len(calls), stream
        assert rest == ""


def is_a_document(text: str) -> bool:
    return isinstance(json.loads(text), dict)


def says_all(text: str) -> bool:
    return all(words in text for words in ("imported", "made", "reset", "asked"))


def test_what_an_objective_prints_is_not_among_the_results(frenetic: Frenetic) -> None:
    Path("talks.py").write_text(TALKS)
    of = ("--objective", "talks.py:objective")
    done = frenetic(
        "run", "--simulations", "2", "--seed", "1", *ONE, *of, "--out", "three", "--json"
    )
    assert done.json["simulations"] == 2
    assert "judged" in done.err


@pytest.mark.parametrize("name", CALLS)
def test_a_mistake_is_one_line_on_stderr_with_json_too(frenetic: Frenetic, name: str) -> None:
    assert frenetic(name, *MISTAKES.get(name, ("nowhere",)), "--json").refuses()
