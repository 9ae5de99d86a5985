"""The command line as a user meets it: what it prints, where, and with which exit code."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click
import pytest
from checksums import execute
from pids import LIMIT, until

from frenetic.campaign import CampaignStore
from frenetic.cli import COMMANDS, cli

if TYPE_CHECKING:
    from command_line import Answer, Frenetic

pytest_plugins = ["command_line"]

STRAIGHT = {"curvatures": [0.0] * 12}
BENT = {"curvatures": [0.0, 0.02, 0.05, 0.06, 0.02, -0.03, -0.06, -0.06, -0.02, 0.0, 0.03]}
LOOP = {"curvatures": [0.07] * 14}


def write(name: str, content: object) -> str:
    Path(name).write_text(content if isinstance(content, str) else json.dumps(content))
    return name


def refused(answer: Answer, *words: str) -> None:
    """A mistake: exit code 2, one line on stderr that says what is wrong, no traceback."""
    assert answer.code == 2
    lines = [line for line in answer.err.splitlines() if line.startswith("frenetic: ")]
    assert len(lines) == 1
    assert "Traceback" not in answer.err
    for word in words:
        assert word in lines[0]


# run


@pytest.mark.usefixtures("drawn")
def test_run_prints_a_summary_and_leaves_roads_and_pictures(frenetic: Frenetic) -> None:
    answer = frenetic("run", "--simulations", "40", "--seed", "3", "--out", "mine")
    assert answer.code == 0
    assert "40 simulations" in answer.out
    assert "distinct failure" in answer.out
    assert "frenetic show mine " in answer.out
    assert Path("mine/campaign.sqlite").is_file()
    pictures = list(Path("mine/failures").glob("test-*.png"))
    assert Path("mine/failures/gallery.png").stat().st_size > 10_000
    roads = list(Path("mine/failures").glob("*.json"))
    assert 1 <= len(pictures) <= 10
    assert all(picture.stat().st_size > 10_000 for picture in pictures)
    assert len(roads) >= len(pictures)
    assert not list(Path("mine/failures").glob("*.part"))


def test_fail_on_failure_ends_with_1_only_where_a_test_failed(frenetic: Frenetic) -> None:
    run = ("run", "--seed", "3", "--workers", "1", "--json")
    until = ("--failures", "1", "--with", "delay=0.05", "--out", "c")
    failing = frenetic(*run, *until, "--fail-on-failure")
    assert failing.json["failed"] > 0
    assert failing.code == 1
    assert frenetic("resume", "c", "--simulations", "1", "--fail-on-failure").code == 1
    assert frenetic("resume", "c", "--simulations", "1").code == 0
    calm = ("--driver", "aggression=0.3", "--simulations", "3", "--out", "d")
    answer = frenetic(*run, *calm, "--fail-on-failure")
    assert (answer.code, answer.json["failed"]) == (0, 0)


def test_run_makes_a_folder_of_its_own_and_tells_its_seed(frenetic: Frenetic) -> None:
    write("run.toml", "simulations = 2\nlookahead = 4\n")
    run = ["run", "run.toml", "--json"]
    first = frenetic(*run).json
    second = frenetic(*run).json
    assert first["folder"] != second["folder"]
    assert Path(first["folder"]).parent == Path("campaigns")
    assert Path(second["folder"], "campaign.sqlite").is_file()
    repeated = frenetic(*run, "--seed", str(first["seed"])).json
    assert repeated["min_moobd"] == first["min_moobd"]


def test_failing_road_fails_again_on_its_own(frenetic: Frenetic, searched: Path) -> None:
    paths = sorted((searched / "failures").glob("*.json"))[:5]
    assert paths
    for path in paths:
        stored = json.loads(path.read_text())
        again = frenetic("drive", str(path), "--json").json
        assert again["outcome"] == "FAIL"
        assert again["moobd"] == stored["moobd"]
        assert again["findings"] == [stored["departure"]]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--simulations", "0"], ["simulations is 0", "at least 1"]),
        (["--simulations", "-5"], ["simulations is -5", "at least 1"]),
        (["--failures", "0"], ["failures is 0", "at least 1"]),
        (["--time", "0"], ["'--time'", "more than 0 s"]),
        (["--time", "soon"], ["'soon' is not a time", "1h30m"]),
        (["--simulations", "many"], ["'many' is not a valid integer"]),
        (["--driver", "plannr"], ["unknown driver 'plannr'", "did you mean 'planner'?"]),
        (["--driver", "zzz"], ["unknown driver 'zzz'", "planner, stanley"]),
        (["--driver", "no.py:Driver"], ["there is no file 'no.py'"]),
        (["--driver", "no_such_module:Driver"], ["no module 'no_such_module'"]),
        (["--driver", "json:JSONDecoder"], ["is no driver", "no method reset"]),
        (["--driver", "agression=1"], ["did you mean 'aggression'?"]),
        (["--driver", "aggression=-1"], ["aggression is -1"]),
        (["--driver", "planner,aggression"], ["'aggression' is not OPTION=VALUE"]),
        (["--with", "noise=-1"], ["noise is -1: 0 to 10 m is needed"]),
        (["--with", "noise=1e308"], ["noise is 1e+308: 0 to 10 m"]),
        (["--with", "delay=99"], ["delay is 99: 0 to 10 s"]),
        (["--with", "view=-3"], ["view is -3: 1 to 100000 m is needed"]),
        (["--with", "delay"], ["'delay' is not NAME=VALUE", "delay=0.1"]),
        (["--with", "dellay=1"], ["unknown quantity", "did you mean 'delay'?", "fog"]),
        (["--with", "friction=0.7"], ["set it by --simulator embedded,friction="]),
        (["--with", "speed=50"], ["set it by --speed-limit"]),
        (["--map-size", "1e308"], ["map_size is 1e+308: at most 1e+07 m"]),
        (["--workers", "nowhere"], ["neither a number nor the address of a Dask scheduler"]),
        (["--workers", "1" + "0" * 400], ["'--workers'", "is not in the range 1<=x<=1024"]),
        (
            ["--strategy", "genetic"],
            ["unknown strategy 'genetic'", "frenetic, frenetic-2021, random"],
        ),
        (["--strategy", "threshold=inf"], ["threshold"]),
        (["--strategy", "seed=5"], ["the option seed of the strategy is not allowed"]),
        (["--strategy", "map_size=100"], ["the option map_size of the strategy is not allowed"]),
        (["--simulator", "friction=-1"], ["friction is -1"]),
        (["--simulator", "fricton=1"], ["did you mean 'friction'?"]),
        (["--driver", "aggression=abc"], ["aggression is 'abc'", "a number is needed"]),
        (["--simulator", "carla"], ["unknown simulator 'carla'", "embedded"]),
        (["--map-size", "15"], ["map_size is 15", "more than twice the margin"]),
        (["--speed-limit", "0"], ["speed_limit is 0"]),
        (["--oob-tolerance", "1.5"], ["oob_tolerance is 1.5", "up to 1"]),
        (["--seed", "-1"], ["'--seed'"]),
        (["--no-such-option"], ["No such option"]),
    ],
)
def test_run_refuses_what_makes_no_sense_and_leaves_nothing(
    frenetic: Frenetic, options: list[str], words: list[str]
) -> None:
    refused(frenetic("run", "--out", "c", *options), *words)
    assert not Path("c").exists()


def test_an_infinite_view_is_no_layer(frenetic: Frenetic) -> None:
    view = ("--with", "view=inf", "--json")
    write("road.json", STRAIGHT)
    driven = frenetic("drive", "road.json", *view).json["driver"]
    assert driven["class"].endswith(":Planner")
    assert frenetic("run", "--simulations", "1", "--seed", "1", "--out", "c", *view).code == 0
    with CampaignStore.open(Path("c")) as store:
        assert store.config["driver"] == driven


def test_run_never_touches_an_existing_campaign(frenetic: Frenetic) -> None:
    frenetic("run", "--simulations", "5", "--seed", "1", "--out", "c")
    before = Path("c/campaign.sqlite").read_bytes()
    refused(frenetic("run", "--simulations", "5", "--out", "c"), "already holds a campaign")
    assert Path("c/campaign.sqlite").read_bytes() == before


def test_run_refuses_a_folder_that_cannot_be_written(frenetic: Frenetic) -> None:
    write("file", "not a folder")
    refused(frenetic("run", "--simulations", "5", "--out", "file"), "file", "--out")
    refused(frenetic("run", "--simulations", "5", "--out", "file/below"), "file/below")
    refused(frenetic("run", "--simulations", "5", "--out", ""), "an empty name")


def test_run_refuses_a_simulator_whose_package_is_missing_and_leaves_nothing(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = ("metadrive.", "frenetic.metadrive.world")  # by other tests
    for name in [name for name in sys.modules if name.startswith(loaded)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "metadrive", None)
    options = ("run", "--simulator", "metadrive", "--simulations", "1", "--out", "c")
    answer = frenetic(*options)
    refused(answer, 'needs the package metadrive: pip install ".[metadrive]"')
    assert "go on" not in answer.err
    assert not Path("c").exists()
    elsewhere = frenetic(*options, "--workers", "tcp://nowhere:1")
    refused(elsewhere, "nowhere")
    assert "metadrive" not in elsewhere.err, "it is needed where it drives"


MY_DRIVER = """
import os

