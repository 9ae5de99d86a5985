"""Users' own drivers drive in another process, and a hostile driver harms one drive only."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest
from pids import is_running

from frenetic.campaign import CampaignStore
from frenetic.oracle.outcome import Outcome

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

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
    if Path("child").exists():
        return
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
"""A driver that records its roads, and a driver that does its deed on the third of them."""
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


RUN: Final = ("run", "--simulations", "6", "--seed", "1", "--strategy", "random", "--workers")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A folder with a campaign of the driver that tells its roads apart, and with its roads."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "hostile.py").write_text(DRIVER.replace("{deed}", "None"), encoding="utf-8")
    with chdir(folder):
        prepare(*RUN, "1", "--driver", "hostile.py:Recording", "--out", "c")
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="by Linux's means")
@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.heavy)])
@pytest.mark.parametrize("deed", FAULTS)
def test_a_drive_that_a_driver_breaks_fails_and_other_drives_are_as_usual(
    frenetic: Frenetic,
    recorded: Path,
    deed: str,
    workers: str,
) -> None:
    shutil.copy(recorded / "roads", "roads")
    Path("hostile.py").write_text(DRIVER.replace("{deed}", deed), encoding="utf-8")
    answer = frenetic(*RUN, workers, "--driver", "hostile.py:Hostile", "--out", "c")
    assert answer.code == 0, answer.err
    with CampaignStore.open(recorded / "c") as store:
        usual = {test.id: (test.outcome, test.moobd) for test in store.tests()}
    with CampaignStore.open("c") as store:
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


WHERE: Final = """
import os

from frenetic import Planner
from frenetic.drivers import Delayed

class Own(Planner):
    def reset(self, setup):
        with open("drives", "a") as file:
            print(os.getpid(), id(self), file=file)
        super().reset(setup)

    def act(self, observation):
        return super().act(observation)

class Wrapped(Delayed):
    def __init__(self):
        super().__init__(Own(), seconds=0.05)
"""
"""A driver that notes where it drives, and a wrapper of the same file over it."""


@pytest.mark.parametrize("name", ["Own", "Wrapped"])
def test_one_object_drives_all_roads_in_another_process(frenetic: Frenetic, name: str) -> None:
    Path("where.py").write_text(WHERE, encoding="utf-8")
    run = ("run", "--simulations", "4", "--seed", "1", "--strategy", "random", "--workers", "1")
    answer = frenetic(*run, "--driver", f"where.py:{name}", "--with", "noise=0.1", "--out", "c")
    assert answer.code == 0, answer.err
    drives = [line.split() for line in Path("drives").read_text().splitlines()]
    assert len(drives) >= 4
    objects = dict(drives)
    assert str(os.getpid()) not in objects
    assert [[process, objects[process]] for process, _ in drives] == drives
