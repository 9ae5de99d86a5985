"""`frenetic run` and `resume`: output, files, drivers that break, Ctrl-C and advice."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from pids import LIMIT, until

from frenetic.campaign import CampaignStore
from frenetic.errors import CampaignError
from frenetic.spec import Budget

if TYPE_CHECKING:
    from command_line import Answer, Frenetic

pytest_plugins = ["command_line"]


def write(name: str, content: object) -> str:
    Path(name).write_text(content if isinstance(content, str) else json.dumps(content))
    return name


def require_refusal(answer: Answer, *words: str) -> None:
    """Require exit code 2 and one line from frenetic on stderr that holds the words."""
    lines = [line for line in answer.err.splitlines() if line.startswith("frenetic: ")]
    assert (answer.code, len(lines)) == (2, 1)
    assert "Traceback" not in answer.err
    assert all(word in lines[0] for word in words)


def test_run_prints_a_summary_and_leaves_roads_and_pictures(frenetic: Frenetic) -> None:
    answer = frenetic("run", "--simulations", "60", "--seed", "3", "--out", "mine")
    assert answer.code == 0
    for words in ("60 simulations", "of them distinct", "frenetic show mine ", "cut to "):
        assert words in answer.out
    (road,) = re.findall(r"frenetic drive (\S+)", answer.out)
    assert frenetic("drive", road).out.startswith("FAIL")
    assert Path("mine/campaign.sqlite").is_file()
    assert Path("mine/failures/gallery.png").is_file()
    assert len(list(Path("mine/failures").glob("test-*.json"))) >= 1
    assert not list(Path("mine/failures").glob("*.part"))


def test_fail_on_failure_exits_1_only_if_a_test_failed(frenetic: Frenetic) -> None:
    run = ("run", "--seed", "3", "--workers", "1", "--json")
    budget = ("--failures", "1", "--with", "delay=0.05", "--out", "c")
    failing = frenetic(*run, *budget, "--fail-on-failure")
    assert failing.json["failed"] > 0
    assert failing.code == 1
    assert frenetic("resume", "c", "--simulations", "1", "--fail-on-failure").code == 1
    assert frenetic("resume", "c", "--simulations", "1").code == 0
    calm = ("--driver", "aggression=0.3", "--simulations", "3", "--out", "d")
    answer = frenetic(*run, *calm, "--fail-on-failure")
    assert (answer.code, answer.json["failed"]) == (0, 0)


def test_run_refuses_a_simulator_whose_package_is_missing_and_leaves_nothing(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = ("metadrive.", "frenetic.plugins.metadrive.world")  # loaded by other tests
    for name in [name for name in sys.modules if name.startswith(loaded)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "metadrive", None)
    options = ("run", "--simulator", "metadrive", "--simulations", "1", "--out", "c")
    answer = frenetic(*options)
    require_refusal(answer, 'needs the package metadrive: pip install ".[metadrive]"')
    assert "go on" not in answer.err
    assert not Path("c").exists()
    elsewhere = frenetic(*options, "--workers", "tcp://nowhere:1")
    require_refusal(elsewhere, "nowhere")
    assert "metadrive" not in elsewhere.err, "only the workers need the package"


DRIVERS = """
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
"""


def test_a_driver_that_ends_its_process_costs_one_drive(frenetic: Frenetic) -> None:
    """Each command drives Python code in another process, also with a single worker."""
    write("mydriver.py", DRIVERS)
    write("bent.json", {"curvatures": [0.0, 0.0, 0.01, 0.06, 0.06, 0.03, 0.0]})
    driver = ("--driver", "mydriver.py:Crashes", "--json")
    lost = "the driver's process was lost: it was killed by SIGABRT"
    answer = frenetic("drive", "bent.json", *driver)
    assert (answer.code, answer.json["reason"]) == (0, lost)
    search = ("--strategy", "frenetic-2021", "--simulations", "8", "--seed", "3", "--workers", "1")
    summary = frenetic("run", *search, *driver, "--out", "c").json
    assert (summary["simulations"], summary["errors"]) == (8, 0)
    assert summary["failed"] >= 1
    failures = frenetic("show", "c", "--json").json["distinct_failures"]
    assert failures[0]["description"] == "ends its process"


@pytest.mark.parametrize("workers", ["1", pytest.param("2", marks=pytest.mark.heavy)])
def test_a_drivers_error_is_reported_with_its_line_and_traceback(
    frenetic: Frenetic, workers: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The campaign's log has the traceback; with --debug the terminal has it, too."""
    write("mydriver.py", DRIVERS)
    number = DRIVERS.splitlines().index('        raise ValueError("lost")') + 1
    reason = f'the driver raised ValueError: lost (mydriver.py:{number}: raise ValueError("lost"))'
    search = ("run", "--driver", "mydriver.py:Raises", "--simulations", "3", "--seed", "1")
    with caplog.at_level("DEBUG", "frenetic"):
        answer = frenetic(*search, "--workers", workers, "--out", "c")
    assert answer.code == 0
    assert "3 failed" in answer.out
    assert f"raises ValueError at mydriver.py:{number}" in " ".join(answer.out.split())
    where = f'mydriver.py", line {number}, in act\n'
    assert sum(where in record.getMessage() for record in caplog.records) >= 3
    assert f"FAIL  {reason}" in frenetic("show", "c", "1").out
    assert frenetic(*search, "--out", "d", "--fail-on-failure").code == 1
    log = [json.loads(line) for line in Path("c/campaign.log").read_text().splitlines()]
    broken = [line for line in log if line["event"] == "test_failed"]
    assert [line["message"] for line in broken] == [f"test {n} failed: {reason}" for n in (1, 2, 3)]
    assert all(where in str(line["traceback"]) for line in broken)


