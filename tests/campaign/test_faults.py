"""Whole campaigns on a bad day: faults, kills, full disks, damaged files, Ctrl-C."""

from __future__ import annotations

import itertools
import json
import os
import random
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime, tzinfo
from pathlib import Path
from typing import Any

import faulty
import killing
import pytest
from campaigns import campaign, refused
from contents import contents, everything
from driving import events
from events import on_result
from faulty import Fault, FaultySimulator, Forking, Marks, bend, refuse_connection
from pids import LIMIT, descendants, ending, is_running, until, until_gone
from small_disk import Bounded, Breaking

from frenetic._support import words
from frenetic.campaign import Budget, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.database import DATABASE
from frenetic.campaign.workers.local import AHEAD
from frenetic.cli import main
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.road import Road
from frenetic.simulators import Drive
from frenetic.testing import DummySimulator

HERE = Path(__file__).parent

pytest_plugins = ["campaign_fixtures"]

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="by POSIX signals and groups")


# Faults of simulators and drivers


@pytest.mark.parametrize("workers", [1, 2])
def test_a_simulator_that_does_not_start_ends_the_campaign(
    tmp_path: Path, marks: Marks, workers: int
) -> None:
    simulator = FaultySimulator(marks.folder, start=Fault(refuse_connection, marks.folder))
    with refused("ConnectionRefusedError: nobody listens") as caught:
        campaign(tmp_path / "c", simulator=simulator, workers=workers).run()
    last = events(tmp_path / "c")[-1]
    assert last["event"] == "gave_up"
    assert str(caught.value) == f"{last['message']}; 0 results stored, 0% of the budget spent"
    assert len(marks.numbers("start")) == workers
    # When it is mended, the campaign is resumed.
    assert campaign(tmp_path / "c", simulator=FaultySimulator(marks.folder)).resume().tests > 0


@posix_only
@pytest.mark.parametrize("workers", [1, 2])
def test_forks_of_strategies_leave_no_trace(tmp_path: Path, marks: Marks, workers: int) -> None:
    """They would go on with the campaign, and share its database."""
    strategy = Forking(marks.folder, 8, 9)
    search = campaign(tmp_path / "c", strategy=strategy, simulations=10, workers=workers)
    assert search.run().passed == 10
    assert len(marks.pids()) >= 10
    until_gone(marks.pids())
    assert check_campaign(tmp_path / "c").findings == ()


# Two at once


def test_a_second_process_is_refused(tmp_path: Path, finished: Path) -> None:
    answers: list[str] = []

    def try_elsewhere(progress: object) -> None:
        if not answers:
            said = tmp_path / "said"
            assert killing.exit_code_of(killing.write_refusals, tmp_path / "c", said) == 0
            answers.extend(said.read_text(encoding="utf-8").splitlines())

    summary = campaign(tmp_path / "c").run(on_event=on_result(try_elsewhere))
    assert summary.simulations == 60
    run, resume = answers
    assert "already holds a campaign" in run
    assert f"is being written by process {os.getpid()}" in resume
    assert contents(tmp_path / "c") == contents(finished)


# Disks


def on_a_small_disk(folder: Path, what: str) -> dict[str, Any]:
    """What `small_disk` sees on a file system of its own."""
    folder.mkdir()
    mount = f"mount -t tmpfs -o size=64m none '{folder}'"
    apart = ["unshare", "-rm", "sh", "-c"]
    if not shutil.which("unshare") or subprocess.run([*apart, mount], check=False).returncode:
        pytest.skip("no file system can be mounted here")
    done = subprocess.run(
        [
            *apart,
            f'{mount} && exec "$@"',
            "sh",
            sys.executable,
            HERE / "small_disk.py",
            folder,
            what,
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=2 * LIMIT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])},
    )
    assert done.returncode == 0, done.stderr
    seen: dict[str, Any] = json.loads(done.stdout)
    return seen


@posix_only
def test_a_full_disk_loses_nothing_and_the_campaign_goes_on(tmp_path: Path) -> None:
    for seen in on_a_small_disk(tmp_path / "disk", "full").values():
        first, again = seen["messages"]
        for message in (first, again):
            assert "the disk is full: free some space and resume the campaign" in message
            assert "\n" not in message
        assert seen["reported"] == seen["stored"] > 0
        assert seen["ended"] == "200"
        assert seen["same"]


