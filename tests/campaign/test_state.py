"""What a look at a campaign says, whatever became of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from campaigns import refused
from events import on_test
from paced import campaign, paced

from frenetic.campaign import CampaignStore
from frenetic.campaign.database import DATABASE, LOCK
from frenetic.campaign.lock import lock_file
from frenetic.campaign.log import LOG, CampaignLog, LogEvent, WorkerState
from frenetic.campaign.state import KEPT, CampaignState, Follower, Status
from frenetic.campaign.summary import Summary
from frenetic.road import Road


def look(folder: Path) -> CampaignState:
    return Follower(folder).look()


def append(folder: Path, *texts: str | bytes) -> None:
    with (folder / LOG).open("ab") as file:
        for text in texts:
            file.write(text.encode() if isinstance(text, str) else text)


def move_to(host: str, folder: Path, *, without_end: bool = False) -> None:
    """Lets a log say that another machine wrote it."""
    lines = [json.loads(line) for line in (folder / LOG).read_text().splitlines()]
    lines[0]["host"] = host
    kept = lines[:-1] if without_end else lines
    (folder / LOG).write_text("".join(f"{json.dumps(line)}\n" for line in kept))


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    campaign(tmp_path / "c").run()
    return tmp_path / "c"


# What became of it


def test_a_finished_campaign(tmp_path: Path) -> None:
    summary = campaign(tmp_path, 80).run()
    state = look(tmp_path)
    assert state.status is Status.FINISHED
    assert (state.rate, state.running, state.workers, state.seconds_left) == (None, 0, (), None)
    assert state.summary.counts_json() == summary.counts_json()
    assert state.summary.budget_spent == 1.0
    assert summary.failed > KEPT
    assert len(state.failures) == KEPT
    assert state.failures[-1].message.startswith("test ")
    shown = json.loads(json.dumps(state.as_json(), allow_nan=False))
    assert (shown["status"], shown["strategy"], shown["driver"], shown["simulator"]) == (
        "finished",
        "random",
        "DummyDriver",
        "DummySimulator",
    )
    assert (shown["seed"], shown["budget"]["simulations"]) == (2, 80)
    assert (shown["failed"], shown["budget_spent"]) == (summary.failed, 1.0)


def test_a_running_campaign_is_seen_result_by_result(tmp_path: Path) -> None:
    with paced(tmp_path) as process:
        follower = Follower(tmp_path)
        for told in range(1, 6):
            state = follower.look()
            assert (state.status, state.summary.told) == (Status.RUNNING, told)
            assert state.start.process_id == process.id
            assert [worker.name for worker in state.workers] == ["this process"]
            process.go_on()
        process.finish()
        assert follower.look().status is Status.FINISHED


def test_a_killed_campaign_is_known_at_once_until_it_is_resumed(tmp_path: Path) -> None:
    with paced(tmp_path) as process:
        process.go_on()
        follower = Follower(tmp_path)
        assert follower.look().status is Status.RUNNING
        process.kill()
        state = follower.look()
    assert (state.status, state.summary.told, state.workers) == (Status.KILLED, 2, ())
    (tmp_path / LOG).unlink()
    assert look(tmp_path).status is Status.KILLED
    seen = []
    campaign(tmp_path).resume(on_event=on_test(lambda test: seen.append(follower.look().status)))
    assert set(seen) == {Status.RUNNING}
    assert follower.look().status is Status.FINISHED


def test_an_interrupted_campaign(tmp_path: Path) -> None:
    one = campaign(tmp_path)
    one.run(on_event=on_test(lambda test: one.stop()))
    assert look(tmp_path).status is Status.INTERRUPTED
    (tmp_path / LOG).unlink()
    assert look(tmp_path).status is Status.INTERRUPTED


def test_a_campaign_that_gave_up(tmp_path: Path) -> None:
    def break_down(road: Road) -> float:
        raise RuntimeError("no\n\x1b[2Jpower")

    one = campaign(tmp_path)
    one.tester.simulator.drift = break_down  # type: ignore[attr-defined]
    with refused():
        one.run()
    state = look(tmp_path)
    assert state.status is Status.GAVE_UP
    last = state.messages[-1]
    assert (last.level, last.event) == ("error", "gave_up")
    assert last.message.isprintable()


# On another machine


def test_of_another_machine_only_the_log_is_read(finished: Path) -> None:
    progress = look(finished).summary
    (finished / DATABASE).write_bytes(b"an open database that another machine writes")
    move_to("elsewhere", finished)
    state = look(finished)
    assert (state.status, state.summary.failed) == (Status.FINISHED, progress.failed)
    move_to("elsewhere", finished, without_end=True)
    state = look(finished)
    assert (state.status, state.summary.failed) == (Status.UNKNOWN, progress.failed)
    assert state.last_time
    with lock_file(finished / LOCK):  # which can be seen through some shares
        assert look(finished).status is Status.RUNNING


# Its log


def test_without_a_log_the_database_tells_the_counts(finished: Path) -> None:
    with_log = look(finished)
    (finished / LOG).unlink()
    state = look(finished)
    assert (state.status, state.start.host, state.failures) == (Status.FINISHED, None, ())
    assert state.summary.counts_json() == with_log.summary.counts_json()


def test_the_rate_is_that_of_the_last_minute_of_a_process(finished: Path) -> None:
    def steps(seconds: range, tests_per_second: int) -> None:
        for second in seconds:
            count = 1000 + tests_per_second * (second - seconds.start)
            log.progress(
                Summary(passed=count, seconds=float(second)),
                workers={"w": WorkerState("w", "driving", 7, 2.5)},
                running=1,
            )

    follower = Follower(finished)
    with lock_file(finished / LOCK), CampaignLog(finished) as log:
        log.write(LogEvent.RESUMED, "resumed")
        assert follower.look().rate is None
        steps(range(0, 300, 5), 1)
        assert follower.look().rate == pytest.approx(1.0)
        steps(range(300, 400, 5), 7)
        state = follower.look()
        assert state.rate == pytest.approx(7.0)
        assert (state.running, state.workers) == (1, (WorkerState("w", "driving", 7, 2.5),))
        log.write(LogEvent.RESUMED, "resumed")
        assert follower.look().rate is None


def test_half_a_line_is_left_until_it_is_whole(finished: Path) -> None:
    follower = Follower(finished)
    line = json.dumps({"event": "log", "level": "warning", "message": "mind the gap"})
    append(finished, line[:20])
    assert follower.look().messages == ()
    append(finished, line[20:], "\n")
    assert [line.message for line in follower.look().messages] == ["mind the gap"]
    assert [line.message for line in follower.look().messages] == ["mind the gap"]


def test_another_log_in_its_place_is_read_from_its_start(finished: Path) -> None:
    follower = Follower(finished)
    follower.look()
    (finished / LOG).rename(finished / "old.log")
    with CampaignLog(finished) as log:
        log.write(LogEvent.NOTICE, "a new log", level="warning")
    assert [line.message for line in follower.look().messages] == ["a new log"]


@pytest.mark.parametrize(
    "line",
    [
        "nonsense",
        '{"time": "2026-01-01T00:00:00',
        "[1, 2]",
        "null",
        "{}",
        '{"event": 3}',
        "[" * 100_000,
        b"\xff\xfe\x00{",
        b"\x00" * 4096,
        '{"event": "progress", "passed": -1}',
        '{"event": "progress", "passed": "many", "running": 0, "workers": []}',
        '{"event": "started", "host": ["elsewhere"]}',
    ],
    ids=lambda line: repr(line[-40:]),
)
def test_lines_that_cannot_be_read_are_skipped(finished: Path, line: str | bytes) -> None:
    before = look(finished)
    append(finished, line, "\n")
    with CampaignLog(finished) as log:
        log.write(LogEvent.NOTICE, "after it", level="warning")
    state = look(finished)
    assert [line.message for line in state.messages] == ["after it"]
    assert (state.start, state.summary) == (before.start, before.summary)


@pytest.mark.parametrize(
    "odd", [{"strategy": 3}, {"driver": {"class": [1]}}, {"seed": 2**80}, {"budget": "all"}]
)
def test_odd_fields_of_a_first_line_hurt_nobody(finished: Path, odd: dict[str, Any]) -> None:
    append(finished, json.dumps({"event": "resumed"} | odd), "\n")
    json.dumps(look(finished).as_json(), allow_nan=False)


# Where there is no campaign


def a_file(folder: Path) -> None:
    folder.write_text("in the way")


@pytest.mark.parametrize("make", [lambda folder: None, a_file, Path.mkdir])
def test_a_folder_without_a_campaign_is_one_line(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    make(tmp_path / "c")
    with refused():
        Follower(tmp_path / "c")


def test_a_damaged_database_is_one_line(finished: Path) -> None:
    follower = Follower(finished)
    CampaignStore.open(finished).close()
    (finished / DATABASE).write_bytes(b"no database at all" * 500)
    with refused():
        follower.look()
