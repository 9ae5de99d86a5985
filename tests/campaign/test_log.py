from __future__ import annotations

import errno
import json
import logging
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from io import FileIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.campaign import log as log_module
from frenetic.campaign.log import (
    FIRST,
    LOG,
    MAX_LINE,
    PROGRESS_INTERVAL,
    RETRY_INTERVAL,
    THINNED,
    CampaignLog,
    Event,
    WorkerState,
)
from frenetic.campaign.progress import Progress

SOME = Progress(
    invalid=4,
    passed=5,
    failed=2,
    errors=1,
    dropped=3,
    min_moobd=-1.5,
    roads=11,
    seconds=60.0,
)


class Clock:
    """A clock that goes when it is told to."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def log(tmp_path: Path, clock: Clock) -> Iterator[CampaignLog]:
    with CampaignLog(tmp_path, clock=clock) as opened:
        yield opened


def refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no JSON")


def lines(folder: Path) -> list[dict[str, Any]]:
    """The lines of a log, each of which has to be one whole JSON object, strictly read."""
    text = (folder / LOG).read_bytes().decode("utf-8")
    assert text == "" or text.endswith("\n")
    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def events(folder: Path) -> list[str]:
    return [line["event"] for line in lines(folder)]


# What a line looks like


def test_every_line_begins_with_the_same_keys(tmp_path: Path, log: CampaignLog) -> None:
    before = datetime.now(UTC) - timedelta(milliseconds=1)
    log.write(Event.TEST_FAILED, "test 7 failed", test=7, moobd=-0.25)
    log.write(Event.WORKER_LOST, "worker 2\nwas lost", level="warning", worker="worker 2")
    failed, lost = lines(tmp_path)
    assert list(failed) == ["time", "level", "event", "message", "test", "moobd"]
    assert failed["time"].endswith("+00:00")
    assert len(failed["time"]) == len("2026-01-01T00:00:00.000+00:00")
    assert before <= datetime.fromisoformat(failed["time"]) <= datetime.now(UTC)
    del failed["time"], lost["time"]
    assert failed == {
        "level": "info",
        "event": "test_failed",
        "message": "test 7 failed",
        "test": 7,
        "moobd": -0.25,
    }
    assert lost == {
        "level": "warning",
        "event": "worker_lost",
        "message": "worker 2 was lost",
        "worker": "worker 2",
    }


def test_a_field_cannot_replace_a_first_key(tmp_path: Path, log: CampaignLog) -> None:
    log.write("odd", "a line", time=3.5)
    (line,) = lines(tmp_path)
    assert line["time_"] == 3.5
    assert datetime.fromisoformat(line["time"])


class Unreadable:
    def __repr__(self) -> str:
        raise RuntimeError("no")


def test_what_is_no_json_becomes_some(tmp_path: Path, log: CampaignLog) -> None:
    endless: list[Any] = []
    endless.append(endless)
    odd: dict[str, Any] = {
        "nan": float("nan"),
        "infinite": [1.0, -float("inf")],
        "numbers": {"real": np.float32(0.5), "whole": np.int64(3), 7: True},
        "seed": 2**127,
        "path": Path("a") / "b",
        "unreadable": Unreadable(),
        "half": "a\ud800b",
        "endless": endless,
        "event_of": Event.LOG,
    }
    log.write("odd", "odd fields", **odd)
    (line,) = lines(tmp_path)
    assert line["nan"] is None
    assert line["infinite"] == [1.0, None]
    assert line["numbers"] == {"real": 0.5, "whole": 3, "7": True}
    assert line["seed"] == hex(2**127)
    assert line["path"] == str(Path("a") / "b")
    assert line["unreadable"] == "<Unreadable>"
    assert line["half"] == "a\ufffdb"
    assert line["event_of"] == "log"
    assert "endless" in line


CHARACTERS = st.integers(0, 0x10FFFF).map(chr) | st.sampled_from('a"\\\n\x1b\x9b\u2028\ud800')
TEXTS = st.lists(CHARACTERS, max_size=20).map("".join)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=10,
)


@given(TEXTS, TEXTS, st.dictionaries(TEXTS, JSON, max_size=4))
def test_whatever_is_written_is_one_line_of_json_that_a_terminal_can_show(
    tmp_path_factory: pytest.TempPathFactory, event: str, message: str, fields: dict[str, Any]
) -> None:
    folder = tmp_path_factory.mktemp("log")
    fields = {k: v for k, v in fields.items() if k not in ("self", "event", "message", "level")}
    with CampaignLog(folder) as log:
        log.write(event, message, **fields)
        log.write("after", "it")
    first, second = lines(folder)  # splits wherever Python knows the end of a line
    assert list(first)[:4] == ["time", "level", "event", "message"]
    assert second["event"] == "after"
    text = (folder / LOG).read_text(encoding="utf-8")
    assert not set(text) & {"\x1b", "\x7f", "\x9b", "\u2028", "\u202e"}


def test_texts_are_cut_in_the_middle(tmp_path: Path, log: CampaignLog) -> None:
    log.write("odd", "m" * 100_000, traceback="first" + "x" * 1_000_000 + "last")
    (line,) = lines(tmp_path)
    assert len(line["message"]) < 5000
    assert len(line["traceback"]) < 5000
    assert line["traceback"].startswith("first")
    assert line["traceback"].endswith("last")


def test_a_line_that_is_too_long_loses_its_fields(tmp_path: Path, log: CampaignLog) -> None:
    log.write("odd", "much to say", texts=["x" * 4000] * 900, number=3)
    (line,) = lines(tmp_path)
    assert line["message"] == "much to say"
    assert line["left_out"] == ["number", "texts"]
    assert (tmp_path / LOG).stat().st_size < MAX_LINE


# Progress


def test_progress_is_written_first_then_every_interval_or_when_forced(
    tmp_path: Path, log: CampaignLog, clock: Clock
) -> None:
    for tests in range(100):
        log.progress(Progress(passed=tests))
        clock.now += 0.25 * PROGRESS_INTERVAL
    assert [line["tests"] for line in lines(tmp_path)] == list(range(0, 100, 4))
    log.progress(Progress(passed=100), force=True)
    log.progress(Progress(passed=101))
    log.progress(Progress(passed=102), force=True)
    assert [line["tests"] for line in lines(tmp_path)][-2:] == [100, 102]


def test_progress_holds_all_there_is_to_know(tmp_path: Path, log: CampaignLog) -> None:
    workers = {
        "worker 1": WorkerState("worker 1", "driving", 5, 1.25),
        "worker 2": WorkerState("worker 2", "lost", 0, 60.0),
    }
    log.progress(SOME, workers=workers, running=1)
    (line,) = lines(tmp_path)
    assert {name: line[name] for name in list(line)[4:]} == {
        "tests": 12,
        "roads": 11,
        "simulations": 8,
        "passed": 5,
        "failed": 2,
        "invalid": 4,
        "errors": 1,
        "dropped": 3,
        "min_moobd": -1.5,
        "seconds": 60.0,
        "budget_spent": 0.0,
        "tests_per_second": 0.2,
        "running": 1,
        "workers": [
            {"name": "worker 1", "state": "driving", "tests": 5, "seconds_in_state": 1.2},
            {"name": "worker 2", "state": "lost", "tests": 0, "seconds_in_state": 60.0},
        ],
    }
    assert line["message"] == (
        "12 tests of 11 different roads: 5 passed, 2 failed, 4 invalid, 1 error; 3 dropped,"
        " best MOOBD -1.50 m, 0.0% of the budget spent"
    )


def test_of_many_failures_one_of_a_hundred_is_written(tmp_path: Path, log: CampaignLog) -> None:
    for test in range(1, FIRST + 3 * THINNED + 50):
        log.write(Event.TEST_FAILED, f"test {test} failed", test=test)
    log.write(Event.TEST_FAILED, "another level", level="warning")
    written = lines(tmp_path)
    assert [line["test"] for line in written[:FIRST]] == list(range(1, FIRST + 1))
    note, *later, other = written[FIRST:]
    assert "one of 100 lines of test_failed" in note["message"]
    counts = [FIRST + THINNED, FIRST + 2 * THINNED, FIRST + 3 * THINNED]
    assert [line["test"] for line in later] == [line["count"] for line in later] == counts
    assert other["level"] == "warning"


def test_progress_is_never_thinned(tmp_path: Path, log: CampaignLog) -> None:
    for tests in range(FIRST + 50):
        log.progress(Progress(passed=tests), force=True)
    assert [line["tests"] for line in lines(tmp_path)] == list(range(FIRST + 50))


# What can go wrong


@pytest.mark.parametrize("torn", ['{"time": "2026', "{", "\x00\x00"])
def test_a_torn_line_stays_alone(tmp_path: Path, torn: str) -> None:
    with CampaignLog(tmp_path) as log:
        log.write("first", "whole")
    with (tmp_path / LOG).open("a", encoding="utf-8") as file:
        file.write(torn)
    with CampaignLog(tmp_path) as log:
        log.write("second", "whole")
        log.write("third", "whole")
    first, half, second, third, end = (tmp_path / LOG).read_text(encoding="utf-8").split("\n")
    assert half == torn
    assert [json.loads(line)["event"] for line in (first, second, third)] == [
        "first",
        "second",
        "third",
    ]
    assert end == ""


class SmallDisk(FileIO):
    """A file on a disk that has room for so many more bytes; it takes what it can, as disks do."""

    room = 0

    def write(self, data: Any) -> int:
        if not SmallDisk.room:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        taken = min(len(data), SmallDisk.room)
        SmallDisk.room -= taken
        return super().write(data[:taken])


@pytest.mark.parametrize("room", [0, 1, 50, 170])
def test_a_full_disk_costs_lines_and_nothing_else(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    monkeypatch.setattr(log_module, "FileIO", SmallDisk)
    SmallDisk.room = 1000
    with CampaignLog(tmp_path, clock=clock) as log:
        log.write("before", "there is room")
        SmallDisk.room = room
        for number in range(5):
            log.write("during", "there is not enough room for a line as long as this", n="x" * 100)
            clock.now += number
        SmallDisk.room = 10_000
        log.write("soon", "not tried again so soon")
        clock.now += RETRY_INTERVAL
        log.write("after", "there is room again")
        assert log.lost_lines == 6
    first, *half, note, last = (tmp_path / LOG).read_text(encoding="utf-8").splitlines()
    assert [len(part) for part in half] == ([room] if room else [])
    whole = [json.loads(line) for line in (first, note, last)]
    assert [line["event"] for line in whole] == ["before", "log", "after"]
    assert whole[1]["message"] == "6 lines are missing here, they could not be written"
    assert whole[1]["reason"] == os.strerror(errno.ENOSPC)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's always full disk")
def test_a_disk_that_is_really_full(tmp_path: Path) -> None:
    (tmp_path / LOG).symlink_to("/dev/full")
    with CampaignLog(tmp_path) as log:
        for _ in range(3):
            log.write("any", "thing")
        log.progress(SOME)
        assert log.lost_lines == 4


def test_the_last_line_is_tried_at_once(
    tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(log_module, "FileIO", SmallDisk)
    SmallDisk.room = 0
    with CampaignLog(tmp_path, clock=clock) as log:
        log.write("any", "thing")
        SmallDisk.room = 10_000
        log.write(Event.FINISHED, "done")
    assert events(tmp_path) == ["log", "finished"]


def test_a_folder_that_is_not_there_is_waited_for(tmp_path: Path, clock: Clock) -> None:
    folder = tmp_path / "c"
    with CampaignLog(folder, clock=clock) as log:
        log.write("early", "nobody sees it")
        folder.mkdir()
        clock.now += RETRY_INTERVAL
        log.write("late", "there it is")
    assert events(folder) == ["log", "late"]


@pytest.mark.skipif(sys.platform == "win32", reason="an open file keeps its folder there")
def test_a_folder_that_vanishes_and_comes_back(tmp_path: Path, clock: Clock) -> None:
    folder = tmp_path / "c"
    folder.mkdir()
    with CampaignLog(folder, clock=clock) as log:
        log.write("first", "into the folder")
        shutil.rmtree(folder)
        clock.now += RETRY_INTERVAL
        log.write("second", "into nothing")
        assert log.lost_lines == 1
        folder.mkdir()
        clock.now += RETRY_INTERVAL
        log.write("third", "into the new one")
    assert events(folder) == ["log", "third"]


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be removed")
def test_a_log_that_somebody_removed_is_begun_anew(tmp_path: Path, clock: Clock) -> None:
    with CampaignLog(tmp_path, clock=clock) as log:
        log.write("first", "line")
        (tmp_path / LOG).unlink()
        clock.now += RETRY_INTERVAL
        log.write("second", "line")
    assert events(tmp_path) == ["second"]


def test_a_closed_log_stays_as_it_is(tmp_path: Path, clock: Clock) -> None:
    log = CampaignLog(tmp_path, clock=clock)
    log.write("first", "line")
    log.close()
    log.close()
    clock.now += 10 * RETRY_INTERVAL
    log.write(Event.FINISHED, "too late")
    log.progress(SOME, force=True)
    assert events(tmp_path) == ["first"]


def test_threads_do_not_mix_their_lines(tmp_path: Path, log: CampaignLog) -> None:
    def write(name: str) -> None:
        for number in range(100):
            log.write(name, "x" * 3000, number=number)

    threads = [threading.Thread(target=write, args=(f"thread_{k}",)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    written = lines(tmp_path)
    assert len(written) == 400
    for k in range(4):
        assert [x["number"] for x in written if x["event"] == f"thread_{k}"] == list(range(100))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no forking here")
def test_a_forked_process_leaves_the_log_alone(tmp_path: Path) -> None:
    script = """