@pytest.mark.parametrize("what", ["folder", "database", "replaced"])
def test_a_removed_database_ends_the_campaign(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It does not search into nothing."""
    monkeypatch.setattr("frenetic.campaign.loop.PROGRESS_INTERVAL", 0.0)
    folder = tmp_path / "campaign"
    seen = 0

    def remove(_: object) -> None:
        nonlocal seen
        seen += 1
        if seen == 5:
            if what == "folder":
                shutil.rmtree(folder)
            else:
                (folder / DATABASE).rename(folder / "elsewhere")
            if what == "replaced":
                (folder / DATABASE).write_bytes(b"another file")

    with refused("was removed or replaced while it was written"):
        campaign(folder).run(on_event=on_result(remove))
    assert seen < 20


@posix_only
def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    seen = on_a_small_disk(tmp_path / "disk", "readonly")
    for message in seen["messages"]:
        assert "ermission" in message or "Read-only" in message
        assert "\n" not in message
    assert seen["stored"] == 200
    assert seen["same"]


def damaged(data: bytes, kind: int, rng: random.Random) -> bytes:
    """A database without its end, without its header, or with one to 2000 flipped bits."""
    whole = bytearray(data)
    if kind == 0:
        del whole[rng.randrange(len(whole)) :]
    elif kind == 1:
        whole[:16] = bytes(16)
    else:
        first = rng.randrange(len(whole) - 2000)
        for _ in range(rng.choice([1, 30, 2000])):
            whole[rng.randrange(first, first + 2000)] ^= 1 << rng.randrange(8)
    return bytes(whole)


@pytest.mark.parametrize("seed", range(12))
def test_a_damaged_database_is_refused_and_left_as_it_is(
    tmp_path: Path, finished: Path, seed: int
) -> None:
    """Or else the damage is in what a campaign goes on without, such as an old trajectory."""
    data = damaged((finished / DATABASE).read_bytes(), seed % 4, random.Random(seed))
    (tmp_path / DATABASE).write_bytes(data)
    with refused("already holds a campaign"):
        campaign(tmp_path).run()
    refusals = []
    for use in (lambda: everything(tmp_path), campaign(tmp_path, 70).resume):
        assert (tmp_path / DATABASE).read_bytes() == data
        try:
            use()
        except CampaignError as error:
            refusals.append(str(error))
    assert "\n" not in "".join(refusals)
    if len(refusals) == 1:
        assert "trajectory" in refusals[0]
    if seed % 4 < 2:
        assert len(refusals) == 2
        assert (tmp_path / DATABASE).read_bytes() == data


# Clocks


class Timed(DummySimulator):
    """Counts its drives."""

    drives = 0

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.drives += 1
        return super().drive(road, driver)


def test_a_clock_that_jumps_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Budgets are measured by `time.perf_counter`, which is taken to go on steadily."""
    jumps, real = itertools.cycle([0.0, -3600.0, 24 * 3600.0, 25 * 3600.0]), time.time

    class Jumping(datetime):
        """An hour back, a day on."""

        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Jumping:
            return cls.fromtimestamp(real() + next(jumps), tz)

    allowed = []
    for name in ("steady", "jumping"):
        simulator = Timed(bend)
        monkeypatch.setattr(time, "perf_counter", lambda: 0.01 * simulator.drives)  # noqa: B023
        search = campaign(tmp_path / name, simulator=simulator, budget=Budget(time=0.505))
        allowed.append(search.run().simulations)
        monkeypatch.setattr(time, "time", lambda: real() + next(jumps))
        monkeypatch.setattr(words, "datetime", Jumping)
    monkeypatch.undo()
    assert allowed[0] == allowed[1] > 20
    assert contents(tmp_path / "jumping") == contents(tmp_path / "steady")
    with CampaignStore.open(tmp_path / "jumping") as store:
        elapsed = [record.elapsed or 0.0 for record in store.tests()]
        finished_at = [str(record.finished_at) for record in store.tests()]
    assert elapsed == sorted(elapsed)
    assert finished_at != sorted(finished_at)  # it did jump


# The command line, killed and interrupted


class Running:
    """A ``frenetic run`` in a group of its own, as a terminal starts it."""

    def __init__(
        self,
        tmp_path: Path,
        marks: Marks,
        *options: str,
        workers: int = 2,
        simulator: str = f"{faulty.__file__}:Waiting",
    ) -> None:
        self.marks = marks
        self.folder = tmp_path / "campaign"
        self.out, self.err = tmp_path / "out", tmp_path / "err"
        command = [sys.executable, "-m", "frenetic", "run", "--simulations", "60"]
        command += ["--workers", str(workers), "--out", str(self.folder)]
        given = () if simulator == "embedded" else (f"folder={marks.folder}", *options)
        command += ["--simulator", ",".join([simulator, *given])]
        with self.out.open("w") as out, self.err.open("w") as err:
            self.process = subprocess.Popen(
                command, stdout=out, stderr=err, cwd=tmp_path, start_new_session=True
            )
        self.family: set[int] = set()

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *_: object) -> None:
        with ending(lambda: {*self.family, *descendants(self.process.pid)}):
            self.process.kill()
            self.process.wait()

    def until_marks(self, name: str, count: int = 2) -> None:
        self.until(lambda: len(self.marks.numbers(name)) == count, f"{count} {name}")

    def until(self, condition: Callable[[], object], what: str) -> None:
        def holds() -> bool:
            assert self.process.poll() is None, self.err.read_text()
            return bool(condition())

        until(holds, what)
        self.family |= {self.process.pid, *descendants(self.process.pid)}

    def press_ctrl_c(self) -> None:
        os.killpg(self.process.pid, signal.SIGINT)

    def ends(self, code: int = 130) -> None:
        """It ends so, with all that it started, and leaves a sound campaign, if any."""
        assert self.process.wait(LIMIT) == code, self.err.read_text()
        until_gone({*self.family, *self.marks.pids()})
        assert "Traceback" not in self.err.read_text()
        assert "EOFError" not in self.err.read_text()
        if self.folder.exists():
            assert check_campaign(self.folder).findings == ()

    def told(self) -> int:
        with CampaignStore.open(self.folder) as store:
            return store.counts().told


