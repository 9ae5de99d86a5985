"""BeamNG.tech on the command line: its options, a campaign, reruns and doctor."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from beamng_stand_in import DROP, StandIn, program

from frenetic.again.rerun import read_reruns
from frenetic.campaign import CampaignStore
from frenetic.cli import main
from frenetic.outcome import Outcome

pytestmark = pytest.mark.usefixtures("new_process_server")

Frenetic = Callable[..., tuple[int, str, str]]

ROAD = {"curvatures": [0.0, 0.0, 0.01, 0.02, 0.01, 0.0, 0.0]}


@pytest.fixture
def frenetic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Frenetic:
    """Runs a command line in a folder with a road; gives exit code, stdout and stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("BNG_HOME", raising=False)
    Path("road.json").write_text(json.dumps(ROAD))

    def call(*arguments: str) -> tuple[int, str, str]:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(list(arguments))
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return stop.value.code, captured.out, captured.err

    return call


@pytest.fixture
def stand_in() -> Iterator[StandIn]:
    with StandIn() as server:
        yield server


def beamng(server: StandIn, *options: str) -> tuple[str, str]:
    place = ("beamng", "host=127.0.0.1", f"port={server.port}")
    return "--simulator", ",".join([*place, *options])


def configuration(folder: str) -> Any:
    with CampaignStore.open(Path(folder)) as store:
        return store.config


def test_campaign_and_its_resumption(frenetic: Frenetic, stand_in: StandIn) -> None:
    search = ("run", "--simulations", "4", "--seed", "1", "--driver", "beamng-ai", "--out", "c")
    options = ("aggression=0.9", "steps_per_second=20")
    code, out, err = frenetic(*search, *beamng(stand_in, *options), "--json")
    assert code == 0, err
    assert json.loads(out)["simulations"] == 4
    config = configuration("c")
    assert config["command"]["simulator_options"] == {
        "host": "127.0.0.1",
        "port": stand_in.port,
        "aggression": 0.9,
        "steps_per_second": 20,
    }
    assert config["command"]["wall_limit"] == 600.0
    assert config["workers"] == 1, "a BeamNG.tech serves one"
    code, out, err = frenetic("resume", "c", "--simulations", "2", "--json")
    assert code == 0, err
    assert json.loads(out)["simulations"] == 6
    assert frenetic("check", "c")[0] == 0, "the stored verdicts are those of the stored drives"


def test_resumption_at_another_place(frenetic: Frenetic, stand_in: StandIn, tmp_path: Path) -> None:
    search = ("run", "--simulations", "2", "--seed", "1", "--out", "c", "--json")
    assert frenetic(*search, *beamng(stand_in, "aggression=0.9"))[0] == 0
    stand_in.close()
    more = ("resume", "c", "--simulations", "1", "--json")
    code, _, err = frenetic(*more)
    assert code == 2
    assert "nothing answers" in err
    code, _, err = frenetic(*more, "--simulator", "aggression=1.0")
    assert code == 2
    assert "can only say where beamng is (home, user, " in err
    with StandIn() as other:
        code, out, err = frenetic(*more, "--simulator", f"port={other.port}")
    assert code == 0, err
    assert json.loads(out)["simulations"] == 3
    if sys.platform == "linux":
        program(tmp_path / "home")
        code, out, err = frenetic(*more, "--simulator", "home=home,headless=true")
        assert code == 0, err
        assert json.loads(out)["simulations"] == 4
    assert configuration("c")["command"]["simulator_options"]["port"] == stand_in.port


@pytest.mark.skipif(sys.platform != "linux", reason="the program is a shell script")
def test_what_was_started_is_gone_on_with_where_one_runs(
    frenetic: Frenetic, stand_in: StandIn, tmp_path: Path
) -> None:
    program(tmp_path / "home")
    search = ("run", "--simulations", "1", "--seed", "1", "--out", "c")
    options = "beamng,home=home,headless=true,restart_every=9"
    code, _, err = frenetic(*search, "--simulator", options)
    assert code == 0, err
    place = f"host=127.0.0.1,port={stand_in.port}"
    code, _, err = frenetic("resume", "c", "--simulations", "1", "--simulator", place)
    assert code == 0, err
    assert "Step" in stand_in.types()