import frenetic

class Slow:
    def reset(self, setup):
        self.limit = 8.0

    def act(self, observation):
        x, y = observation.ahead[4]
        speeding = observation.speed > self.limit
        return frenetic.Controls(
            steering=2.6 * 2.0 * y / (x * x + y * y),
            throttle=0.0 if speeding else 0.4,
        )

class Raises:
    def reset(self, setup):
        pass

    def act(self, observation):
        raise ValueError("lost")

class Nan(Raises):
    def act(self, observation):
        return frenetic.Controls(float("nan"))

class Tires(Raises):
    drives = 0

    def reset(self, setup):
        Tires.drives += 1
        self.speeding = setup.speed_limit

    def act(self, observation):
        if Tires.drives > 20:
            raise RuntimeError("too tired")
        return frenetic.Controls(0.0, throttle=1.0)

class Crashes(Slow):
    def act(self, observation):
        if observation.curvature_ahead[3] > 0.03:
            os.abort()
        return super().act(observation)

class ForEver(Raises):
    def act(self, observation):
        while True:
            pass
"""


def test_own_driver_from_a_file_and_from_a_module(frenetic: Frenetic) -> None:
    write("mydriver.py", MY_DRIVER)
    write("road.json", STRAIGHT)
    for spec in ("mydriver.py:Slow", "mydriver:Slow"):
        answer = frenetic("drive", "road.json", "--driver", spec, "--json")
        assert answer.json["outcome"] == "PASS", answer
    refused(frenetic("drive", "road.json", "--driver", "mydriver.py:Slwo"), "did you mean 'Slow'?")


@pytest.mark.parametrize(
    ("name", "wall_limit", "why"),
    [
        ("Raises", "60", "the driver raised ValueError: lost"),
        ("Nan", "60", "steering = nan, not a finite number"),
        ("ForEver", "0.2", "did not finish its drive within 0.2 s"),
    ],
)
def test_broken_driver_is_an_error_and_ends_a_campaign(
    frenetic: Frenetic, name: str, wall_limit: str, why: str
) -> None:
    write("mydriver.py", MY_DRIVER)
    write("road.json", STRAIGHT)
    how = f"driver = 'mydriver.py:{name}'\nwall_limit = {wall_limit}\n"
    driver = ("--as", write("how.toml", how), "--driver", f"mydriver.py:{name}")
    answer = frenetic("drive", "road.json", *driver, "--json")
    assert answer.json["outcome"] == "ERROR"
    assert why in answer.json["reason"]
    answer = frenetic("run", *driver, "--simulations", "50", "--out", "c")
    refused(answer, "the last 10 drives broke", why)
    assert frenetic("show", "c", "--json").json["errors"] == 10


def test_a_driver_that_crashes_takes_nothing_with_it(frenetic: Frenetic) -> None:
    """A single worker drives Python code in a process of its own, and so does every command."""
    write("mydriver.py", MY_DRIVER)
    write("bent.json", {"curvatures": [0.0, 0.0, 0.01, 0.06, 0.06, 0.03, 0.0]})
    driver = ("--driver", "mydriver.py:Crashes")
    lost = "the driver's process was lost: it was killed by SIGABRT"
    strategy = ("--strategy", "frenetic-2021", "--simulations", "8", "--seed", "3")
    search = ("run", *driver, *strategy, "--workers", "1", "--out", "c")
    summary = frenetic(*search, "--json").json
    assert summary["errors"] >= 1
    assert summary["passed"] + summary["failed"] >= 1
    assert summary["simulations"] == 8
    log = Path("c/campaign.log").read_text().splitlines()
    (first, *_) = (json.loads(line) for line in log if "was killed by SIGABRT" in line)
    assert first["event"] == "worker_lost"
    assert frenetic("check", "c").code == 0
    answer = frenetic("drive", "bent.json", *driver, "--json")
    assert (answer.code, answer.json["reason"]) == (1, lost)


@pytest.mark.parametrize("workers", ["1", "2"])
def test_a_drivers_error_comes_with_its_place_and_traceback(
    frenetic: Frenetic, workers: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The traceback is in the campaign's log, and with --debug on the terminal."""
    write("mydriver.py", MY_DRIVER)
    number = MY_DRIVER.splitlines().index('        raise ValueError("lost")') + 1
    reason = f'the driver raised ValueError: lost (mydriver.py:{number}: raise ValueError("lost"))'
    search = ("run", "--driver", "mydriver.py:Raises", "--simulations", "3", "--seed", "1")
    with caplog.at_level("DEBUG", "frenetic"):
        answer = frenetic(*search, "--workers", workers, "--out", "c")
    assert answer.code == 1
    assert "3 errors" in answer.out
    assert f"The first error: {reason}" in answer.out.splitlines()
    where = f'mydriver.py", line {number}, in act\n'
    assert sum(where in record.getMessage() for record in caplog.records) == 3
    assert f"ERROR  {reason}" in frenetic("show", "c", "1").out
    log = [json.loads(line) for line in Path("c/campaign.log").read_text().splitlines()]
    broken = [line for line in log if line["event"] == "test_error"]
    assert [line["reason"] for line in broken] == [reason] * 3
    assert all(where in str(line["traceback"]) for line in broken)


