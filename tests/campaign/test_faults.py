"""Whole campaigns under faults: kills, forks, full disks, moved and deleted folders, Ctrl-C."""

from __future__ import annotations

import itertools
import json
import os
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import faulty
import killing
import pytest
import small_disk
from campaigns import campaign, refused, scripted
from contents import contents
from driving import events
from events import on_result
from faulty import Forking, Marks
from pids import LIMIT, descendants, ending, is_running, until, until_gone
from small_disk import Bounded, Breaking

from frenetic.campaign import Budget, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.database import DATABASE
from frenetic.campaign.workers.local import MAX_QUEUED
from frenetic.cli import main
from frenetic.errors import CampaignGoneError

HERE = Path(__file__).parent

pytest_plugins = ["campaign_fixtures"]

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="by POSIX signals and groups")


def stored(folder: Path) -> int:
    with CampaignStore.open(folder) as store:
        return store.counts().result_count


def test_processes_that_a_strategy_forks_change_nothing(tmp_path: Path, marks: Marks) -> None:
    """Such forks would go on with the campaign, and share its database."""
    search = campaign(tmp_path, strategy=Forking(marks.folder, 8, 9), simulations=6)
    assert search.run().passed == 6
    assert len(marks.pids()) >= 6
    until_gone(marks.pids())
    assert check_campaign(tmp_path).findings == ()


def test_a_second_process_can_neither_run_nor_resume_a_running_campaign(tmp_path: Path) -> None:
    answers: list[str] = []

    def try_elsewhere(progress: object) -> None:
        if not answers:
            answer_file = tmp_path / "said"
            assert killing.exit_code_of(killing.write_refusals, tmp_path / "c", answer_file) == 0
            answers.extend(answer_file.read_text(encoding="utf-8").splitlines())

    for name, report in (("c", try_elsewhere), ("alone", print)):
        search = scripted(tmp_path / name, Budget(simulations=9))
        assert search.run(on_event=on_result(report)).simulations == 9
    run, resume = answers
    assert "already holds a campaign" in run
    assert f"is being written by process {os.getpid()}" in resume
    assert contents(tmp_path / "c") == contents(tmp_path / "alone")


# Disks


@pytest.mark.heavy
@posix_only
def test_a_full_disk_loses_nothing_and_the_campaign_goes_on(tmp_path: Path) -> None:
    """The campaign writes to a small file system of memory."""
    (folder := tmp_path / "disk").mkdir()
    mount = f"mount -t tmpfs -o size=64m none '{folder}'"
    unshared = ["unshare", "-rm", "sh", "-c"]
    if not shutil.which("unshare") or subprocess.run([*unshared, mount], check=False).returncode:
        pytest.skip("no file system can be mounted here")
    done = subprocess.run(
        [*unshared, f'{mount} && exec "$@"', "sh", sys.executable, small_disk.__file__, folder],
        capture_output=True,
        text=True,
        check=False,
        timeout=2 * LIMIT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])},
    )
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    for message in answer["messages"]:
        assert "the disk is full: free some space and resume the campaign" in message
        assert "\n" not in message
    assert answer["reported"] == answer["stored"] > 0
    assert answer["ended"] == "200"
    assert answer["same"]