def test_place_is_for_no_campaign_of_another_simulator(frenetic: Frenetic) -> None:
    assert frenetic("run", "--simulations", "1", "--seed", "1", "--out", "c")[0] == 0
    more = ("resume", "c", "--simulations", "1", "--simulator")
    for given, text in (
        ("port=25252", "--simulator is for one that moves, unlike embedded: all else would be"),
        ("friction=0.9", "--simulator is for one that moves, unlike embedded"),
        ("beamng,port=25252", "--simulator is for one that moves, unlike embedded"),
    ):
        code, _, err = frenetic(*more, given)
        assert code == 2
        assert text in err
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("ground=nan", "ground is nan: a number of m is needed"),
        ("reply_limit=abc", "reply_limit is 'abc': a positive number of seconds is needed"),
        ("host=5", "host is 5: a name is needed"),
    ],
)
def test_wrong_value_is_one_line(frenetic: Frenetic, setting: str, text: str) -> None:
    code, _, err = frenetic("drive", "road.json", "--simulator", f"beamng,{setting}")
    assert code == 2
    assert err.strip().splitlines() == [f"frenetic: simulator 'beamng': {text}"]


def test_seed_gives_the_same_campaign(frenetic: Frenetic, stand_in: StandIn) -> None:
    tests = []
    for folder in ("a", "b"):
        search = ("run", "--simulations", "4", "--seed", "2", "--out", folder)
        assert frenetic(*search, *beamng(stand_in))[0] == 0
        with CampaignStore.open(Path(folder)) as store:
            tests.append([(t.candidate.id, t.outcome, t.moobd) for t in store.tests()])
    assert tests[0] == tests[1]


def test_its_options_are_for_no_other_simulator(frenetic: Frenetic) -> None:
    code, _, err = frenetic("run", "--simulator", "headless=true")
    assert code == 2
    assert "simulator 'embedded' has no option 'headless'" in err


def test_nobody_says_where_it_is(frenetic: Frenetic) -> None:
    code, _, err = frenetic("drive", "road.json", "--simulator", "beamng")
    assert code == 2
    assert "give its folder as home, set BNG_HOME, or give the port" in err


def test_it_does_not_start(frenetic: Frenetic, stand_in: StandIn) -> None:
    stand_in.close()
    code, _, err = frenetic("run", *beamng(stand_in), "--out", "c")
    assert code == 2
    assert f"the simulator does not start: nothing answers at 127.0.0.1:{stand_in.port}" in err
    assert not Path("c").exists(), "nothing is left behind"


def test_driver_that_does_not_suit_is_refused_before_anything_is_driven(
    frenetic: Frenetic, stand_in: StandIn
) -> None:
    search = (
        "run",
        *beamng(stand_in),
        "--driver",
        "beamng-ai",
        "--with",
        "noise=0.1",
        "--out",
        "c",
    )
    code, _, err = frenetic(*search)
    assert code == 2
    assert "BeamNG.AI takes no noise, delay or view" in err
    assert not Path("c").exists()


def test_drive_draws_what_happened(frenetic: Frenetic, stand_in: StandIn) -> None:
    arguments = ("--plot", "drive.png", "--driver", "stanley", "--json")
    code, out, _ = frenetic("drive", "road.json", *beamng(stand_in), *arguments)
    assert code == 0
    assert json.loads(out)["outcome"] == "PASS"
    assert Path("drive.png").read_bytes()[:4] == b"\x89PNG"


def test_failures_of_the_embedded_simulator_fail_again(
    frenetic: Frenetic, stand_in: StandIn
) -> None:
    search = ("run", "--simulations", "60", "--seed", "3", "--workers", "1", "--with", "delay=0.05")
    assert frenetic(*search, "--out", "c")[0] == 0
    code, out, err = frenetic("rerun", "c", *beamng(stand_in), "--top", "3", "--json")
    assert code == 0, err
    document = json.loads(out)
    assert len(document["tests"]) == 3
    assert document["simulator"]["class"].endswith(":BeamngSimulator")
    (kept,) = read_reruns(Path("c"))
    assert kept.car.length == 4.508
    # The stand-in moves the car by the same physics, so the drives are much the same.
    assert document["matches"]["same failure"] == document["changes"]["fails again"] == 3
    assert all(one.test.trajectory is not None for one in kept.drives)