def test_errors_of_a_driver_are_failures_beside_departures(frenetic: Frenetic) -> None:
    write("mydriver.py", DRIVERS)
    search = ("--simulations", "50", "--seed", "1", "--workers", "1", "--out")
    answer = frenetic("run", "--driver", "mydriver.py:Tires", *search, "c")
    assert answer.code == 0
    first, *others = frenetic("show", "c", "--json").json["distinct_failures"]
    assert first["description"].startswith("raises RuntimeError at mydriver.py:")
    assert others
    assert list(Path("c/failures").glob("test-*.json"))
    # With a driver that breaks on every road there is nothing to search for.
    answer = frenetic("run", "--driver", "mydriver.py:Raises", *search, "d")
    require_refusal(answer, "the driver broke on each of the first 10 roads", "ValueError: lost")
    assert "1 cause of 10 failures" in answer.out


def test_the_command_advised_after_a_crash_works_once_the_driver_is_mended(
    frenetic: Frenetic,
) -> None:
    """It keeps the options of the search; from another folder the driver is loaded from its own."""
    write("mydriver.py", DRIVERS)
    search = ("--simulations", "12", "--seed", "1", "--workers", "1", "--out", "c")
    parts = ("--driver", "mydriver.py:Raises")
    terms = ("--with", "delay=0.05", "--criteria", "speed_limit=60")
    crashed = frenetic("run", *parts, *terms, *search)
    (advice,) = re.findall(
        "mend it, then start it anew, with the same seed: frenetic (.*)", crashed.err
    )
    mended = DRIVERS.replace('raise ValueError("lost")', "return frenetic.Controls(0.0, 0.3)")
    write("mydriver.py", mended)
    edited = frenetic("resume", "c")
    assert edited.refuses("mydriver.py was edited after c began: restore it")
    assert edited.err.rstrip().endswith(f"frenetic {advice}")
    answer = frenetic(*shlex.split(advice), "--out", "d")
    assert answer.code == 0
    config = frenetic("show", "d", "--json").json["config"]
    assert config["seed"] == 1
    assert config["conditions"] == {"delay": 0.05}
    assert config["rules"]["speed_limit"] == 60.0
    here = Path.cwd()
    Path("other").mkdir()
    os.chdir("other")
    for words in (("resume", "../d", "--simulations", "2"), ("rerun", "../d")):
        answer = frenetic(*words)
        assert answer.code in (0, 1), answer.err
        assert f"mydriver.py:Raises is loaded from {here}" in answer.err


COUNTING_SIMULATOR = """
import time
from pathlib import Path

from frenetic import EmbeddedSimulator


class Counting(EmbeddedSimulator):
    def drive(self, road, driver):
        time.sleep(0.05)  # so that the summary stays short
        return super().drive(road, driver)

    def __exit__(self, *details):
        super().__exit__(*details)
        Path("left").touch()
"""


SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
RUN_FOR_EACH_SIGNAL = """
import signal, sys
from pathlib import Path
from command_line import empty_pictures
from frenetic.cli import main

for name in sys.argv[1:]:
    hears = name == "SIGINT"
    signal.signal(signal.SIGINT, signal.default_int_handler if hears else signal.SIG_IGN)
    options = ["--time", "10m", "--workers", "1", "--simulator", "counting.py:Counting"]
    try:
        with empty_pictures():
            main(["run", *options, "--out", name])
    except SystemExit as stop:
        Path(f"{name}.part").write_text(str(stop.code))
        Path(f"{name}.part").rename(f"{name}.code")
"""


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as on POSIX here")
def test_a_signal_ends_a_run_which_prints_its_summary_and_leaves_its_simulator(
    tmp_path: Path,
) -> None:
    """Ctrl-C, a job scheduler and a closed terminal send these signals.

    A program that a script starts in the background ignores Ctrl-C, but not the other two.
    """
    (tmp_path / "counting.py").write_text(COUNTING_SIMULATOR)
    with subprocess.Popen(
        [sys.executable, "-c", RUN_FOR_EACH_SIGNAL, *SIGNALS],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
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


SLOW_DRIVER = """
import time

from frenetic import Planner


class Slow(Planner):
    def act(self, observation):
        time.sleep(0.005)
        return super().act(observation)
"""


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent as on POSIX here")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_to_the_whole_group_is_no_failure_of_the_driver(tmp_path: Path, name: str) -> None:
    """A closed terminal signals all processes of its group, also the servers that fork workers."""
    (tmp_path / "slow.py").write_text(SLOW_DRIVER)
    words = ["run", "--driver", "slow.py:Slow", "--time", "10m", "--workers", "2", "--out", "c"]
    with subprocess.Popen(
        [sys.executable, "-m", "frenetic", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        start_new_session=True,
    ) as process:
        try:
            until(partial(stored_in_a_moment, tmp_path / "c"), "a test is stored")
            os.killpg(process.pid, signal.Signals[name])
            _, err = process.communicate(timeout=LIMIT)
        finally:
            process.kill()
    assert process.returncode == 130
    assert "resource_tracker" not in err
    with CampaignStore.open(tmp_path / "c") as store:
        faults = [test.result.fault for test in store.tests()]
    assert faults == [None] * len(faults)


@pytest.mark.heavy
def test_files_in_the_current_folder_replace_no_module_of_python(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW_DRIVER)
    for name in ("random", "pickle", "signal"):
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('it is not for you')")
    # Python imports from the folder of the program, not from the current folder.
    program = tmp_path / "bin" / "frenetic"
    program.parent.mkdir()
    program.write_text(
        "from frenetic.__main__ import main\n\nif __name__ == '__main__':\n    main()"
    )
    words = ["run", "--driver", "slow.py:Slow", "--simulations", "1", "--seed", "1", "--out", "c"]
    done = subprocess.run(
        [sys.executable, str(program), *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr


def test_show_names_the_command_that_writes_a_missing_report(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    frenetic("run", "--simulations", "3", "--seed", "1", "--out", "c")
    assert "go on" not in frenetic("show", "c").out
    (tmp_path / "c" / "report.html").unlink()
    assert "go on      frenetic resume c\n" in frenetic("show", "c").out
    assert frenetic("resume", "c").code == 0
    assert (tmp_path / "c" / "report.html").is_file()


def stored_in_a_moment(folder: Path) -> int:
    """Number of stored tests after 0.1 s, since looking takes time from the run."""
    time.sleep(0.1)
    return stored_tests(folder)


def stored_tests(folder: Path) -> int:
    try:
        with CampaignStore.open(folder) as store:
            return store.counts().result_count
    except CampaignError:
        return 0


def next_commands(answer: Answer) -> list[str]:
    """Commands that an answer advises for going on."""
    return re.findall(r"[Gg]o on:? +frenetic (.*)", answer.out + answer.err)


@pytest.mark.parametrize(
    "budget",
    [
        ("--simulations", "12"),
        pytest.param(("--time", "10m"), marks=pytest.mark.heavy),
        pytest.param(("--failures", "9"), marks=pytest.mark.heavy),
    ],
)
@pytest.mark.parametrize("aggression", ["0.2", "3"])
@pytest.mark.parametrize("more", [(), pytest.param(("--json",), marks=pytest.mark.heavy)])
def test_ctrl_c_advises_to_resume_to_the_stored_budget(
    frenetic: Frenetic,
    stopping_driver: Callable[[int], str],
    budget: tuple[str, str],
    aggression: str,
    more: tuple[str, ...],
) -> None:
    """Also if nothing failed; `show` gives the same advice, and none once the budget is spent."""
    driver = ("--driver", f"{stopping_driver(4)},aggression={aggression}")
    out = "my campaign"
    answer = frenetic("run", *driver, *budget, "--seed", "1", "--workers", "1", "--out", out, *more)
    assert answer.code == 130
    advice = "resume 'my campaign'"
    assert next_commands(answer) == [f"{advice} --workers 1"]
    assert next_commands(frenetic("show", out)) == [advice]
    assert next_commands(frenetic("show", out, "--follow")) == [advice]
    if budget[0] == "--simulations":
        stopping_driver(0)
        assert frenetic(*shlex.split(advice)).code == 0
        assert f"{budget[1]} simulations" in frenetic("show", out).out
        assert next_commands(frenetic("show", out)) == []


def test_ctrl_c_while_the_report_is_written_advises_to_resume(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("frenetic.report.results.write_report", interrupt)
        answer = frenetic("run", "--simulations", "3", "--seed", "1", "--out", "c")
    assert answer.code == 130
    assert "frenetic: interrupted; go on: frenetic resume c\n" in answer.err
    assert "Finishing after 3 tests" in frenetic("resume", "c").err


def test_ctrl_c_before_anything_is_stored_advises_the_same_command(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    write(
        "town one.toml", 'roads = "urban-50"\n[conditions]\nfriction = { low = 0.3, high = 1.0 }\n'
    )
    monkeypatch.setattr("frenetic.rerun.estimate.estimate", interrupt)
    answer = frenetic("estimate", "--odd", "town one.toml")
    assert answer.code == 130
    advice = "to run it again: frenetic estimate --odd 'town one.toml'"
    assert answer.err.strip() == f"frenetic: interrupted; {advice}"


def test_each_step_shows_its_time_and_the_last_line_the_total(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The clock is 10 s later each time it is read."""
    clock = map(float, count(0, 10))
    monkeypatch.setattr("frenetic.cli.Invocation.clock", lambda: next(clock))
    search = ("--simulations", "30", "--seed", "3", "--driver", "aggression=1.3", "--workers", "1")
    answer = frenetic("run", *search, "--out", "c")
    lines = answer.out.splitlines()
    assert lines[0].startswith("30 simulations in 0:20, 0:10 of it to start, ")
    named = {line.partition(":")[0]: line for line in lines[1:]}
    assert re.fullmatch(r"Shortened: +\d+ failing roads? \(in 0:10\)", named["Shortened"])
    assert named["At a glance"].endswith("c/failures/gallery.png (in 0:10)")
    assert named["Report"].endswith("c/report.html (in 0:10)")
    assert re.fullmatch(r"In all: +1:40", lines[-1])


def test_numbers_of_a_campaign_have_units_and_few_digits(frenetic: Frenetic) -> None:
    rules = ("--criteria", f"speed_limit={200 / 3}")
    search = ("--simulations", "2", "--time", "17.150228968000647", "--seed", "1", *rules)
    assert frenetic("run", *search, "--workers", "1", "--out", "c").code == 0
    shown = frenetic("show", "c").out
    assert "budget     2 simulations, 17.2 s of time\n" in shown
    assert not re.search(r"\d\.\d{5}", shown)
    assert str(Budget(simulations=1, time=5400.0, failures=2)) == (
        "1 simulation, 1:30:00 of time, 2 failures"
    )
    assert str(Budget(kilometres=12.5, simulated_time=90.0)) == "12.5 km, 1:30 of simulated time"


def test_run_show_and_report_name_the_parts_with_their_options(frenetic: Frenetic) -> None:
    parts = ("frenetic,random_roads=5", "planner,aggression=1.3", "embedded,friction=0.9")
    strategy, driver, simulator = parts
    chosen = ("--strategy", strategy, "--driver", driver, "--simulator", simulator)
    answer = frenetic("run", *chosen, "--simulations", "3", "--seed", "1", "--out", "c")
    searching = (
        f"Searching with {strategy} for roads on which {driver} fails in {simulator}, seed 1"
    )
    assert searching in answer.err
    shown = frenetic("show", "c").out
    assert all(f" {part} [" in shown for part in parts)
    assert f"search     {', '.join(parts)}, seed 1\n" in frenetic("show", "c", "--follow").out
    lead = f"{strategy} searched for roads on which {driver} leaves its lane in {simulator}"
    assert lead in Path("c/report.html").read_text("utf-8")
    assert f"Continuing after 3 tests with {strategy}" in (
        frenetic("resume", "c", "--simulations", "1").err
    )