import os, sys
from pathlib import Path
from frenetic.campaign.log import CampaignLog

log = CampaignLog(Path(sys.argv[1]))
log.write("parent", "before")
child = os.fork()
if not child:
    log.write("child", "hello")
    log.close()
    os._exit(0)
os.waitpid(child, 0)
log.write("parent", "after")
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", script, str(tmp_path)], check=True)
    assert events(tmp_path) == ["parent", "parent"]


# Python's logging


@pytest.fixture
def logger(log: CampaignLog) -> Iterator[logging.Logger]:
    logger = logging.getLogger("frenetic.test_log")
    handler = log.handler()
    logger.addHandler(handler)
    yield logger
    logger.removeHandler(handler)
    logger.setLevel(logging.NOTSET)


def test_warnings_of_the_library_become_lines(tmp_path: Path, logger: logging.Logger) -> None:
    logger.info("unheard")  # a logger takes no less than warnings by default
    logger.warning("the tyre of %s is flat", "car 3")
    logger.setLevel(logging.DEBUG)
    logger.info("heard")
    logger.debug("unheard, too")
    logger.critical("over")
    written = [(line["level"], line["event"], line["message"]) for line in lines(tmp_path)]
    assert written == [
        ("warning", "log", "the tyre of car 3 is flat"),
        ("info", "log", "heard"),
        ("error", "log", "over"),
    ]
    assert {line["logger"] for line in lines(tmp_path)} == {"frenetic.test_log"}


def test_an_exception_brings_its_traceback(tmp_path: Path, logger: logging.Logger) -> None:
    try:
        raise ValueError("bad \x1b[31m news")
    except ValueError:
        logger.exception("it broke")
    (line,) = lines(tmp_path)
    assert (line["level"], line["message"]) == ("error", "it broke")
    assert line["traceback"].startswith("Traceback (most recent call last)")
    assert line["traceback"].endswith("ValueError: bad \x1b[31m news\n")
    assert "\x1b" not in (tmp_path / LOG).read_text(encoding="utf-8")


def test_a_record_that_does_not_fit_together_is_written_as_it_is(
    tmp_path: Path, log: CampaignLog
) -> None:
    record = logging.LogRecord("frenetic", logging.WARNING, "", 1, "%d of %d", ("one",), None)
    log.handler().handle(record)
    (line,) = lines(tmp_path)
    assert line["message"] == "%d of %d"