def test_driving_again_in_beamng(frenetic: Frenetic, stand_in: StandIn) -> None:
    search = ("run", "--failures", "2", "--seed", "3", "--driver", "beamng-ai", "--out", "c")
    assert frenetic(*search, *beamng(stand_in, "aggression=0.9"))[0] == 0
    with CampaignStore.open(Path("c")) as store:
        failures = store.counts().by_outcome[Outcome.FAIL]
    code, out, _ = frenetic("rerun", "c", "--json")
    document = json.loads(out)
    assert code == 0
    assert document["same"] == failures == 2
    with StandIn() as other:
        code, out, _ = frenetic("rerun", "c", "--simulator", f"port={other.port}", "--json")
        assert json.loads(out)["same"] == 2


def test_doctor_in_full_and_as_json(frenetic: Frenetic, stand_in: StandIn) -> None:
    code, out, _ = frenetic("doctor", *beamng(stand_in))
    assert code == 0
    assert "ok    licence: it found its licence" in out
    assert out.endswith("beamng: all is well\n")
    code, out, _ = frenetic("doctor", *beamng(stand_in, "vehicle=tank"), "--json")
    assert code == 1
    (examination,) = json.loads(out)
    assert examination["health"] == "something is wrong"
    assert examination["checks"][-1] == {
        "name": "vehicle",
        "is_ok": False,
        "found": "there is no vehicle tank",
        "remedy": "choose one of etk800, pickup",
    }


def test_connection_lost_for_good_leaves_what_was_driven(frenetic: Frenetic) -> None:
    with StandIn(trouble=lambda kind, n: DROP if kind == "Step" and n > 500 else None) as server:
        search = ("run", *beamng(server), "--driver", "beamng-ai", "--seed", "1", "--out", "c")
        code, _, err = frenetic(*search)
    assert code == 2
    assert len([line for line in err.splitlines() if line.startswith("frenetic: ")]) == 1
    with CampaignStore.open(Path("c")) as store:
        assert store.counts().simulations > 0


def processes_of(program: Path) -> list[str]:
    """The command lines of processes that serve in place of a program (Linux)."""
    name = str(Path(__file__).parent / "beamng_stand_in.py")
    found = []
    for place in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            command = place.read_bytes().decode(errors="replace").split("\0")
            if name in command and str(program) in command:
                found.append(" ".join(command))
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="the program is a shell script")
@pytest.mark.parametrize("workers", ["1", "2"])
def test_interrupt_finishes_the_drive_and_leaves_no_process(tmp_path: Path, workers: str) -> None:
    home = tmp_path / "home"
    program(home)
    place = f"beamng,home={home},user={tmp_path}"
    search = ["run", "--simulator", place, "--workers", workers]
    options = ["--simulations", "100000", "--out", "c"]
    running = subprocess.Popen(
        [sys.executable, "-m", "frenetic", *search, *options],
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
        assert processes_of(tmp_path)
        os.killpg(running.pid, signal.SIGINT)
        out, err = running.communicate(timeout=120.0)
    finally:
        running.kill()
    assert running.returncode == 130, err
    assert "Interrupted: " in out
    assert " 0 errors" in out, "what ran was finished: BeamNG.tech did not hear the interrupt"
    assert not processes_of(tmp_path)


@pytest.mark.skipif(sys.platform != "linux", reason="the program is a shell script")
def test_several_workers_start_one_each(
    frenetic: Frenetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program(tmp_path / "home")
    monkeypatch.setitem(os.environ, "BNG_HOME", str(tmp_path / "home"))
    place = ("--simulator", "beamng,headless=true")
    search = ("run", *place, "--workers", "2", "--simulations", "4")
    code, out, err = frenetic(*search, "--seed", "1", "--out", "c", "--json")
    assert code == 0, err
    assert json.loads(out)["simulations"] == 4
