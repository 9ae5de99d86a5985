"""`look`: the state of a campaign that runs, ended, was killed, or is not there."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest
from campaigns import refused
from events import on_test
from paced import campaign, paced

from frenetic.campaign.configuration import OWNER, Owner, owner_of
from frenetic.campaign.database import DATABASE
from frenetic.campaign.log import LOG, CampaignLog, LogEvent
from frenetic.campaign.status import LOG_TAIL, MOST_NEWS, CampaignState, Status, read_state
from frenetic.campaign.store import LOCK
from frenetic.errors import CampaignError
from frenetic.road import Road


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    campaign(tmp_path / "c").run()
    return tmp_path / "c"


def news_of(state: CampaignState) -> list[str]:
    return [line.message for line in state.news if line.event != LogEvent.TEST_FAILED]


# States


def test_a_finished_campaign_has_its_counts_and_latest_failures(tmp_path: Path) -> None:
    summary = campaign(tmp_path, 80).run()
    state = read_state(tmp_path)
    assert (state.status, state.seconds_left) == (Status.FINISHED, None)
    assert state.summary.counts_json() == summary.counts_json()
    assert state.summary.budget_spent == 1.0
    assert summary.failed > MOST_NEWS
    assert {line.event for line in state.news} == {LogEvent.TEST_FAILED}
    assert len(state.news) == MOST_NEWS
    shown = json.loads(json.dumps(state.as_json(), allow_nan=False))
    names = [shown[part] for part in ("status", "strategy", "driver", "simulator", "seed")]
    assert names == ["finished", "random", "DummyDriver", "DummySimulator", 2]
    assert (shown["failed"], shown["budget_spent"]) == (summary.failed, 1.0)
    (tmp_path / LOG).unlink()
    without_log = read_state(tmp_path)
    assert (without_log.status, without_log.news) == (Status.FINISHED, ())


def test_a_look_at_a_running_campaign_counts_each_result(tmp_path: Path) -> None:
    with paced(tmp_path) as process:
        for results in range(1, 6):
            state = read_state(tmp_path)
            assert (state.status, state.summary.result_count) == (Status.RUNNING, results)
            assert state.writer == f"process {process.id}"
            process.go_on()
        process.finish()
        assert read_state(tmp_path).status is Status.FINISHED


def test_a_look_says_killed_at_once_after_a_kill_until_the_campaign_is_resumed(
    tmp_path: Path,
) -> None:
    with paced(tmp_path) as process:
        process.go_on()
        process.kill()
        state = read_state(tmp_path)
    assert (state.status, state.summary.result_count) == (Status.KILLED, 2)
    statuses = []
    campaign(tmp_path).resume(
        on_event=on_test(lambda test: statuses.append(read_state(tmp_path).status))
    )
    assert set(statuses) == {Status.RUNNING}
    assert read_state(tmp_path).status is Status.FINISHED


def test_the_state_of_a_campaign_of_another_machine_is_unknown(tmp_path: Path) -> None:
    with paced(tmp_path) as process:
        process.kill()
    lock = tmp_path / LOCK
    lock.write_text(" " + json.dumps(json.loads(lock.read_text()) | {"host": "bench-2"}))
    state = read_state(tmp_path)
    assert (state.status, state.writer) == (Status.UNKNOWN, "bench-2")
    campaign(tmp_path).resume()
    assert read_state(tmp_path).status is Status.FINISHED


def test_a_stopped_campaign_is_interrupted(tmp_path: Path) -> None:
    new = campaign(tmp_path)
    new.run(on_event=on_test(lambda test: new.stop()))
    assert read_state(tmp_path).status is Status.INTERRUPTED


def test_a_campaign_whose_simulator_always_breaks_gave_up(tmp_path: Path) -> None:
    def break_down(road: Road) -> float:
        raise RuntimeError("no\n\x1b[2Jpower")

    new = campaign(tmp_path)
    new.tester.simulator.drift = break_down  # type: ignore[attr-defined]
    with refused():
        new.run()
    state = read_state(tmp_path)
    assert state.status is Status.GAVE_UP
    last = state.news[-1]
    assert (last.level, last.event) == ("error", "gave_up")
    assert last.message.isprintable()


# The log


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
        b"\x00" * (2 * LOG_TAIL),
    ],
    ids=lambda line: repr(line[-40:]),
)
def test_lines_that_cannot_be_read_are_skipped(finished: Path, line: str | bytes) -> None:
    with (finished / LOG).open("ab") as file:
        file.write((line.encode() if isinstance(line, str) else line) + b"\n")
    with CampaignLog(finished) as log:
        log.write(LogEvent.NOTICE, "after it", level="warning")
    state = read_state(finished)
    assert (state.status, news_of(state)) == (Status.FINISHED, ["after it"])


# No campaign


def write_file(folder: Path) -> None:
    folder.write_text("in the way")


@pytest.mark.parametrize("make", [lambda folder: None, write_file, Path.mkdir])
def test_a_folder_without_a_campaign_is_refused_in_one_line(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    make(tmp_path / "c")
    with refused():
        read_state(tmp_path / "c")


def test_a_damaged_database_is_refused_in_one_line(finished: Path) -> None:
    (finished / DATABASE).write_bytes(b"no database at all" * 500)
    with refused():
        read_state(finished)


def test_an_owner_names_the_command_that_goes_on_and_survives_its_entry(tmp_path: Path) -> None:
    owner = Owner(
        summary="is a run of a bench",
        advice="resume the bench",
        resume=("bench", "--resume", "--out"),
        levels_up=2,
    )
    assert owner.command(tmp_path / "wiggly" / "01") == shlex.join(
        ["frenetic", "bench", "--resume", "--out", str(tmp_path)]
    )
    assert Owner(summary="", advice="ask its owner").command(tmp_path) == "ask its owner"
    stored = json.loads(json.dumps(owner.entry()))
    assert owner_of(stored) == owner
    assert owner_of({}) is None
    texts = {"summary": "", "advice": ""}
    for damaged in ({"summary": 3}, {**texts, "levels_up": 99}, {**texts, "time_budget": -1.0}):
        with pytest.raises(CampaignError, match="its owner"):
            owner_of({OWNER: damaged})