@posix_only
@pytest.mark.parametrize("deed", ["moved", "its parent moved", "moved and replaced"])
def test_a_moved_folder_ends_the_campaign_which_is_resumed_at_the_new_place(
    deed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.PROGRESS_INTERVAL", 0.0)
    folder = tmp_path / "before" / "campaign"
    new = tmp_path / "after" / "campaign"
    calls = itertools.count(1)

    def move(_: object) -> None:
        if next(calls) == 5:
            if deed == "its parent moved":
                folder.parent.rename(new.parent)
            else:
                new.parent.mkdir()
                folder.rename(new)
            if deed == "moved and replaced":
                folder.mkdir()

    with pytest.raises(CampaignGoneError) as gone:
        scripted(folder, Budget(simulations=50)).run(on_event=on_result(move))
    results = stored(new)
    assert results >= 5
    place = f" to {new}" if sys.platform == "linux" else ""
    assert str(gone.value) == (
        f"{folder} was moved{place} while it was in use: its {results} results are there;"
        " resume it there"
    )
    assert next(calls) < 20
    assert list(folder.parent.rglob("*")) == ([folder] if deed == "moved and replaced" else [])
    assert scripted(new, Budget(simulations=50)).resume().simulations == 50
    assert not check_campaign(new).findings


@posix_only
@pytest.mark.parametrize("deed", ["folder", "replaced folder", "database", "replaced database"])
def test_a_deleted_folder_or_database_ends_the_campaign_and_is_not_made_again(
    deed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.PROGRESS_INTERVAL", 0.0)
    folder = tmp_path / "campaign"
    calls = itertools.count(1)

    def remove(_: object) -> None:
        if next(calls) == 5:
            if "folder" in deed:
                shutil.rmtree(folder)
            else:
                (folder / DATABASE).rename(tmp_path / "elsewhere")
            if deed == "replaced folder":
                folder.mkdir()
            if deed == "replaced database":
                (folder / DATABASE).write_bytes(b"another file")

    words = (
        f"{folder} was deleted while it was in use, and its results are gone"
        if "folder" in deed
        else f"{folder / DATABASE} was taken out of its folder or replaced while it was in use"
    )
    with refused(re.escape(words)):
        scripted(folder, Budget(simulations=50)).run(on_event=on_result(remove))
    assert next(calls) < 20
    if "folder" in deed:
        assert list(tmp_path.rglob("*")) == ([folder] if deed == "replaced folder" else [])
        return
    (tmp_path / "elsewhere").replace(folder / DATABASE)  # as the message advises
    assert stored(folder) >= 5


# The command line, killed and interrupted


class Running:
    """A `frenetic run` in its own process group, as a terminal starts it."""

    def __init__(
        self,
        tmp_path: Path,
        marks: Marks,
        *options: str,
        simulator: str = f"{faulty.__file__}:Waiting",
        driver: str = "planner",
    ) -> None:
        self.marks = marks
        self.folder = tmp_path / "campaign"
        self.out, self.err = tmp_path / "out", tmp_path / "err"
        command = [sys.executable, "-m", "frenetic", "run", "--simulations", "60"]
        command += ["--workers", "2", "--out", str(self.folder), "--driver", driver]
        simulator_options = () if simulator == "embedded" else (f"folder={marks.folder}", *options)
        command += ["--simulator", ",".join([simulator, *simulator_options])]
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

    def until(self, condition: Callable[[], object], event: str) -> None:
        def holds() -> bool:
            assert self.process.poll() is None, self.err.read_text()
            return bool(condition())

        until(holds, event)
        self.family |= {self.process.pid, *descendants(self.process.pid)}

    def until_marks(self, name: str, count: int = 2) -> None:
        self.until(lambda: len(self.marks.numbers(name)) == count, f"{count} {name}")

    def press_ctrl_c(self, *, until_noticed: bool = True) -> None:
        os.killpg(self.process.pid, signal.SIGINT)
        if until_noticed:
            self.until(lambda: "Finishing what runs" in self.err.read_text(), "it is noticed")

    def require_end(self, code: int = 130) -> None:
        """Require the exit code, the end of all started processes, and a sound campaign, if any."""
        assert self.process.wait(0.5 * LIMIT) == code, self.err.read_text()
        until_gone({*self.family, *self.marks.pids()})
        assert "Traceback" not in self.err.read_text()
        assert "EOFError" not in self.err.read_text()
        if self.folder.exists():
            assert check_campaign(self.folder).findings == ()


@posix_only
def test_ctrl_c_lets_running_tests_finish(tmp_path: Path, marks: Marks) -> None:
    with Running(tmp_path, marks, "after=5") as running:
        running.until_marks("driving")
        running.press_ctrl_c()
        marks.make("go")
        running.require_end()
    # Five, the two that waited, and the candidates that quick workers had in advance.
    results = stored(running.folder)
    assert 7 <= results <= 5 + 2 * MAX_QUEUED
    assert f"Interrupted: {results} simulations" in running.out.read_text()
    assert events(running.folder)[-1]["event"] == "interrupted"
    assert len(marks.numbers("end")) == 2  # both simulators were closed


@pytest.mark.heavy
@posix_only
def test_ctrl_c_twice_ends_at_once_and_loses_no_result(tmp_path: Path, marks: Marks) -> None:
    with Running(tmp_path, marks, "after=5", "deed=start_process") as running:
        running.until_marks("driving")
        running.until_marks("pid", 4)  # with the processes that the drivers started
        # Five or fewer: results after a road on which a slow worker waits are not stored.
        before = stored(running.folder)
        running.press_ctrl_c()
        running.press_ctrl_c(until_noticed=False)
        running.require_end()
    results = stored(running.folder)
    assert before <= results <= 5
    assert f"Interrupted: {results} simulation" in running.out.read_text()


@pytest.mark.heavy
@posix_only
def test_ctrl_c_while_simulators_start_stores_nothing(tmp_path: Path, marks: Marks) -> None:
    with Running(tmp_path, marks, "at=starting") as running:
        running.until_marks("starting")
        running.press_ctrl_c(until_noticed=False)
        running.require_end()
    assert stored(running.folder) == 0


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform != "linux", reason="workers are forked from a server there only")
@pytest.mark.parametrize(
    ("simulator", "presses", "loaded"), [("embedded", 2, "numpy"), ("", 1, "python")]
)
def test_ctrl_c_while_the_server_of_the_workers_starts_stores_nothing(
    tmp_path: Path, marks: Marks, simulator: str, presses: int, loaded: str
) -> None:
    """The server has loaded numpy, or has just started."""

    def server_is_there() -> bool:
        """Whether the server runs and has loaded the named library."""
        for child in descendants(running.process.pid):
            try:
                line = Path(f"/proc/{child}/cmdline").read_bytes()
                if b"multiprocessing.forkserver" in line:
                    return loaded in Path(f"/proc/{child}/maps").read_text()
            except OSError:
                continue
        return False

    options: Any = {}
    if simulator:
        # A driver in Python: only compiled drivers need no processes.
        driver = tmp_path / "python_planner.py"
        driver.write_text(
            "from frenetic.drivers import Planner\n\n\nclass PythonPlanner(Planner):\n    pass\n"
        )
        options = {"simulator": simulator, "driver": f"{driver}:PythonPlanner"}
    with Running(tmp_path, marks, **options) as running:
        running.until(server_is_there, "the server starts")
        for number in range(presses):
            running.press_ctrl_c(until_noticed=number < presses - 1)
        running.require_end()
    assert stored(running.folder) == 0


@pytest.mark.heavy
@posix_only
def test_workers_of_a_killed_campaign_end_with_the_processes_that_they_started(
    tmp_path: Path, marks: Marks
) -> None:
    """Also workers in compiled code."""
    with Running(tmp_path, marks, "after=4", "deed=start_process_and_hang") as running:
        running.until_marks("driving")
        running.until_marks("pid", 4)
        before = stored(running.folder)
        assert all(is_running(pid) for pid in marks.pids())
        running.process.kill()
        running.require_end(-signal.SIGKILL)
    assert before <= stored(running.folder) <= 4


@pytest.mark.parametrize(
    "statement",
    [n if n in (1, 4, 8) else pytest.param(n, marks=pytest.mark.heavy) for n in range(1, 12)],
)
def test_a_second_ctrl_c_within_a_write_loses_no_result(
    tmp_path: Path, breaking: type[Breaking], statement: int
) -> None:
    reported: list[int] = []

    def report(progress: Any) -> None:
        reported.append(progress.tests)
        if len(reported) == 4:
            breaking.left = statement

    summary = scripted(tmp_path / "c", Budget(simulations=8)).run(on_event=on_result(report))
    assert breaking.left == 0
    assert summary.interrupted
    assert len(reported) <= stored(tmp_path / "c") == summary.tests <= len(reported) + 1
    assert check_campaign(tmp_path / "c").findings == ()
    scripted(tmp_path / "c", Budget(simulations=8)).resume()
    scripted(tmp_path / "whole", Budget(simulations=8)).run()
    assert contents(tmp_path / "c") == contents(tmp_path / "whole")


# Commands after a fault


def command(*words: str) -> int:
    """Exit code of a command line."""
    with pytest.raises(SystemExit) as stop:
        main(list(words))
    assert isinstance(stop.value.code, int)
    return stop.value.code


RUN = ("run", "--simulations", "40", "--seed", "3", "--workers", "1")


def test_after_a_full_disk_run_prints_the_stored_results_and_the_command_that_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *a, **k: connect(*a, **k, factory=Bounded))
    monkeypatch.setattr(Bounded, "pages", 40)
    assert command(*RUN, "--out", "a b") == 2
    results = stored(Path("a b"))
    assert 0 < results < 40
    message = capsys.readouterr().err.splitlines()[-1]
    assert "the disk is full" in message
    assert f"; {results} results stored, " in message
    assert message.endswith("% of the budget spent; go on: frenetic resume 'a b' --workers 1")
    monkeypatch.setattr(Bounded, "pages", None)
    assert command(*shlex.split(message.partition("go on: frenetic ")[2])) == 0
    with CampaignStore.open(Path("a b")) as store:
        assert store.counts().simulations == 40


