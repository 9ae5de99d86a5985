"""BeamNG.tech on the command line: a campaign, its resumption elsewhere, reruns, interrupts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from beamng_stand_in import DROP, StandIn, program

from frenetic.campaign import CampaignStore

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]
pytestmark = [pytest.mark.heavy, pytest.mark.usefixtures("new_process_server")]
linux = pytest.mark.skipif(sys.platform != "linux", reason="the program is a shell script")


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def beamng(server: StandIn, *options: str) -> tuple[str, str]:
    return "--simulator", ",".join(["beamng", f"port={server.port}", *options])


def test_a_campaign_is_resumed_at_another_port(frenetic: Frenetic, stand_in: StandIn) -> None:
    search = ("run", "--simulations", "2", "--seed", "1", "--driver", "beamng-ai", "--out", "c")
    answer = frenetic(*search, *beamng(stand_in, "aggression=0.9"), "--json")
    assert answer.json["simulations"] == 2, answer.err
    stand_in.close()
    more = ("resume", "c", "--simulations", "1", "--json")
    assert frenetic(*more).refuses("nothing answers")
    answer = frenetic(*more, "--simulator", "aggression=1.0")
    assert answer.code == 2
    assert "can only say where beamng is (home, user, " in answer.err
    with StandIn() as other:
        answer = frenetic(*more, "--simulator", f"port={other.port}")
    assert answer.json["simulations"] == 3, answer.err
    with CampaignStore.open(Path("c")) as store:
        config: Any = store.config
    assert config["workers"] == 1, "a BeamNG.tech drives one car"
    assert config["simulator"]["options"]["wall_limit"] == 600.0
    assert config["spec"]["simulator"] == f"beamng,port={stand_in.port},aggression=0.9"
    assert frenetic("check", "c").code == 0, "the verdicts follow from the stored drives"


def test_an_unusable_simulator_is_refused_in_one_line_and_leaves_no_files(
    frenetic: Frenetic, stand_in: StandIn
) -> None:
    noisy = ("--driver", "beamng-ai", "--with", "noise=0.1")
    for options, text in (
        (("--simulator", "beamng,port=25252,ground=nan"), "simulator 'beamng': ground is nan"),
        (("--simulator", "beamng"), "give its folder as home, set BNG_HOME, or give the port"),
        ((*beamng(stand_in), *noisy), "BeamNG.AI takes no noise, delay, view, or errors"),
    ):
        assert frenetic("run", *options, "--out", "c").refuses(text)
    stand_in.close()
    text = f"the simulator does not start: nothing answers at 127.0.0.1:{stand_in.port}"
    assert frenetic("run", *beamng(stand_in), "--out", "c").refuses(text)
    assert not Path("c").exists()


def test_tests_remain_after_the_connection_is_lost_for_good(frenetic: Frenetic) -> None:
    with StandIn(fault=lambda kind, n: DROP if kind == "Step" and n > 500 else None) as server:
        search = ("run", *beamng(server), "--driver", "beamng-ai", "--seed", "1", "--out", "c")
        answer = frenetic(*search)
    assert answer.code == 2
    assert answer.err.count("frenetic: ") == 1
    with CampaignStore.open(Path("c")) as store:
        assert store.counts().simulations > 0


def processes_of(program: Path) -> list[str]:
    """Return the command lines of stand-ins that serve in place of a program (Linux)."""
    name = str(Path(__file__).parent / "beamng_stand_in.py")
    commands = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            command = place.read_bytes().decode(errors="replace").split("\0")
            if name in command and str(program) in command:
                commands.append(" ".join(command))
    return commands


@linux
def test_ctrl_c_finishes_the_drives_and_leaves_no_process(tmp_path: Path) -> None:
    home = tmp_path / "home"
    program(home)
    place = f"beamng,home={home},user={tmp_path}"
    search = ["run", "--simulator", place, "--workers", "2"]
    running = subprocess.Popen(
        [sys.executable, "-m", "frenetic", *search, "--simulations", "100000", "--out", "c"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,  # as in a terminal: Ctrl-C goes to all of them
    )
    try:
        log = tmp_path / "c" / "campaign.log"
        while running.poll() is None and not (log.exists() and "test_" in log.read_text()):
            time.sleep(0.1)
        assert len(processes_of(tmp_path)) == 2
        os.killpg(running.pid, signal.SIGINT)
        out, err = running.communicate(timeout=120.0)
    finally:
        running.kill()
    assert running.returncode == 130, err
    assert "Interrupted: " in out
    assert " error" not in out, "running drives finish: the interrupt does not reach BeamNG.tech"
    assert not processes_of(tmp_path)