def test_what_was_found_before_the_driver_broke_is_shown(frenetic: Frenetic) -> None:
    write("mydriver.py", MY_DRIVER)
    answer = frenetic(
        *("run", "--driver", "mydriver.py:Tires", "--simulations", "50", "--seed", "1"),
        *("--out", "c", "--workers", "1"),
    )
    refused(answer, "the last 10 drives broke", "too tired")
    assert "distinct failure" in answer.out
    assert list(Path("c/failures").glob("test-*.png"))


def test_driver_file_may_import_its_neighbour_and_gives_the_same_campaign(
    frenetic: Frenetic,
) -> None:
    Path("sub").mkdir()
    write("sub/tables.py", "GAIN = 2.6")
    write("sub/mine.py", "from tables import GAIN\n" + MY_DRIVER.replace("2.6", "GAIN"))
    road = write("road.json", STRAIGHT)
    assert frenetic("drive", road, "--driver", "sub/mine.py:Slow").out.startswith("PASS")
    run = ["run", "--driver", "sub/mine.py:Slow", "--simulations", "3", "--seed", "1", "--out"]
    assert frenetic(*run, "a").code == 0
    subprocess.run([sys.executable, "-m", "frenetic", *run, "b"], check=True, capture_output=True)
    first, second = (frenetic("show", folder, "--json").json["config"] for folder in "ab")
    assert first == second
    assert first["driver"]["class"] == "mine.py:Slow"