@pytest.mark.skipif(sys.platform == "win32", reason="a process kills itself by a POSIX signal")
def test_resume_finishes_a_campaign_that_was_killed_after_its_last_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target = "frenetic.campaign.store.CampaignStore.finish"
    run = (*RUN, "--simulations", "5", "--out", "c")
    assert killing.exit_code_of(killing.run_until, target, tmp_path, run) == -signal.SIGKILL
    monkeypatch.chdir(tmp_path)
    before, page = contents(Path("c")), Path("c/report.html")
    assert command("report", "c") == 0
    page.unlink()
    assert command("resume", "c", "--workers", "1") == 0
    assert contents(Path("c")) == before
    assert page.is_file()
    assert command("check", "c") == 0
    assert command("resume", "c") == 2
    assert "the budget of c is spent" in capsys.readouterr().err


@posix_only
@pytest.mark.parametrize(
    "place",
    [
        "frenetic.campaign.store.CampaignStore.finish",
        "frenetic.report.results.write_failures",
        "frenetic.report.html.campaign.write_page",
    ],
)
def test_a_resumed_campaign_killed_before_its_report_gets_a_new_one(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(*RUN, "--simulations", "5", "--out", "c") == 0
    page = Path("c/report.html")
    old_page = page.read_text(encoding="utf-8")
    more = ("resume", "c", "--simulations", "3", "--workers", "1")
    assert killing.exit_code_of(killing.run_until, place, tmp_path, more) == -signal.SIGKILL
    assert stored(Path("c")) == 8
    assert page.read_text(encoding="utf-8") == old_page
    assert "go on      frenetic resume c" in output_of("show", "c", capsys=capsys)
    assert command("resume", "c", "--workers", "1") == 0
    assert page.read_text(encoding="utf-8") != old_page
    assert "go on" not in output_of("show", "c", capsys=capsys)
    assert command("resume", "c") == 2
    assert "the budget of c is spent" in capsys.readouterr().err


def output_of(*words: str, capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert command(*words) == 0
    return capsys.readouterr().out
