"""The command that follows a campaign: what it shows, where, and with which exit code."""

from __future__ import annotations

import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from rich.console import Console

from frenetic.campaign.log import LOG, CampaignLog, Event, WorkerState
from frenetic.campaign.progress import Progress
from frenetic.campaign.watch import SILENT_AFTER, CampaignState, CampaignWatcher
from frenetic.cli import main
from frenetic.cli.watch import live_view, sparkline
from frenetic.report.state_text import doubt

LIMIT = 120.0  # s after which a test that waits for another process fails


def progress(number: int) -> Progress:
    return Progress(
        invalid=number,
        passed=90 * number,
        failed=10 * number,
        errors=1,
        dropped=3,
        roads=1100,
        min_moobd=-1.25,
        seconds=10.0 * number,
        budget_spent=number / 100,
    )


def begin(folder: Path, *, workers: int = 2, steps: int = 12) -> None:
    """A campaign that has come a part of its way."""
    folder.mkdir(exist_ok=True)
    with CampaignLog(folder) as log:
        log.write(
            Event.STARTED,
            "started",
            strategy={"class": "frenetic.search.frenetic:Frenetic"},
            driver={"class": "drivers:Planner"},
            simulator={"class": "simulators:EmbeddedSimulator"},
            seed=3,
            budget={"simulations": 5000, "time": 3600.0, "failures": None},
            host="bench-2",
            process_id=4711,
        )
        names = [f"worker {k}" for k in range(1, workers + 1)]
        states = {name: WorkerState(name, "driving", 600, 1.5) for name in names}
        states[names[-1]] = WorkerState(names[-1], "lost", 7, 65.0)
        for number in range(steps + 1):
            log.progress(progress(number), workers=states, running=workers - 1, force=True)
        log.write(Event.TEST_ERROR, "test 5 broke: [red]odd[/red] \x1b[2J", level="error", test=5)


def end(folder: Path, event: Event = Event.FINISHED) -> None:
    with CampaignLog(folder) as log:
        log.progress(progress(100), force=True)
        log.write(event, str(event))


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int | str | None, str, str]:
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(["watch", *arguments])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


@pytest.fixture
def campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    begin(Path("c"))
    return Path("c")


# Once