@posix_only
def test_ctrl_c_finishes_what_runs(tmp_path: Path, marks: Marks) -> None:
    with Running(tmp_path, marks, "after=5") as running:
        running.until_marks("driving")
        running.press_ctrl_c()
        running.until(lambda: "Finishing what runs" in running.err.read_text(), "it is noticed")
        marks.make("go")
        running.ends()
    # Five, the two that waited, and what quick workers had got ahead of time.
    assert 7 <= running.told() <= 5 + 2 * AHEAD
    assert f"Interrupted: {running.told()} simulations" in running.out.read_text()
    assert events(running.folder)[-1]["event"] == "interrupted"
    assert len(marks.numbers("end")) == 2  # the simulators were ended in peace


@posix_only
def test_ctrl_c_twice_leaves_at_once_and_loses_nothing(tmp_path: Path, marks: Marks) -> None:
    with Running(tmp_path, marks, "after=5", "deed=start_process") as running:
        running.until_marks("driving")
        running.until(lambda: running.told() == 5, "five results")
        running.until(lambda: len(marks.pids()) == 4, "processes that the drivers started")
        running.press_ctrl_c()
        running.until(lambda: "Finishing what runs" in running.err.read_text(), "it is noticed")
        start = time.monotonic()
        running.press_ctrl_c()
        running.ends()
        assert time.monotonic() - start < 0.5 * LIMIT
    assert "Interrupted: 5 simulations" in running.out.read_text()
    assert running.told() == 5


@posix_only
@pytest.mark.parametrize("presses", [1, 2])
def test_ctrl_c_while_simulators_start(tmp_path: Path, marks: Marks, presses: int) -> None:
    with Running(tmp_path, marks, "at=starting") as running:
        running.until_marks("starting")
        start = time.monotonic()
        for _ in range(presses):
            running.press_ctrl_c()
        running.ends()
        assert time.monotonic() - start < 0.5 * LIMIT
    assert running.told() == 0


@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked from a server there only")
@pytest.mark.parametrize("is_named", [False, True])
@pytest.mark.parametrize(("presses", "loaded"), [(1, "python"), (1, "llvmlite"), (2, "numpy")])
def test_ctrl_c_while_the_server_of_the_workers_starts(
    tmp_path: Path, marks: Marks, presses: int, loaded: str, is_named: bool
) -> None:
    """Of the campaign; or of the process that makes a named part, before there is a campaign."""

    def server_is_there() -> bool:
        """With what it loads on its way."""
        for child in descendants(running.process.pid):
            try:
                line = Path(f"/proc/{child}/cmdline").read_bytes()
                if b"multiprocessing.forkserver" in line:
                    return loaded in Path(f"/proc/{child}/maps").read_text()
            except OSError:
                continue
        return False

    named: Any = {} if is_named else {"simulator": "embedded"}
    with Running(tmp_path, marks, **named) as running:
        running.until(server_is_there, "the server starts")
        for _ in range(1 if is_named else presses):
            running.press_ctrl_c()
            if presses == 2 and not is_named:
                running.until(lambda: "Finishing" in running.err.read_text(), "it is noticed")
        running.ends()
    if is_named:
        assert not running.folder.exists()
    else:
        assert running.told() == 0


