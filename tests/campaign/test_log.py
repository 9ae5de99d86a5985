"""The log of a campaign: its lines, two campaigns at once, and logs that cannot be written."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
import threading
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from campaigns import campaign
from events import on_test

from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.log import LOG, CampaignLog, LogEvent
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.testing import DummySimulator


def drift(road: Road) -> float:
    """Sharp roads fail, and the sharpest break the drive."""
    sharpest = abs(road.curvatures).max()
    if sharpest > 0.068:
        raise RuntimeError("too sharp for \x1b[2J this \u2028 simulator")
    return 4.0 if sharpest > 0.05 else 0.5


def search(folder: Path, *, seed: int = 2, simulations: int = 40) -> Campaign:
    strategy, simulator = RandomSearch(seed=seed), DummySimulator(drift)
    return campaign(folder, simulations, strategy=strategy, simulator=simulator)


def log_lines(folder: Path) -> list[dict[str, Any]]:
    """The lines of a log, each of which must be one whole JSON object."""
    text = (folder / LOG).read_bytes().decode("ascii")
    assert text == "" or text.endswith("\n")
    return [json.loads(line) for line in text.splitlines()]


def events_of(event: LogEvent, folder: Path) -> list[dict[str, Any]]:
    return [line for line in log_lines(folder) if line["event"] == event]


def stored(folder: Path, outcome: Outcome) -> dict[int, float | None]:
    with CampaignStore.open(folder) as store:
        return {test.id: test.moobd for test in store.tests(outcome)}


# Lines


def test_the_log_has_a_line_for_each_event(tmp_path: Path) -> None:
    before = datetime.now(UTC) - timedelta(milliseconds=1)
    summary = search(tmp_path).run()
    assert summary.failed > 0
    assert summary.errors > 0
    written = log_lines(tmp_path)
    for line in written:
        assert list(line)[:4] == ["time", "level", "event", "message"]
        assert len(line["time"]) == len("2026-01-01T00:00:00.000+00:00")
        assert before <= datetime.fromisoformat(line["time"]) <= datetime.now(UTC)
    start, *_, progress, end = written
    assert start["event"] == "started"
    assert (start["seed"], start["budget"]["simulations"]) == (2, 40)
    assert start["strategy"]["class"].endswith(":RandomSearch")
    assert start["process_id"] == os.getpid()
    assert start["host"]
    failed = {line["test"]: line["moobd"] for line in events_of(LogEvent.TEST_FAILED, tmp_path)}
    assert failed == stored(tmp_path, Outcome.FAIL)
    broken = events_of(LogEvent.TEST_ERROR, tmp_path)
    assert {line["test"] for line in broken} == set(stored(tmp_path, Outcome.ERROR))
    for line in broken:
        assert line["level"] == "error"
        assert "too sharp for" in line["reason"]
        assert line["traceback"].startswith("Traceback (most recent call last)")
    assert len(events_of(LogEvent.TEST_RETRIED, tmp_path)) == len(broken)
    assert (progress["event"], progress["budget_spent"]) == ("progress", 1)
    assert (progress["tests"], progress["min_moobd"]) == (summary.tests, summary.min_moobd)
    assert end["event"] == "finished"
    expected = json.loads(json.dumps(summary.as_json()))
    assert {name: end[name] for name in expected} == expected


def test_log_messages_of_the_library_become_lines_while_the_campaign_runs(tmp_path: Path) -> None:
    logger = logging.getLogger("frenetic.test_log")

    def complain(test: object) -> None:
        logger.info("unheard, as nobody asked for it")
        logger.warning("the tyre of %s is flat", "car 3")
        try:
            raise ValueError("bad news")
        except ValueError:
            logger.exception("it broke")

    search(tmp_path, simulations=1).run(on_event=on_test(complain))
    logger.warning("too late")
    flat, broke = (line for line in log_lines(tmp_path) if line.get("logger") == logger.name)
    assert (flat["level"], flat["event"], flat["message"]) == (
        "warning",
        "log",
        "the tyre of car 3 is flat",
    )
    assert broke["traceback"].startswith("Traceback (most recent call last)")
    assert broke["traceback"].endswith("ValueError: bad news")


def test_a_line_is_printable_ascii_whatever_its_message(tmp_path: Path) -> None:
    message = "\x1b[2J\x07 \x7f\x9b \u2028\u202e \ud800 \n\r end"
    with CampaignLog(tmp_path) as log:
        log.write(LogEvent.LOG, message, text=message)
        log.write(LogEvent.LOG, "after")
    first, after = log_lines(tmp_path)
    assert (first["message"], first["text"]) == (message, message)
    assert after["message"] == "after"
    assert set((tmp_path / LOG).read_bytes()) <= {ord("\n"), *range(32, 127)}


# Two campaigns at once


def test_two_campaigns_in_two_threads_do_not_mix(tmp_path: Path) -> None:
    both = threading.Barrier(2)

    def run(seed: int) -> None:
        # Their results alternate.
        search(tmp_path / str(seed), seed=seed).run(on_event=on_test(lambda test: both.wait(60.0)))

    threads = [threading.Thread(target=run, args=(seed,)) for seed in (1, 2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed in (1, 2):
        folder = tmp_path / str(seed)
        assert [line["seed"] for line in events_of(LogEvent.STARTED, folder)] == [seed]
        failed = [line["test"] for line in events_of(LogEvent.TEST_FAILED, folder)]
        assert failed == list(stored(folder, Outcome.FAIL))
        assert len(events_of(LogEvent.FINISHED, folder)) == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no forking here")
def test_a_forked_process_writes_nothing_into_the_log(tmp_path: Path) -> None:
    script = """
import os, sys
from pathlib import Path
from frenetic.campaign.log import CampaignLog, LogEvent

with CampaignLog(Path(sys.argv[1])) as log:
    log.write(LogEvent.NOTICE, "before")
    child = os.fork()
    if not child:
        log.write(LogEvent.NOTICE, "child")
        sys.exit(0)
    os.waitpid(child, 0)
    log.write(LogEvent.NOTICE, "after")
"""
    subprocess.run([sys.executable, "-W", "ignore", "-c", script, str(tmp_path)], check=True)
    assert [line["message"] for line in log_lines(tmp_path)] == ["before", "after"]


# A log that cannot be written


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be removed")
@pytest.mark.parametrize("is_replaced", [False, True])
def test_a_log_that_is_removed_loses_lines_but_the_campaign_goes_on(
    tmp_path: Path, is_replaced: bool
) -> None:
    def remove(test: Any) -> None:
        if test.result_number == 10:
            (tmp_path / LOG).unlink()
            if is_replaced:  # by a folder, which cannot be opened
                (tmp_path / LOG).mkdir()

    summary = search(tmp_path).run(on_event=on_test(remove))
    assert summary.simulations == 40
    if not is_replaced:  # the log begins anew
        failed = {line["test"] for line in events_of(LogEvent.TEST_FAILED, tmp_path)}
        assert failed < set(stored(tmp_path, Outcome.FAIL))
        assert log_lines(tmp_path)[-1]["tests"] == summary.tests


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's always full disk")
def test_a_full_disk_loses_lines_but_the_campaign_goes_on(tmp_path: Path) -> None:
    (tmp_path / LOG).symlink_to("/dev/full")
    assert search(tmp_path).run().simulations == 40
    assert logging.getLogger("frenetic").handlers == []