def test_once_says_how_it_goes_and_leaves(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = call(capsys, "c", "--once")
    assert (code, err) == (0, "")
    facts = dict(line.split(maxsplit=1) for line in out.splitlines() if line[0].isalpha())
    assert facts["campaign"] == "c"
    assert facts["status"] == "running"
    assert facts["search"] == (
        "Frenetic, Planner, EmbeddedSimulator, seed 3, budget 5000 simulations or 1:00:00"
    )
    assert facts["budget"] == "12.0% spent, 2:00, 14:40 left"
    assert facts["results"] == (
        "1213 tests of 1100 different roads: 1080 passed, 120 failed, 12 invalid, 1 error;"
        " 3 dropped"
    )
    assert facts["rate"] == "10.1 tests/s now, 10.1 tests/s overall"
    assert facts["best"] == "MOOBD -1.25 m"
    assert facts["workers"] == "1 driving, 1 lost"
    assert out.splitlines()[-1].endswith("error: test 5 broke: [red]odd[/red] [2J")


def test_a_campaign_of_a_second_has_no_bars_and_no_rate_now(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = Path("short")
    short.mkdir()
    with CampaignLog(short) as log:
        log.write(Event.STARTED, "started", seed=3)
        few = Progress(passed=1, failed=2, roads=3, seconds=0.4, budget_spent=1.0)
        log.progress(few, force=True)
        log.write(Event.FINISHED, "finished")
    code, out, _ = call(capsys, "short")
    assert code == 0
    assert "results    3 tests of 3 different roads: 1 passed, 2 failed" in out
    assert "rate       7.5 tests/s overall" in out
    assert "failures " not in out
    with CampaignLog(short) as log:
        log.write(Event.STARTED, "started", seed=4)
        log.progress(Progress(), force=True)
    code, out, _ = call(capsys, "short", "--once")
    assert code == 0
    assert "results    0 tests: 0 passed" in out
    assert "status     running" in out


@pytest.mark.parametrize("event", [Event.FINISHED, Event.INTERRUPTED, Event.GAVE_UP])
def test_once_leaves_with_0_however_it_ended(
    campaign: Path, capsys: pytest.CaptureFixture[str], event: Event
) -> None:
    end(campaign, event)
    code, out, _ = call(capsys, "c", "--once")
    assert code == 0
    assert f"status     {event.replace('_', ' ')}\n" in out


@pytest.mark.parametrize("options", [["--json"], ["--json", "--once"]])
def test_json_is_one_object(
    campaign: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    code, out, err = call(capsys, "c", *options)
    assert (code, err) == (0, "")
    seen = json.loads(out)
    assert (seen["folder"], seen["status"], seen["tests"], seen["seed"]) == (
        "c",
        "running",
        1213,
        3,
    )
    assert seen["tests_per_second_now"] == pytest.approx(10.1)
    assert [worker["state"] for worker in seen["workers"]] == ["driving", "lost"]
    assert seen["messages"][0]["text"] == "test 5 broke: [red]odd[/red] [2J"


def test_a_campaign_that_was_run_can_be_watched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit):
        main(["run", "--simulations", "3", "--seed", "3", "--out", "mine", "--json"])
    summary = json.loads(capsys.readouterr().out)
    code, out, _ = call(capsys, "mine", "--json")
    seen = json.loads(out)
    assert (code, seen["status"]) == (0, "finished")
    for name in ("simulations", "passed", "failed", "invalid", "errors", "min_moobd", "seed"):
        assert seen[name] == summary[name]


@pytest.mark.parametrize(
    ("folder", "words"), [("nowhere", "does not exist"), ("empty", "holds no campaign")]
)
def test_a_folder_without_a_log_is_a_mistake(
    campaign: Path, capsys: pytest.CaptureFixture[str], folder: str, words: str
) -> None:
    Path("empty").mkdir()
    code, out, err = call(capsys, folder)
    assert (code, out) == (2, "")
    assert err.startswith(f"frenetic: {folder} {words}")
    assert err.count("\n") == 1


def test_a_campaign_of_an_older_version_is_told_apart(
    campaign: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("old").mkdir()
    Path("old", "campaign.sqlite").touch()
    code, _, err = call(capsys, "old")
    assert code == 2
    assert "made before campaigns had one" in err


@pytest.mark.parametrize("interval", ["0", "soon", "1e30h", "99999999999999h"])
def test_an_odd_interval_is_a_mistake(
    campaign: Path, capsys: pytest.CaptureFixture[str], interval: str
) -> None:
    code, out, err = call(capsys, "c", "--interval", interval)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1


# Until the end


@contextmanager
def watching(folder: Path, **streams: Any) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, which is killed if it takes too long."""
    command = [sys.executable, "-m", "frenetic", "watch", str(folder), "--interval", "0.05"]
    environment = os.environ | {
        "PYTHONIOENCODING": "utf-8",
        "TERM": "xterm-256color",
        "COLUMNS": "80",
        "LINES": "30",
    }
    environment.pop("NO_COLOR", None)
    with subprocess.Popen(
        command,
        env=environment,
        text=True,
        encoding="utf-8",
        **({"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams),
    ) as process:
        timer = threading.Timer(LIMIT, process.kill)
        timer.start()
        try:
            yield process
        finally:
            timer.cancel()
            if process.poll() is None and sys.exc_info()[0] is not None:
                process.kill()


def read_until(stream: IO[str] | None, words: str) -> list[str]:
    assert stream is not None
    lines = []
    for line in stream:
        lines.append(line.rstrip("\n"))
        if words in line:
            return lines
    raise AssertionError(f"{words!r} did not come, but {lines}")


@pytest.mark.parametrize(
    ("event", "code"), [(Event.FINISHED, 0), (Event.INTERRUPTED, 1), (Event.GAVE_UP, 1)]
)
def test_it_ends_with_the_campaign_and_says_how(
    campaign: Path, capsys: pytest.CaptureFixture[str], event: Event, code: int
) -> None:
    end(campaign, event)
    ended, out, err = call(capsys, "c")
    assert f"status     {event.replace('_', ' ')}\n" in out
    assert (ended, err) == (code, "")


def test_it_follows_line_by_line_until_the_campaign_ends(campaign: Path) -> None:
    with watching(campaign) as process:
        assert read_until(process.stdout, "test 5 broke")[0] == "campaign   c"
        with CampaignLog(campaign) as log:
            log.progress(progress(20))
            (line,) = read_until(process.stdout, "2021 tests")
            assert line == (
                "20.0% after 3:20, 13:20 left: 2021 tests of 1100 different roads: 1800 passed,"
                " 200 failed, 20 invalid, 1 error; 3 dropped, best MOOBD -1.25 m, 10.1 tests/s"
            )
            log.write(Event.WORKER_LOST, "worker 1 was lost", level="warning")
            (line,) = read_until(process.stdout, "worker 1")
            assert line.endswith(" warning: worker 1 was lost")
        end(campaign, Event.GAVE_UP)
        out, err = process.communicate()
    assert "status     gave up" in out
    assert err == ""
    assert process.returncode == 1


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent by a POSIX signal here")
def test_ctrl_c_leaves_the_campaign_alone(campaign: Path) -> None:
    before = (campaign / LOG).read_bytes()
    with watching(campaign) as process:
        read_until(process.stdout, "test 5 broke")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert process.returncode == 130
    assert err.strip() == "frenetic: interrupted"
    assert (campaign / LOG).read_bytes() == before


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX terminal")
def test_on_a_terminal_there_is_one_screen_that_changes(campaign: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    with watching(campaign, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        shown = b""
        has_ended = False
        while True:
            try:
                data = os.read(ours, 65536)
            except OSError:  # how Linux says that the other side is closed
                break
            if not data:
                break
            shown += data
            if b"bench-2" in shown and not has_ended:
                has_ended = True
                end(campaign)
        process.wait(LIMIT)
    os.close(ours)
    assert process.returncode == 0
    text = shown.decode("utf-8")
    assert text.index("running") < text.index("\x1b[1A") < text.index("finished")
    assert "\x1b[?25h" in text  # the cursor is there again


# The screen


def look(folder: Path, *, silent: bool = False) -> CampaignState:
    times = iter([0.0, 0.0, SILENT_AFTER + 20.0])
    watcher = CampaignWatcher(folder, clock=lambda: next(times))
    state = watcher.look()
    return watcher.look() if silent else state


def screen(state: CampaignState, folder: Path, width: int = 80, encoding: str = "utf-8") -> str:
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="replace")
    console = Console(file=file, width=width, force_terminal=True, color_system=None)
    console.print(live_view(state, folder, console, datetime.now(UTC)))
    file.seek(0)
    return file.read()


@pytest.mark.parametrize("width", [60, 80, 100, 200])
@pytest.mark.parametrize("workers", [1, 3, 8, 40])
def test_the_screen_fits_its_terminal(tmp_path: Path, width: int, workers: int) -> None:
    begin(tmp_path, workers=workers)
    rows = screen(look(tmp_path), Path("x" * 70) / "c", width).splitlines()
    assert {len(row) for row in rows} == {min(width, 100)}
    assert len(rows) <= 30


def test_the_screen_says_what_matters(campaign: Path) -> None:
    text = screen(look(campaign), campaign)
    for words in (
        "running  c ",
        "Frenetic, Planner, EmbeddedSimulator, seed 3, budget 5000 simulations or",
        "12.0%  2:00, 14:40 left",
        "1213 tests of 1100 different roads: 1080 passed, 120 failed, 12 invalid, 1",
        "best MOOBD -1.25 m, ",
        "10.1 tests/s overall",
        "failures over time",
        "worker 2  lost     1:05",
        "test 5 broke: [red]odd[/red] [2J",
        "process 4711 on bench-2",
    ):
        assert words in text


def test_of_many_workers_the_lost_ones_are_seen(tmp_path: Path) -> None:
    begin(tmp_path, workers=40)
    text = screen(look(tmp_path), tmp_path)
    assert "worker 40  lost" in text
    assert "worker 20" not in text
    assert "and 28 more; of all 40: 39 driving, 1 lost" in text


def test_before_there_is_anything_to_tell_the_screen_is_calm(tmp_path: Path) -> None:
    (tmp_path / LOG).touch()
    assert "the log does not say anything yet" in screen(look(tmp_path), tmp_path)


def test_a_terminal_without_unicode_gets_ascii(campaign: Path) -> None:
    text = screen(look(campaign), campaign, encoding="ascii")
    assert "@@@@" in text
    assert "??" not in text


# Is it still running?


def test_silence_is_asked_about(campaign: Path) -> None:
    state = look(campaign, silent=True)
    question = "no sign of life for 3:20: is it still running?"
    assert doubt(state, datetime.now(UTC)) == question
    assert question in screen(state, campaign)


def test_an_old_last_line_is_mentioned_while_nothing_better_is_known(campaign: Path) -> None:
    watcher = CampaignWatcher(campaign)
    state = watcher.look()
    now = datetime.now(UTC)
    later = now + timedelta(hours=11)
    assert doubt(state, now) == ""
    assert doubt(state, later).startswith("the last line is 11:00:0")
    with CampaignLog(campaign) as log:
        log.progress(progress(13))
    assert doubt(watcher.look(), later) == ""  # it lives: one of the clocks is wrong
    end(campaign)
    assert doubt(CampaignWatcher(campaign).look(), later) == ""


def test_a_log_that_cannot_be_read_any_more_is_mentioned(campaign: Path) -> None:
    watcher = CampaignWatcher(campaign)
    watcher.look()
    (campaign / LOG).unlink()
    assert doubt(watcher.look(), datetime.now(UTC)).startswith("the log cannot be read: ")


# Bars


def test_bars_show_whatever_is_there() -> None:
    assert sparkline([0, 1, 4, 8]) == (" ▁▄█",)
    assert sparkline([0, 0.001, 1000]) == (" ▁█",)
    assert sparkline([0, 1, 4, 8], rows=2) == ("   █", " ▂██")
    assert sparkline([0, 0]) == ("  ",)
    assert sparkline([]) == ("",)
    assert sparkline([0, 9], ascii_only=True) == (" @",)


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_higher_values_have_higher_bars(rows: int) -> None:
    bars = sparkline(list(np.linspace(0.0, 5.0, 100)), rows=rows)
    heights = [sum(" ▁▂▃▄▅▆▇█".index(row[k]) for row in bars) for k in range(100)]
    assert heights == sorted(heights)
    assert (heights[0], heights[-1]) == (0, 8 * rows)


# As a page


def test_page_is_served_until_ctrl_c(
    campaign: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("frenetic.cli.watch.time.sleep", interrupt)
    before = (campaign / LOG).read_bytes()
    code, out, err = call(capsys, "c", "--serve")
    assert (code, err) == (0, "")
    first, reach, state, last = out.splitlines()
    assert first.startswith("Live report: http://127.0.0.1:")
    assert reach.startswith("Only this computer reaches it. Ctrl-C closes it")
    assert state == "c: running"
    assert last == "The page is closed."
    assert (campaign / LOG).read_bytes() == before


def test_busy_port_is_a_mistake(campaign: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        code, out, err = call(capsys, "c", "--serve", "--port", str(port))
    assert (code, out) == (2, "")
    assert err.startswith(f"frenetic: cannot listen on port {port} of 127.0.0.1: ")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "options", [["--port", "8000"], ["--serve", "--once"], ["--serve", "--port", "70000"]]
)
def test_odd_options_of_a_page_are_a_mistake(
    campaign: Path, capsys: pytest.CaptureFixture[str], options: list[str]
) -> None:
    code, out, err = call(capsys, "c", *options)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
