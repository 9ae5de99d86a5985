"""Drivers and simulators that misbehave where they are imported, made and thrown away."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest

from frenetic import recipe
from frenetic.campaign import CampaignStore

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

LIMIT: Final = 2.0  # s, for parts that hang
PART: Final = """
import os
import sys
import threading
from frenetic import EmbeddedSimulator, Planner

class Driver(Planner):
    pass

class Simulator(EmbeddedSimulator):
    pass

class Hostile({kind}):
    def __init__(self):
        super().__init__()
        {making}

    def __del__(self):
        {leaving}

{importing}
"""
DEEDS: Final = {
    "leaves its folder": "os.chdir({elsewhere!r})",
    "exits": "sys.exit(7)",
    "dies": "os._exit(7)",
    "hangs": "while True: pass",
    "closes all": "os.closerange(0, 21)",
    "leaves a thread": "threading.Thread(target=threading.Event().wait).start()",
}
"""Deed -> its code."""
WORDS: Final = {
    "exits": "SystemExit: 7 (",
    "dies": "it broke its process: it ended with exit code 7",
    "hangs": f"it took more than {LIMIT:g} s",
    "closes all": "it broke its process: the descriptors of its process were closed",
}
"""Deed -> words of the error where nothing is made."""
MOMENTS: Final = ("importing", "making", "leaving")
RUN: Final = ("run", "--simulations", "3", "--seed", "1", "--out", "results")
COMMANDS: Final = {
    "run": (*RUN, "--workers", "1", "--json"),
    "run on two": (*RUN, "--workers", "2", "--json"),
    "drive": ("drive", "road.json", "--json"),
}
CASES: Final = [
    *(("Driver", deed, moment, "drive") for deed in WORDS for moment in ("importing", "making")),
    *(("Driver", deed, "leaving", "drive") for deed in DEEDS),
    *(("Driver", deed, "leaving", "run") for deed in ("dies", "hangs", "closes all")),
    ("Driver", "leaves its folder", "importing", "run on two"),
    ("Driver", "leaves its folder", "making", "drive"),
    ("Driver", "leaves a thread", "importing", "drive"),
    ("Driver", "leaves a thread", "making", "run"),
    ("Simulator", "leaves its folder", "importing", "run on two"),
    ("Simulator", "dies", "making", "run on two"),
    ("Simulator", "dies", "leaving", "run on two"),
]
"""Kind of part, deed, moment and command."""


@pytest.fixture(scope="session")
def usual(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> list[object]:
    """The results of a driver that does nothing of all that."""
    folder = tmp_path_factory.mktemp("usual")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write("Driver")
        prepare(*RUN, "--workers", "1", "--driver", "hostile.py:Hostile")
        return results()


def write(kind: str, **code: str) -> None:
    text = PART.format(kind=kind, **dict.fromkeys(MOMENTS, "pass") | code)
    Path("hostile.py").write_text(text, encoding="utf-8")


def results() -> list[object]:
    with CampaignStore.open("results") as store:
        return [(test.outcome, test.moobd) for test in store.tests()]


@pytest.mark.parametrize(("kind", "deed", "moment", "command"), CASES)
def test_no_part_harms_the_command(
    frenetic: Frenetic,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    usual: list[object],
    kind: str,
    deed: str,
    moment: str,
    command: str,
) -> None:
    """Neither its process nor its folder, nor what comes out."""
    monkeypatch.setattr(recipe, "LIMIT", LIMIT)
    (elsewhere := tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    write(kind, **{moment: DEEDS[deed].format(elsewhere=str(elsewhere))})
    Path("road.json").write_text(json.dumps({"curvatures": [0.0, 0.02, 0.03, 0.0, 0.0]}))
    answer = frenetic(*COMMANDS[command], f"--{kind.lower()}", "hostile.py:Hostile")
    assert Path.cwd() == tmp_path
    assert not list(elsewhere.iterdir())
    if moment != "leaving" and deed in WORDS:
        step = "" if deed == "exits" else f": {moment} "
        assert answer.refuses("'hostile.py:Hostile'", f"{step}{WORDS[deed]}")
        assert not Path("results").exists()
    elif command == "drive":
        assert answer.json["outcome"] == "PASS"
    else:
        assert answer.code == 0, answer.err
        assert results() == usual
