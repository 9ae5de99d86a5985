"""``frenetic show --follow``: what it shows, where, and with which exit code."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import pytest
from events import on_test
from paced import campaign, paced
from rich.console import Console

from frenetic.campaign.log import LOG, WorkerState
from frenetic.campaign.state import CampaignState, Follower, Line, Status
from frenetic.cli import follow, main

LIMIT = 120.0  # s after which a test that waits for another process fails


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int | str | None, str, str]:
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(["show", *arguments, "--follow"])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


@contextmanager
def following(folder: Path, **streams: Any) -> Iterator[subprocess.Popen[str]]:
    """The command in a process of its own, which is killed if it takes too long."""
    command = [sys.executable, "-m", "frenetic", "show", str(folder), "--follow"]
    environment = os.environ | {"PYTHONIOENCODING": "utf-8", "TERM": "xterm-256color"}
    environment |= {"COLUMNS": "80", "LINES": "30"}
    with subprocess.Popen(
        command,
        env=environment,
        text=True,
        **({"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | streams),
    ) as process:
        timer = threading.Timer(LIMIT, process.kill)
        timer.start()
        try:
            yield process
        finally:
            timer.cancel()
            process.kill()


def read_until(stream: IO[str] | None, words: str) -> str:
    assert stream is not None
    lines = []
    for line in stream:
        lines.append(line)
        if words in line:
            return line
    raise AssertionError(f"{words!r} did not come, but {lines}")


# Plain lines


def test_a_finished_campaign_is_shown_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = campaign(tmp_path).run()
    code, out, err = call(capsys, str(tmp_path))
    assert (code, err) == (0, "")
    facts = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert facts["status"] == "finished"
    assert facts["search"].startswith("random, DummyDriver, DummySimulator, seed 2, process ")
    assert facts["budget"].startswith("100.0% spent, ")
    assert facts["results"] == summary.in_words()
    assert "tests/s overall, best MOOBD -" in facts["rate"]


def test_an_interrupted_campaign_is_no_success(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = campaign(tmp_path)
    one.run(on_event=on_test(lambda test: one.stop()))
    code, out, err = call(capsys, str(tmp_path))
    assert (code, err) == (1, "")
    assert "status     interrupted\n" in out


def test_it_follows_until_the_campaign_finishes(tmp_path: Path) -> None:
    with paced(tmp_path) as running, following(tmp_path) as process:
        read_until(process.stdout, "status     running")
        running.go_on()
        running.finish()
        read_until(process.stdout, "status     finished")
        _, err = process.communicate()
    assert (process.returncode, err) == (0, "")


def test_it_says_that_the_campaign_was_killed(tmp_path: Path) -> None:
    with paced(tmp_path) as running, following(tmp_path) as process:
        read_until(process.stdout, "status     running")
        running.kill()
        line = read_until(process.stdout, "status     killed")
        assert line.endswith(f"frenetic resume {tmp_path} goes on\n")
        _, err = process.communicate()
    assert (process.returncode, err) == (1, "")


@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent by a POSIX signal here")
def test_ctrl_c_leaves_and_the_campaign_goes_on(tmp_path: Path) -> None:
    with paced(tmp_path) as running:
        with following(tmp_path) as process:
            read_until(process.stdout, "status     running")
            process.send_signal(signal.SIGINT)
            _, err = process.communicate()
        assert (process.returncode, err.strip()) == (130, "frenetic: interrupted")
        running.finish()
    assert Follower(tmp_path).look().status is Status.FINISHED


def test_news_is_printed_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Warnings as they come, and progress now and then."""
    campaign(tmp_path).run()
    now = replace(Follower(tmp_path).look(), status=Status.RUNNING)
    first, second = (Line("log", level="warning", message=text) for text in ("one", "two"))
    looks = [now, replace(now, messages=(first,)), replace(now, messages=(first, second))]
    states = iter([*looks, looks[-1], replace(looks[-1], status=Status.GAVE_UP)])
    monkeypatch.setattr(Follower, "look", lambda self: next(states))
    monkeypatch.setattr(follow, "INTERVAL", 0.0)
    monkeypatch.setattr(follow, "PLAIN_INTERVAL", 0.0)
    code, out, _ = call(capsys, str(tmp_path))
    assert code == 1
    news = [line.split()[-1] for line in out.splitlines() if "warning:" in line]
    assert news == ["one", "two"]
    assert sum(line.startswith(f"{now.summary.in_words()}, best") for line in out.split("\n")) == 3
    assert "status     gave up\n" in out


