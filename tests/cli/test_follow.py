"""``frenetic show --follow``: its lines, its terminal and its exit codes."""

from __future__ import annotations

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

from frenetic.campaign.log import CampaignLog, LogEvent
from frenetic.campaign.status import News, Status, read_state
from frenetic.cli import follow, main

LIMIT = 120.0  # s after which a test that waits for another process fails


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int | str | None, str, str]:
    capsys.readouterr()
    with pytest.raises(SystemExit) as stop:
        main(["show", *arguments, "--follow"])
    out, err = capsys.readouterr()
    return stop.value.code, out, err


@contextmanager
def following_process(folder: Path, **streams: Any) -> Iterator[subprocess.Popen[str]]:
    """Run the command in another process, and kill the process after LIMIT."""
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


def test_a_finished_campaign_is_shown_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    summary = campaign(tmp_path).run()
    code, out, err = call(capsys, str(tmp_path))
    assert (code, err) == (0, "")
    facts = dict(line.split(maxsplit=1) for line in out.splitlines())
    assert facts["status"] == "finished"
    assert out.count("status ") == 1
    assert facts["search"] == "random, DummyDriver, DummySimulator, seed 2"
    assert facts["budget"].startswith("100.0% spent, ")
    assert facts["results"] == summary.as_text()
    code, out, err = call(capsys, str(tmp_path), "--json")
    assert (code, err) == (0, "")
    shown = json.loads(out)
    assert (shown["folder"], shown["status"], shown["tests"]) == (str(tmp_path), "finished", 20)


def test_an_interrupted_campaign_exits_1_and_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted = campaign(tmp_path)
    interrupted.run(on_event=on_test(lambda test: interrupted.stop()))
    code, out, err = call(capsys, str(tmp_path))
    assert (code, err) == (1, "")
    advice = "from Python, where it was started: Campaign.resume()"
    assert f"status     interrupted; go on: {advice}\n" in out
    code, out, err = call(capsys, str(tmp_path), "--json")
    assert (code, json.loads(out)["status"]) == (0, "interrupted")


@pytest.mark.heavy
def test_follow_ends_when_the_campaign_finishes(tmp_path: Path) -> None:
    with paced(tmp_path) as running, following_process(tmp_path) as process:
        read_until(process.stdout, f"status     running in process {running.id}")
        running.go_on()
        running.finish()
        read_until(process.stdout, "status     finished")
        _, err = process.communicate()
    assert (process.returncode, err) == (0, "")


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform == "win32", reason="Ctrl-C is sent by a POSIX signal here")
def test_ctrl_c_ends_follow_and_the_campaign_goes_on(tmp_path: Path) -> None:
    with paced(tmp_path) as running:
        with following_process(tmp_path) as process:
            read_until(process.stdout, "status     running")
            process.send_signal(signal.SIGINT)
            _, err = process.communicate()
        assert process.returncode == 130
        assert err.strip().startswith("frenetic: interrupted; to run it again: frenetic show ")
        running.finish()
    assert read_state(tmp_path).status is Status.FINISHED


def test_news_is_printed_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign(tmp_path).run()
    with CampaignLog(tmp_path) as log:
        log.write(LogEvent.NOTICE, "[red]odd[/red] \x1b[2J", level="warning")
    now = replace(read_state(tmp_path), status=Status.RUNNING)
    later = replace(now, news=(*now.news[1:], News("log", level="warning", message="two")))
    states = iter([now, now, later, replace(later, status=Status.GAVE_UP)])
    monkeypatch.setattr(follow, "read_state", lambda folder: next(states))
    monkeypatch.setattr(follow, "LOOK_INTERVAL", 0.0)
    code, out, _ = call(capsys, str(tmp_path))
    assert code == 1
    news = [line.partition("warning: ")[2] for line in out.splitlines() if "warning:" in line]
    assert news == ["[red]odd[/red] \\x1b[2J", "two"]
    assert "status     gave up" in out


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX terminal")
def test_on_a_terminal_lines_are_redrawn_in_place(tmp_path: Path) -> None:
    import pty

    reader, terminal = pty.openpty()
    with (
        paced(tmp_path) as running,
        following_process(tmp_path, stdout=terminal, stderr=terminal) as process,
    ):
        os.close(terminal)
        shown, has_ended = b"", False
        while True:
            try:
                data = os.read(reader, 65536)
            except OSError:  # Linux raises it when the other side is closed
                break
            if not data:
                break
            shown += data
            if b" tests/" in shown and not has_ended:  # a second, minute or hour
                has_ended = True
                running.finish()
        process.wait(LIMIT)
    os.close(reader)
    assert process.returncode == 0
    text = shown.decode("utf-8")
    assert text.index("running") < text.index("\x1b[1A") < text.rindex("finished")
    assert "\x1b[?25h" in text  # the cursor is visible again
