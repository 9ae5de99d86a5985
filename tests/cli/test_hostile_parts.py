"""Drivers and simulators that misbehave where they are imported, made, driven, thrown away."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest
from pids import is_running

from frenetic import recipe
from frenetic.campaign import CampaignStore
from frenetic.outcome import Outcome

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
    "dies": "it ended its process: it ended with exit code 7",
    "hangs": f"it took more than {LIMIT:g} s",
    "closes all": "it ended its process: the descriptors of its process were closed",
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


# Drives

DRIVER: Final = """
import os
import struct
import subprocess
import sys
from pathlib import Path
from frenetic import Controls, Planner

def write():
    for descriptor in range(3, 256):
        try:
            os.set_blocking(descriptor, False)
            os.write(descriptor, b"\\xff" * 4 + struct.pack("!Q", 2**62))
        except OSError:
            pass

def start():
    code = "import time; time.sleep(600)"
    child = subprocess.Popen([sys.executable, "-c", code], start_new_session=True)
    Path("child").write_text(str(child.pid))

def raise_(error):
    raise error

def road_of(observation):
    return str(hash(tuple(observation.curvature_ahead)))

class Recording(Planner):
    def act(self, observation):
        if observation.time == 0.0:
            with Path("roads").open("a") as file:
                print(road_of(observation), file=file)
        return super().act(observation)

class Hostile(Planner):
    def act(self, observation):
        if observation.time == 0.0:
            third = list(dict.fromkeys(Path("roads").read_text().split()))[2]
            self.is_third = road_of(observation) == third
        if self.is_third:
            answer = {deed}
            if isinstance(answer, Controls):
                return answer
        return super().act(observation)
"""
"""A driver that tells its roads apart, and one that does its deed on the third of them."""
FAULTS: Final = {
    "write()": "breaks into its process's descriptors",
    "os.closerange(3, 256)": "breaks into its process's descriptors",
    "raise_(GeneratorExit())": "raises GeneratorExit at hostile.py:",
    "raise_(BaseException('x' * 10**7))": "raises BaseException at hostile.py:",
    "Controls(1e300, 0.0, 0.0)": "gives no usable controls",
    "os._exit(0)": "ends its process",
    "start()": "",
}
"""Deed -> the fault of the third test."""


@pytest.mark.skipif(sys.platform != "linux", reason="by Linux's means")
@pytest.mark.parametrize("workers", ["1", "2"])
@pytest.mark.parametrize("deed", FAULTS)
def test_a_drive_that_a_driver_breaks_fails_and_the_others_are_as_usual(
    frenetic: Frenetic,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    deed: str,
    workers: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hostile.py").write_text(DRIVER.replace("{deed}", deed), encoding="utf-8")
    run = ("run", "--simulations", "6", "--seed", "1", "--strategy", "random", "--workers")
    for name, count in (("Recording", "1"), ("Hostile", workers)):
        answer = frenetic(*run, count, "--driver", f"hostile.py:{name}", "--out", name)
        assert answer.code == 0, answer.err
    with CampaignStore.open("Recording") as store:
        usual = {test.id: (test.outcome, test.moobd) for test in store.tests()}
    with CampaignStore.open("Hostile") as store:
        tests = {test.id: test for test in store.tests()}
    third = tests.pop(3)
    if FAULTS[deed]:
        assert third.outcome is Outcome.FAIL
        assert str(third.result.fault).startswith(FAULTS[deed])
    else:
        assert third.result.fault is None
        assert not is_running(int(Path("child").read_text()))
    assert {i: (test.outcome, test.moobd) for i, test in tests.items()} == {
        i: result for i, result in usual.items() if i != 3
    }