# As JSON


@pytest.mark.parametrize("status", [Status.FINISHED, Status.KILLED])
def test_json_is_one_object_and_no_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], status: Status
) -> None:
    with paced(tmp_path) as process:
        (process.finish if status is Status.FINISHED else process.kill)()
    code, out, err = call(capsys, str(tmp_path), "--json")
    assert (code, err) == (0, "")
    shown = json.loads(out)
    assert (shown["folder"], shown["status"], shown["seed"]) == (str(tmp_path), status, 2)
    assert shown["tests"] == (20 if status is Status.FINISHED else 1)


# On a terminal


@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX terminal")
def test_on_a_terminal_there_is_one_screen_that_changes(tmp_path: Path) -> None:
    import pty

    ours, theirs = pty.openpty()
    with paced(tmp_path) as running, following(tmp_path, stdout=theirs, stderr=theirs) as process:
        os.close(theirs)
        shown, has_ended = b"", False
        while True:
            try:
                data = os.read(ours, 65536)
            except OSError:  # how Linux says that the other side is closed
                break
            if not data:
                break
            shown += data
            if b"random" in shown and not has_ended:
                has_ended = True
                running.finish()
        process.wait(LIMIT)
    os.close(ours)
    assert process.returncode == 0
    text = shown.decode("utf-8")
    assert text.index("running") < text.index("\x1b[1A") < text.rindex("finished")
    assert "\x1b[?25h" in text  # the cursor is there again


@pytest.fixture(scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> CampaignState:
    """A campaign that runs with 40 workers, one of which is lost."""
    folder = tmp_path_factory.mktemp("shown")
    campaign(folder).run()
    workers = [WorkerState(f"worker {k}", "driving", 600, 1.5) for k in range(1, 41)]
    workers[-1] = WorkerState("worker 40", "lost", 7, 65.0)
    broken = Line("test_error", level="error", message="test 5 broke: [red]odd[/red] \x1b[2J")
    return replace(
        Follower(folder).look(),
        status=Status.RUNNING,
        rate=10.1,
        workers=tuple(workers),
        messages=(broken,),
    )


def screen(state: CampaignState, width: int) -> str:
    file = io.StringIO()
    console = Console(file=file, width=width, force_terminal=True, color_system=None)
    console.print(follow.screen(state, Path("x" * 70) / "c", width))
    return file.getvalue()


@pytest.mark.parametrize("width", [60, 80, 100])
def test_the_screen_fits_its_terminal(state: CampaignState, width: int) -> None:
    rows = screen(state, width).splitlines()
    assert {len(row) for row in rows} == {width}
    assert len(rows) <= 30


def test_the_screen_says_what_matters(state: CampaignState) -> None:
    text = screen(state, 100)
    for words in (
        "running  x",
        "100.0% spent, 0:0",
        "20 tests of 20 different roads: ",
        "10.1 tests/s now, ",
        "worker 40  lost     1:05      7",
        "of all 40: 39 driving, 1 lost",
        state.failures[-1].message[:60],
        "test 5 broke: [red]odd[/red] \\x1b[2J",
        "random, DummyDriver, DummySimulator, seed 2, process ",
    ):
        assert words in text, words


def test_of_another_machine_it_says_since_when_nothing_is_known(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign(tmp_path).run()
    lines = [json.loads(line) for line in (tmp_path / LOG).read_text().splitlines()]
    lines[0]["host"] = "bench-2"
    (tmp_path / LOG).write_text("".join(f"{json.dumps(line)}\n" for line in lines[:-1]))

    def leave(seconds: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("frenetic.cli.follow.time.sleep", leave)
    code, out, _ = call(capsys, str(tmp_path))
    assert code == 130
    (status,) = (line for line in out.splitlines() if line.startswith("status"))
    assert status.startswith("status     unknown since ")
    assert status.endswith(": bench-2 may write it")