@posix_only
@pytest.mark.parametrize(
    "deed",
    # Elsewhere nobody ends processes that are held by compiled code.
    ["start_process", *(["hang_in_c"] if sys.platform == "linux" else [])],
)
def test_workers_of_a_killed_campaign_end_with_all_they_started(
    tmp_path: Path, marks: Marks, deed: str
) -> None:
    with Running(tmp_path, marks, "after=4", f"deed={deed}") as running:
        running.until_marks("driving")
        running.until(lambda: running.told() == 4, "four results")
        wanted = 2 if deed == "hang_in_c" else 4
        running.until(lambda: len(marks.pids()) == wanted, "all are there")
        assert all(is_running(pid) for pid in marks.pids())
        running.process.kill()
        running.ends(-signal.SIGKILL)
    assert running.told() == 4


# Ctrl-C within a write


@pytest.mark.parametrize("statement", range(1, 12))
def test_a_second_ctrl_c_within_a_write_loses_nothing(
    tmp_path: Path, finished: Path, breaking: type[Breaking], statement: int
) -> None:
    reported: list[int] = []

    def report(progress: Any) -> None:
        reported.append(progress.tests)
        if len(reported) == 20:
            breaking.left = statement

    summary = campaign(tmp_path).run(on_event=on_result(report))
    assert breaking.left == 0
    assert summary.interrupted
    with CampaignStore.open(tmp_path) as store:
        assert len(reported) <= store.counts().told == summary.tests <= len(reported) + 1
    assert check_campaign(tmp_path).findings == ()
    campaign(tmp_path).resume()
    assert contents(tmp_path) == contents(finished)


# The command line


def command(*words: str) -> int:
    """Exit code of a command line."""
    with pytest.raises(SystemExit) as stop:
        main(list(words))
    assert isinstance(stop.value.code, int)
    return stop.value.code


RUN = ("run", "--simulations", "40", "--seed", "3", "--workers", "1")


def test_a_full_disk_says_what_is_stored_and_the_command_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *a, **k: connect(*a, **k, factory=Bounded))
    monkeypatch.setattr(Bounded, "pages", 40)
    assert command(*RUN, "--out", "a b") == 2
    with CampaignStore.open(Path("a b")) as store:
        stored = store.counts().told
    assert 0 < stored < 40
    message = capsys.readouterr().err.splitlines()[-1]
    assert "the disk is full" in message
    assert f"; {stored} results stored, " in message
    assert "% of the budget spent; go on: frenetic resume 'a b' --workers 1" in message
    words = shlex.split(message.partition("go on: ")[2])
    assert words == ["frenetic", "resume", "a b", "--workers", "1"]
    monkeypatch.setattr(Bounded, "pages", None)
    assert command(*words[1:]) == 0
    with CampaignStore.open(Path("a b")) as store:
        assert store.counts().simulations == 40


@pytest.mark.skipif(sys.platform == "win32", reason="a process kills itself by a POSIX signal")
@pytest.mark.parametrize(
    "place", ["frenetic.campaign.store.CampaignStore.finish", "frenetic.report.html.write_report"]
)
def test_what_a_kill_after_the_last_result_leaves_is_finished(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    place: str,
) -> None:
    run = (*RUN, "--out", "c")
    assert killing.exit_code_of(killing.run_until, place, tmp_path, run) == -signal.SIGKILL
    monkeypatch.chdir(tmp_path)
    left = contents(Path("c"))
    assert command("report", "c") == 0
    page = Path("c/report.html").read_text(encoding="utf-8")
    assert ("Killed after its last result" in page) is ("finish" in place)
    Path("c/report.html").unlink()
    assert command("resume", "c", "--workers", "1") == 0
    assert contents(Path("c")) == left
    assert Path("c/report.html").is_file()
    assert command("check", "c") == 0
    assert command("resume", "c") == 2
    assert "the budget of c is spent" in capsys.readouterr().err