COUNTING = """
import time
from pathlib import Path

from frenetic import EmbeddedSimulator


class Counting(EmbeddedSimulator):
    def drive(self, road, driver):
        time.sleep(0.05)  # so that there is little to report
        return super().drive(road, driver)

    def __exit__(self, *details):
        super().__exit__(*details)
        Path("left").touch()
"""


SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
RUNS = """
import signal, sys
from pathlib import Path
from frenetic.cli import main

for name in sys.argv[1:]:
    hears = name == "SIGINT"
    signal.signal(signal.SIGINT, signal.default_int_handler if hears else signal.SIG_IGN)
    how = ["--time", "10m", "--workers", "1", "--simulator", "counting.py:Counting"]
    try:
        main(["run", *how, "--out", name])
    except SystemExit as stop:
        Path(f"{name}.part").write_text(str(stop.code))
        Path(f"{name}.part").rename(f"{name}.code")
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as on POSIX here")
def test_a_signal_ends_a_run_with_its_summary_and_its_simulator(tmp_path: Path) -> None:
    """That of Ctrl-C, of a job scheduler and of a terminal that is closed.

    What a script starts in the background does not hear Ctrl-C, but has to hear the others.
    """
    (tmp_path / "counting.py").write_text(COUNTING)
    with subprocess.Popen(
        [sys.executable, "-c", RUNS, *SIGNALS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    ) as process:
        try:
            for name in SIGNALS:
                folder, code = tmp_path / name, tmp_path / f"{name}.code"
                until(partial(stored_in_a_moment, folder), "a test is stored")
                process.send_signal(signal.Signals[name])
                until(code.exists, f"{name} ends the run")
                assert code.read_text() == "130"
                assert stored_tests(folder) > 0
                (tmp_path / "left").unlink()
            out, err = process.communicate(timeout=LIMIT)
        finally:
            process.kill()
    assert process.returncode == 0
    assert out.count("Interrupted: ") == len(SIGNALS)
    assert "Traceback" not in err


def test_a_driver_that_cannot_drive_there_is_refused_before_anything_is_made(
    frenetic: Frenetic,
) -> None:
    answer = frenetic("run", "--driver", "metadrive-idm", "--simulations", "6", "--out", "c")
    refused(answer, "metadrive-idm drives in MetaDrive only: choose the simulator metadrive")
    parts = ["--simulator", "metadrive", "--driver", "metadrive-idm", "--with", "noise=0.1"]
    refused(frenetic("run", *parts, "--out", "c"), "leave them out")
    assert not Path("c").exists()
    road = write("road.json", STRAIGHT)
    refused(frenetic("drive", road, "--driver", "metadrive-idm"), "in MetaDrive only")
    parts = ["--strategy", "random", "--driver", "metadrive-idm", "--simulations", "6"]
    refused(frenetic("bench", *parts), "in MetaDrive only")


def stored_in_a_moment(folder: Path) -> int:
    """Its stored tests, after a moment: looking takes time from the run."""
    time.sleep(0.1)
    return stored_tests(folder)


def stored_tests(folder: Path) -> int:
    from frenetic.errors import CampaignError

    try:
        with CampaignStore.open(folder) as store:
            return store.counts().told
    except CampaignError:
        return 0


# resume


def test_campaign_goes_on_with_more_simulations(frenetic: Frenetic) -> None:
    options = ["--seed", "3", "--driver", "stanley", "--with", "noise=0.1"]
    search = ("run", "--simulations", "20", "--strategy", "random_roads=5")
    frenetic(*search, *options, "--out", "c")
    answer = frenetic("resume", "c", "--simulations", "10")
    assert answer.code == 0
    assert "30 simulations" in answer.out
    assert "Going on after " in answer.err
    document = frenetic("show", "c", "--json").json
    assert document["passed"] + document["failed"] == 30
    again = frenetic("resume", "c", "--simulations", "5", "--json").json
    assert (again["simulations"], again["seed"]) == (35, 3)


def test_resume_refuses_what_makes_no_sense(frenetic: Frenetic) -> None:
    refused(frenetic("resume", "nowhere"), "nowhere does not exist")
    frenetic("run", "--simulations", "5", "--seed", "1", "--out", "c")
    refused(frenetic("resume", "c"), "the budget of c is spent", "--simulations")
    refused(frenetic("resume", "c", "--simulations", "0"), "simulations is 0")
    before = frenetic("show", "c", "--json").json
    execute(Path("c"), "UPDATE test SET step = 9.0 WHERE id = 2")
    refused(frenetic("resume", "c", "--simulations", "5"), "another road as candidate 2")
    assert frenetic("show", "c", "--json").json["tests"] == before["tests"]


def test_resume_of_a_campaign_from_python_says_how(frenetic: Frenetic) -> None:
    from frenetic import Budget, Campaign, EmbeddedSimulator, Planner, RandomSearch

    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=3),
        folder="c",
    ).run()
    refused(frenetic("resume", "c", "--simulations", "5"), "Campaign.resume()")


# drive


def test_drive_says_what_happened(frenetic: Frenetic) -> None:
    write("road.json", BENT)
    answer = frenetic("drive", "road.json")
    assert answer.code == 0
    assert answer.out.startswith("PASS  Car reached the end of the road")
    assert "MOOBD" in answer.out
    answer = frenetic("drive", "road.json", "--driver", "aggression=3")
    assert answer.out.startswith("FAIL  Car drove out of the lane ")
    assert "left lane" in answer.out


@pytest.mark.usefixtures("drawn")
@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_drive_draws_a_picture(frenetic: Frenetic, suffix: str) -> None:
    write("road.json", BENT)
    answer = frenetic("drive", "road.json", "--plot", f"picture.{suffix}", "--json")
    assert answer.json["plot"] == f"picture.{suffix}"
    assert Path(f"picture.{suffix}").stat().st_size > 10_000


@pytest.mark.usefixtures("drawn")
def test_drive_refuses_a_picture_of_an_unknown_kind(frenetic: Frenetic) -> None:
    for plot, word in (("picture.doc", "png"), ("no/such/p.png", "there is no folder no/such")):
        answer = frenetic("drive", "nowhere.json", "--plot", plot)
        refused(answer, "--plot", word)
        assert "nowhere" not in answer.err, "the name is checked before anything else"


def test_invalid_road_is_not_driven_unless_asked_for(frenetic: Frenetic) -> None:
    write("loop.json", LOOP)
    answer = frenetic("drive", "loop.json", "--json").json
    assert (answer["outcome"], answer["reason"]) == ("INVALID", "The road is self-intersecting")
    answer = frenetic("drive", "loop.json", "--anyway", "--json").json
    assert answer["outcome"] in ("PASS", "FAIL")


def test_layers_change_the_drive(frenetic: Frenetic) -> None:
    write("road.json", BENT)
    plain = frenetic("drive", "road.json", "--json").json["moobd"]
    for layer in (["--with", "noise=0.3"], ["--with", "delay=0.2"], ["--with", "view=8"]):
        assert frenetic("drive", "road.json", "--json", *layer).json["moobd"] != plain


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ["there is no file road.json"]),
        ("nonsense", ["road.json is not JSON"]),
        ('{"curvatures": [0, NaN, 0]}', ["curvature 1 is nan"]),
        ('{"curvatures": [0, -Infinity, 0]}', ["curvature 1 is -inf"]),
        ({"curvatures": [0.1]}, ["1 curvature samples", "2 to 10000"]),
        ({"curvatures": [0.0] * 1_000_000}, ["1000000 curvature samples", "2 to 10000"]),
        ({"nothing": 1}, ["neither 'curvatures' nor 'road_points'"]),
    ],
)
def test_bad_road_files_get_one_line(frenetic: Frenetic, content: object, words: list[str]) -> None:
    if content is not None:
        write("road.json", content)
    for how in ((), ("--dry",)):
        refused(frenetic("drive", "road.json", *how), "road.json", *words)


# drive --dry


def test_a_dry_drive_says_whether_a_road_is_valid(frenetic: Frenetic) -> None:
    good, bad = write("good.json", STRAIGHT), write("bad.json", LOOP)
    answer = frenetic("drive", good, "--dry")
    assert (answer.code, answer.out) == (0, "good.json: valid\n")
    answer = frenetic("drive", bad, "--dry")
    assert answer.code == 1
    assert answer.out == "bad.json: INVALID  The road is self-intersecting\n"
    assert frenetic("drive", bad, "--dry", "--json").json == {
        "road": "bad.json",
        "valid": False,
        "message": "The road is self-intersecting",
    }
    refused(frenetic("drive", good, "--dry", "--plot", "p.png"), "--plot draws a drive")


def test_hostile_files_are_one_line_each(frenetic: Frenetic) -> None:
    pose = '{"curvatures": [0, 0.01, 0], "pose": [' + "1" * 400 + ", 0, 0]}"
    Path("pose.json").write_text(pose)
    lane = '<lane id="-1" type="driving"><width sOffset="0" a="4"/></lane>'
    Path("shift.xodr").write_text(
        '<OpenDRIVE><header revMajor="1"/><road length="30" junction="-1"><planView>'
        '<geometry s="0" x="0" y="0" hdg="0" length="30"><line/></geometry></planView><lanes>'
        f'<laneOffset s="0" a="-1e308"/><laneSection s="0"><right>{lane}</right></laneSection>'
        "</lanes></road></OpenDRIVE>"
    )
    wide = write("wide.json", STRAIGHT | {"lane_width": 1e308})
    for name in ("missing.json", "pose.json", "shift.xodr", wide):
        refused(frenetic("drive", name, "--dry"), name)
    refused(frenetic("drive", wide, "--dry"), "lane_width is 1e+308: 0.1 to 100 m are allowed")


# show


def test_show_a_campaign_and_a_test(frenetic: Frenetic) -> None:
    frenetic("run", "--simulations", "40", "--seed", "3", "--out", "c")
    whole = frenetic("show", "c")
    assert "frenetic(seed=3, " in whole.out
    assert "planner(aggression=1.0, " in whole.out
    assert "40 simulations" in whole.out
    assert "distinct failure" in whole.out
    counted = frenetic("show", "c", "--json").json
    assert counted["passed"] + counted["failed"] == 40
    alike = [test for one in counted["distinct_failures"] for test in one["tests"]]
    assert len(alike) == len(set(alike)) == counted["failed"]
    failing = json.loads(next(Path("c/failures").glob("*.json")).read_text())["id"]
    one = frenetic("show", "c", str(failing))
    assert "FAIL" in one.out
    assert "curvatures" in one.out
    assert Path(f"c/failures/test-{failing:05d}.png").is_file()
    document = frenetic("show", "c", str(failing), "--plot", "p.svg", "--json").json
    assert (document["id"], document["picture"]) == (failing, "p.svg")
    assert Path("p.svg").is_file()


def test_show_an_invalid_test(frenetic: Frenetic) -> None:
    frenetic(
        *("run", "--strategy", "random,max_redraws=0"),
        *("--simulations", "40", "--seed", "3", "--out", "c"),
    )
    from frenetic.outcome import Outcome

    with CampaignStore.open(Path("c")) as store:
        (record,) = store.tests(Outcome.INVALID, limit=1)
    answer = frenetic("show", "c", str(record.candidate.id), "--plot", "p.png")
    assert answer.code == 0
    assert "INVALID" in answer.out
    assert Path("p.png").is_file()


def test_show_refuses_what_is_not_there(frenetic: Frenetic) -> None:
    refused(frenetic("show", "nowhere"), "nowhere")
    frenetic("run", "--simulations", "5", "--seed", "1", "--out", "c")
    refused(frenetic("show", "c", "99999"), "99999")
    refused(frenetic("show", "c", "--plot", "p.png"), "--plot needs the ID")


# what there is


@pytest.mark.parametrize(
    ("command", "names"),
    [
        ("drivers", ["planner", "stanley", "beamng-ai"]),
        ("strategies", ["frenetic", "frenetic-2021", "random"]),
        ("simulators", ["embedded"]),
        ("objectives", ["moobd"]),
        ("quantities", ["friction", "speed", "noise", "delay"]),
    ],
)
def test_listings(frenetic: Frenetic, command: str, names: list[str]) -> None:
    answer = frenetic("list", command)
    assert answer.code == 0
    assert all(name in answer.out for name in names)
    listed = frenetic("list", command, "--json").json
    assert frenetic("list", "--json").json[command] == listed
    assert all(name in frenetic("list").out for name in names)
    assert [entry["name"] for entry in listed][: len(names)] == names


def test_a_part_that_is_installed_while_we_run_is_listed(
    frenetic: Frenetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def install(distribution: str, name: str) -> None:
        information = tmp_path / f"{distribution}-1.0.dist-info"
        information.mkdir()
        (information / "METADATA").write_text(f"Name: {distribution}\nVersion: 1.0\n")
        (information / "entry_points.txt").write_text(f"[frenetic.drivers]\n{name} = {name}:It\n")

    monkeypatch.syspath_prepend(str(tmp_path))
    before = frenetic("list", "drivers", "--json").json
    install("my-drivers", "mpc")
    added = [entry for entry in frenetic("list", "drivers", "--json").json if entry not in before]
    assert [entry["name"] for entry in added] == ["mpc"]
    install("others-drivers", "planner")
    refused(frenetic("list", "drivers"), "two driver entries are named 'planner'", "others-drivers")


def test_commands_are_listed_and_an_unknown_one_is_a_mistake(frenetic: Frenetic) -> None:
    for arguments in ((), ("--help",)):
        answer = frenetic(*arguments)
        assert answer.code == 0
        assert all(f"  {name} " in answer.out for name in COMMANDS)
    refused(frenetic("fly"), "No such command 'fly'")


def test_help_of_every_command_needs_nothing_that_takes_time() -> None:
    code = (
        "import sys\n"
        "from frenetic.cli import cli\n"
        f"for command in {[*COMMANDS]}:\n"
        "    cli.main([command, '--help'], standalone_mode=False)\n"
        "    slow = {'numba', 'matplotlib', 'numpy', 'scipy'} & set(sys.modules)\n"
        "    assert not slow, (command, slow)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.count("Usage: ") == len(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_fits_on_a_screen(
    frenetic: Frenetic, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = frenetic(command, "--help").out.splitlines()
    assert len(lines) <= 50
    assert max(map(len, lines)) <= 80


def test_a_command_is_called_like_its_module() -> None:
    with click.Context(cli, info_name="frenetic") as context:
        for name, row in COMMANDS.items():
            command = cli.get_command(context, name)
            assert command is not None
            assert command.name == name
            assert row.target.partition(":")[0] == name.replace("-", "_")


def test_linear_algebra_takes_one_thread_unless_the_user_wants_more(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "road.json").write_text('{"curvatures": [0.0, 0.02, 0.0]}')
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    code = (
        "from frenetic.cli import main\n"
        "try: main(['drive', 'road.json', '--dry'])\n"
        "except SystemExit: pass\n"
        "from threadpoolctl import threadpool_info\n"
        "pools = [pool for pool in threadpool_info() if pool['user_api'] == 'blas']\n"
        "assert {pool['num_threads'] for pool in pools} <= {1}, pools\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    assert frenetic("--version").code == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
