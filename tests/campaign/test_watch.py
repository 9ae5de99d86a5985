from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.log import LOG, CampaignLog, Event, WorkerState
from frenetic.campaign.progress import Progress
from frenetic.campaign.watch import (
    KEPT_MESSAGES,
    MAX_LINE,
    MAX_POINTS,
    SILENT_AFTER,
    CampaignWatcher,
    Setup,
    Status,
    require_log,
)
from frenetic.errors import CampaignError
from frenetic.search import RandomSearch
from frenetic.testing import DummyDriver, DummySimulator


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
def watcher(tmp_path: Path, clock: Clock) -> CampaignWatcher:
    return CampaignWatcher(tmp_path, clock=clock)


def progress(seconds: float, passed: int, failed: int = 0, **others: Any) -> Progress:
    return Progress(passed=passed, failed=failed, seconds=seconds, **others)


def write(folder: Path, *happened: Progress | Event) -> None:
    """Lets a process of its own write these, one line each."""
    with CampaignLog(folder) as log:
        for one in happened:
            if isinstance(one, Progress):
                log.progress(one, force=True)
            else:
                log.write(one, f"{one} it has")


def append(folder: Path, *texts: str | bytes) -> None:
    with (folder / LOG).open("ab") as file:
        for text in texts:
            file.write(text.encode() if isinstance(text, str) else text)


# What a log tells


def test_a_campaign_is_seen_as_it_was_logged(tmp_path: Path, watcher: CampaignWatcher) -> None:
    workers = [WorkerState("worker 1", "driving", 7, 2.5), WorkerState("worker 2", "lost", 0, 60.0)]
    now = Progress(
        invalid=3,
        passed=80,
        failed=20,
        errors=1,
        dropped=5,
        min_moobd=-1.25,
        seconds=50.0,
        budget_spent=0.25,
        objective="my (first) own.py:slowest",
        best=0.5,
    )
    with CampaignLog(tmp_path) as log:
        log.write(
            Event.STARTED,
            "started",
            strategy={"class": "frenetic.search.frenetic:Frenetic", "options": {"seed": 4}},
            driver={"class": "a:Noisy", "driver": {"class": "b.c:Planner"}},
            simulator="embedded",
            seed=4,
            budget={"simulations": 400, "time": None, "failures": None},
            host="bench-2",
            process_id=4711,
        )
        log.write(Event.TEST_FAILED, "test 9 failed: too fast", test=9, moobd=-1.25)
        log.write(Event.WORKER_LOST, "worker 2 was lost", level="warning", worker="worker 2")
        log.progress(now, workers={worker.name: worker for worker in workers}, running=1)
        log.write(Event.WORKER_STARTED, "worker 3 started", worker="worker 3")
    state = watcher.look()
    assert state.status is Status.RUNNING
    assert state.setup == Setup(
        strategy="Frenetic",
        driver="Noisy over Planner",
        simulator="embedded",
        seed=4,
        budget=Budget(simulations=400),
        host="bench-2",
        process_id=4711,
    )
    assert state.progress == now
    assert (state.running, state.workers) == (1, tuple(workers))
    assert state.last_failure is not None
    assert state.last_failure.text == "test 9 failed: too fast"
    (message,) = state.messages
    assert (message.level, message.event, message.text) == (
        "warning",
        "worker_lost",
        "worker 2 was lost",
    )
    assert (state.message_count, state.unreadable, state.trouble) == (1, 0, "")
    last = json.loads((tmp_path / LOG).read_text(encoding="utf-8").splitlines()[-1])
    assert state.last_time == last["time"]


def test_a_state_is_one_json_object(tmp_path: Path, watcher: CampaignWatcher) -> None:
    write(tmp_path, Event.STARTED, progress(10.0, 3, 2, budget_spent=0.5), Event.TEST_FAILED)
    seen = json.loads(json.dumps(watcher.look().as_json(), allow_nan=False))
    assert seen["status"] == "running"
    assert (seen["tests"], seen["simulations"], seen["passed"], seen["failed"]) == (5, 5, 3, 2)
    assert (seen["seconds"], seen["seconds_left"]) == (10.0, 10.0)
    assert seen["failures_over_time"] == {"seconds": [10.0], "failed": [2]}
    assert seen["last_failure"]["event"] == "test_failed"


def test_a_real_campaign_is_seen_to_have_finished(tmp_path: Path, watcher: CampaignWatcher) -> None:
    summary = Campaign(
        strategy=RandomSearch(seed=2),
        simulator=DummySimulator(lambda road: 4.0 if abs(road.curvatures).max() > 0.06 else 0.5),
        driver=DummyDriver(),
        budget=Budget(simulations=40),
        folder=tmp_path,
    ).run()
    state = watcher.look()
    assert state.status is Status.FINISHED
    assert state.progress.budget_spent == 1.0
    for name in ("passed", "failed", "invalid", "errors", "dropped", "min_moobd"):
        assert getattr(state.progress, name) == getattr(summary, name)
    assert state.setup.strategy == "RandomSearch"
    assert state.setup.budget == Budget(simulations=40)
    assert state.unreadable == 0


@pytest.mark.parametrize("end", [Event.FINISHED, Event.INTERRUPTED, Event.GAVE_UP])
def test_an_end_stays_until_the_campaign_goes_on(
    tmp_path: Path, watcher: CampaignWatcher, clock: Clock, end: Event
) -> None:
    write(tmp_path, Event.STARTED, progress(0.0, 0))
    assert watcher.look().status is Status.RUNNING
    write(tmp_path, end)
    assert watcher.look().status is Status(end)
    assert watcher.look().status.is_end
    clock.now += 2 * SILENT_AFTER
    assert watcher.look().status is Status(end)
    write(tmp_path, Event.RESUMED)
    assert watcher.look().status is Status.RUNNING


def test_the_last_warnings_are_kept_and_all_are_counted(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    with CampaignLog(tmp_path) as log:
        for number in range(3 * KEPT_MESSAGES):
            log.write(Event.LOG, f"number {number}", level="error" if number % 2 else "warning")
            log.write(Event.LOG, "nothing to worry about")
    state = watcher.look()
    assert state.message_count == 3 * KEPT_MESSAGES
    assert [message.text for message in state.messages] == [
        f"number {number}" for number in range(2 * KEPT_MESSAGES, 3 * KEPT_MESSAGES)
    ]


# Rates and failures over time


def test_the_rate_now_is_that_of_the_last_minute(tmp_path: Path, watcher: CampaignWatcher) -> None:
    slow = [progress(5.0 * k, 5 * k) for k in range(25)]  # until 120 s, 1 test/s
    fast = [progress(120.0 + 5.0 * k, 120 + 50 * k) for k in range(1, 13)]  # 10 tests/s
    write(tmp_path, Event.STARTED, *slow)
    assert watcher.look().rate == pytest.approx(1.0)
    write(tmp_path, *fast[:6])
    assert watcher.look().rate == pytest.approx(5.5)
    write(tmp_path, *fast[6:])
    state = watcher.look()
    assert state.rate == pytest.approx(10.0)
    assert state.progress.tests_per_second == pytest.approx(720 / 180)


def test_there_is_no_rate_before_something_was_measured(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    assert watcher.look().rate is None
    write(tmp_path, Event.STARTED, progress(0.0, 0), progress(0.01, 40))
    assert watcher.look().rate is None


def test_the_pause_before_resuming_does_not_count(tmp_path: Path, watcher: CampaignWatcher) -> None:
    write(tmp_path, Event.STARTED, progress(0.0, 0), progress(50.0, 100, 5))
    # Killed, the campaign goes on from its last result, a bit earlier.
    write(tmp_path, Event.RESUMED, progress(47.0, 96, 4))
    assert watcher.look().rate is None
    write(tmp_path, progress(57.0, 126, 8))
    state = watcher.look()
    assert state.rate == pytest.approx(3.4)
    assert state.failures_over_time.tolist() == [[0.0, 0.0], [47.0, 4.0], [57.0, 8.0]]


def test_a_campaign_begun_anew_in_the_same_folder_starts_from_nothing(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    write(tmp_path, Event.STARTED, progress(0.0, 0), progress(50.0, 100, 5))
    write(tmp_path, Event.STARTED)
    state = watcher.look()
    assert state.progress == Progress()
    assert len(state.failures_over_time) == 0


@pytest.mark.parametrize("jump", [-3600, 3600])
def test_wall_clocks_that_jump_do_not_matter(tmp_path: Path, jump: int) -> None:
    def log_in(name: str) -> Path:
        folder = tmp_path / name
        folder.mkdir()
        steps = [progress(5.0 * k, 10 * k, k, budget_spent=0.01 * k) for k in range(40)]
        write(folder, Event.STARTED, *steps)
        return folder

    steady, jumping = log_in("steady"), log_in("jumping")
    lines = [json.loads(line) for line in (jumping / LOG).read_text().splitlines()]
    for number, line in enumerate(lines):
        seconds = 5 * number + (jump if number > 20 else 0)
        line["time"] = f"2026-03-29T{2 + seconds // 3600:02}:{seconds // 60 % 60:02}:00.000+00:00"
    (jumping / LOG).write_text("".join(json.dumps(line) + "\n" for line in lines))
    right, seen = (CampaignWatcher(folder).look().as_json() for folder in (steady, jumping))
    for name in ("last_time", "quiet_seconds"):
        del right[name], seen[name]
    assert seen == right
    assert seen["tests_per_second_now"] == pytest.approx(2.2)


def test_failures_over_time_add_up(tmp_path: Path, watcher: CampaignWatcher) -> None:
    write(tmp_path, Event.STARTED, *(progress(10.0 * k, 0, min(k, 6) ** 2) for k in range(13)))
    state = watcher.look()
    per_interval = state.failures_per_interval(4)
    assert per_interval.tolist() == [9.0, 27.0, 0.0, 0.0]
    assert state.failures_per_interval(50).sum() == pytest.approx(36)


def test_without_failures_there_is_nothing_over_time(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    assert watcher.look().failures_per_interval(3).tolist() == [0.0, 0.0, 0.0]
    write(tmp_path, Event.STARTED, progress(0.0, 0))
    assert watcher.look().failures_per_interval(3).tolist() == [0.0, 0.0, 0.0]


def test_a_week_is_remembered_in_outline(tmp_path: Path, watcher: CampaignWatcher) -> None:
    lines = 10 * MAX_POINTS
    write(tmp_path, *(progress(5.0 * k, 0, 3 * k) for k in range(lines + 1)))
    points = watcher.look().failures_over_time
    assert MAX_POINTS / 2 <= len(points) <= MAX_POINTS
    assert points[0].tolist() == [0.0, 0.0]
    assert points[-1].tolist() == [5.0 * lines, 3.0 * lines]
    assert np.array_equal(points[:, 1], 0.6 * points[:, 0])


# Signs of life


def test_silence_is_measured_by_whether_the_log_grows(
    tmp_path: Path, watcher: CampaignWatcher, clock: Clock
) -> None:
    write(tmp_path, Event.STARTED, progress(0.0, 0), progress(30.0, 90))
    state = watcher.look()
    assert (state.status, state.has_grown) == (Status.RUNNING, False)
    clock.now += SILENT_AFTER
    assert watcher.look().status is Status.RUNNING
    clock.now += 1.0
    state = watcher.look()
    assert (state.status, state.quiet_seconds) == (Status.SILENT, SILENT_AFTER + 1.0)
    assert state.rate is None
    write(tmp_path, progress(31.0, 93))
    state = watcher.look()
    assert (state.status, state.has_grown, state.quiet_seconds) == (Status.RUNNING, True, 0.0)


def test_any_line_is_a_sign_of_life(tmp_path: Path, watcher: CampaignWatcher, clock: Clock) -> None:
    write(tmp_path, Event.STARTED)
    for _ in range(5):
        clock.now += 0.9 * SILENT_AFTER
        append(tmp_path, "no line of ours\n")
        assert watcher.look().status is Status.RUNNING


# Logs that are not as they should be


def test_a_log_may_come_later(tmp_path: Path, clock: Clock) -> None:
    folder = tmp_path / "c"
    watcher = CampaignWatcher(folder, clock=clock)
    state = watcher.look()
    assert state.status is Status.WAITING
    assert "not there" in state.trouble
    folder.mkdir()
    write(folder, Event.STARTED)
    state = watcher.look()
    assert (state.status, state.trouble, state.has_grown) == (Status.RUNNING, "", True)


def test_a_log_that_vanishes_leaves_what_was_seen(
    tmp_path: Path, watcher: CampaignWatcher, clock: Clock
) -> None:
    write(tmp_path, Event.STARTED, progress(30.0, 90))
    watcher.look()
    (tmp_path / LOG).unlink()
    state = watcher.look()
    assert "not there" in state.trouble
    assert (state.status, state.progress.passed) == (Status.RUNNING, 90)
    clock.now += SILENT_AFTER + 1.0
    assert watcher.look().status is Status.SILENT


def test_a_folder_in_the_place_of_a_log_is_no_log(tmp_path: Path, watcher: CampaignWatcher) -> None:
    (tmp_path / LOG).mkdir()
    assert "no file" in watcher.look().trouble


@pytest.mark.parametrize("longer", [False, True])
def test_another_log_in_its_place_is_read_from_its_start(
    tmp_path: Path, watcher: CampaignWatcher, longer: bool
) -> None:
    write(tmp_path, Event.STARTED, progress(30.0, 90, 7), Event.GAVE_UP)
    append(tmp_path, "garbage\n")
    state = watcher.look()
    assert (state.status, state.unreadable) == (Status.GAVE_UP, 1)
    (tmp_path / LOG).unlink()
    write(tmp_path, Event.RESUMED, *[progress(5.0, 4, 1)] * (50 if longer else 1))
    state = watcher.look()
    assert (state.status, state.progress.passed, state.unreadable) == (Status.RUNNING, 4, 0)
    assert state.failures_over_time.tolist() == [[5.0, 1.0]]
    assert state.has_grown


def test_an_emptied_log_is_read_from_its_start(tmp_path: Path, watcher: CampaignWatcher) -> None:
    write(tmp_path, Event.STARTED, progress(30.0, 90, 7), progress(35.0, 91, 7))
    watcher.look()
    (tmp_path / LOG).write_bytes(b"")
    assert watcher.look().status is Status.WAITING
    write(tmp_path, progress(36.0, 92))
    assert watcher.look().progress.passed == 92


def test_half_a_line_is_left_until_it_is_whole(tmp_path: Path, watcher: CampaignWatcher) -> None:
    write(tmp_path, Event.STARTED, progress(1.0, 5), progress(2.0, 6))
    whole = (tmp_path / LOG).read_bytes()
    (tmp_path / LOG).write_bytes(whole[:-30])
    state = watcher.look()
    assert (state.progress.passed, state.unreadable) == (5, 0)
    append(tmp_path, whole[-30:-1])
    assert watcher.look().progress.passed == 5
    append(tmp_path, whole[-1:])
    state = watcher.look()
    assert (state.progress.passed, state.unreadable) == (6, 0)


def test_half_a_line_of_a_killed_process_is_skipped(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    write(tmp_path, Event.STARTED, progress(1.0, 5))
    append(tmp_path, '{"time": "2026-01-01T00:00:00')
    assert watcher.look().unreadable == 0
    write(tmp_path, Event.RESUMED, progress(2.0, 6))
    state = watcher.look()
    assert (state.progress.passed, state.unreadable) == (6, 1)


def test_a_line_that_is_too_long_is_skipped_while_it_grows(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    write(tmp_path, Event.STARTED, progress(1.0, 5))
    for _ in range(5):
        append(tmp_path, "[" * (MAX_LINE // 2 + 10))
        state = watcher.look()
    assert (state.progress.passed, state.unreadable) == (5, 1)
    append(tmp_path, "]\n")
    write(tmp_path, progress(2.0, 6))
    state = watcher.look()
    assert (state.progress.passed, state.unreadable) == (6, 1)


GOOD = {
    "event": "progress",
    "invalid": 0,
    "passed": 6,
    "failed": 0,
    "errors": 0,
    "dropped": 0,
    "min_moobd": None,
    "seconds": 9.0,
    "budget_spent": 0.5,
    "running": 0,
    "workers": [],
}


ODD: list[dict[str, object]] = [
    {"passed": -1},
    {"passed": 2**60},
    {"passed": 6.5},
    {"passed": True},
    {"failed": "3"},
    {"seconds": None},
    {"seconds": float("nan")},
    {"seconds": float("inf")},
    {"seconds": -1.0},
    {"budget_spent": 1.5},
    {"budget_spent": [0.5]},
    {"min_moobd": "low"},
    {"min_moobd": -(10**300)},
    {"running": {}},
]


@pytest.mark.parametrize(
    "line",
    [
        "nonsense",
        "{",
        "[1, 2]",
        '"progress"',
        "null",
        "{}",
        '{"event": 3}',
        '{"event": ["progress"]}',
        "[" * 100_000,
        '{"event":' * 50_000,
        '{"event": "progress", "passed": ' + "9" * 100_000 + "}",
        b"\xff\xfe\x00{",
        b"\x00" * 4096,
        *(json.dumps(GOOD | change) for change in ODD),
    ],
    ids=lambda line: repr(line[-40:]),
)
def test_lines_that_cannot_be_understood_are_counted(
    tmp_path: Path, watcher: CampaignWatcher, line: str | bytes
) -> None:
    write(tmp_path, Event.STARTED, progress(1.0, 5))
    append(tmp_path, line, "\n")
    state = watcher.look()
    assert (state.unreadable, state.progress.passed) == (1, 5)
    append(tmp_path, json.dumps(GOOD), "\n")
    state = watcher.look()
    assert (state.unreadable, state.progress.passed) == (1, 6)


def test_of_odd_fields_what_can_be_understood_is_taken(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    started = {
        "event": "started",
        "time": ["now"],
        "strategy": {"class": {"class": 3}},
        "driver": 7,
        "simulator": {"class": "\x1b[2Jmine.py:Own\x07"},
        "seed": "three",
        "budget": {"simulations": -4, "time": "long"},
        "host": "bench\x1b]0;title\x07-2\u202e",
        "process_id": 10**30,
    }
    workers: list[Any] = [
        {"name": "ok", "state": "idle", "tests": 1, "seconds_in_state": 2},
        {"name": "ok", "state": "asleep", "tests": 1, "seconds_in_state": 2},
        {"name": 3, "state": "idle", "tests": 1, "seconds_in_state": 2},
        {"name": "late", "state": "idle", "tests": 1, "seconds_in_state": "2"},
        {"name": "unhashable", "state": {}, "tests": 1, "seconds_in_state": 2},
        None,
        "worker 4",
    ]
    error = {"event": "log", "level": "error", "message": "\x1b[31mred\x9b0m\n" + "x" * 100_000}
    for line in (started, GOOD | {"workers": workers}, error, GOOD | {"level": ["error"]}):
        append(tmp_path, json.dumps(line), "\n")
    state = watcher.look()
    assert state.setup == Setup(strategy="?", simulator="Own", host="bench ]0;title -2")
    assert state.workers == ()  # of the last line
    (message,) = state.messages
    assert message.text.startswith("[31mred 0m xxx")
    assert len(message.text) <= 500
    append(tmp_path, json.dumps(GOOD | {"workers": workers}), "\n")
    assert watcher.look().workers == (WorkerState("ok", "idle", 1, 2.0),)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.sampled_from(["", "\x1b[m", "ok"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["class", "driver", "time", "name", "state"]), inner)
    ),
    max_leaves=8,
)
KEYS = (*GOOD, "time", "level", "message", "strategy", "driver", "budget", "seed", "host")


@given(
    st.lists(
        st.tuples(st.sampled_from(list(Event)), st.dictionaries(st.sampled_from(KEYS), VALUES)),
        max_size=6,
    )
)
def test_nothing_in_a_log_is_trusted(
    tmp_path_factory: pytest.TempPathFactory, lines: list[tuple[Event, dict[str, Any]]]
) -> None:
    folder = tmp_path_factory.mktemp("log")
    for event, odd in lines:
        append(folder, json.dumps(GOOD | {"event": event} | odd), "\n")
    append(folder, json.dumps(GOOD), "\n")
    state = CampaignWatcher(folder).look()
    assert state.progress.passed == 6
    assert state.unreadable <= len(lines)
    json.dumps(state.as_json(), allow_nan=False)
    texts = [state.setup.host, state.setup.driver, state.last_time]
    texts += [message.text for message in state.messages]
    assert all(text is None or text.isprintable() for text in texts)


# A long log


def test_of_a_long_log_only_what_is_new_is_read(tmp_path: Path, watcher: CampaignWatcher) -> None:
    write(tmp_path, Event.STARTED)
    steps = ({"seconds": 5.0 * k, "passed": 100 * k, "failed": k} for k in range(20_000))
    append(tmp_path, *(json.dumps(GOOD | step) + "\n" for step in steps))
    state = watcher.look()
    assert (state.progress.failed, state.unreadable) == (19_999, 0)
    # Were the old lines read again, this would be noticed.
    size = (tmp_path / LOG).stat().st_size
    with (tmp_path / LOG).open("r+b") as file:
        file.seek(1000)
        file.write((b"x\n" * size)[: size - 1001])
    write(tmp_path, progress(100_000.0, 2_000_050, 20_000))
    state = watcher.look()
    assert (state.progress.failed, state.unreadable) == (20_000, 0)
    assert state.rate == pytest.approx((2_020_050 - 101 * 19_988) / 60)


# Another process


WRITER = """
import sys
from pathlib import Path
from frenetic.campaign.log import CampaignLog, Event
from frenetic.campaign.progress import Progress

with CampaignLog(Path(sys.argv[1])) as log:
    log.write(Event.STARTED, "started")
    print("there", flush=True)
    for number, line in enumerate(sys.stdin, 1):
        if line.strip() == "end":
            log.write(Event.FINISHED, "done")
        else:
            log.progress(Progress(passed=number, seconds=float(number)), force=True)
        print("written", flush=True)
"""


def test_another_process_is_followed_while_it_writes(
    tmp_path: Path, watcher: CampaignWatcher
) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        commands, answers = process.stdin, process.stdout
        assert commands is not None
        assert answers is not None

        def ask(text: str) -> None:
            commands.write(f"{text}\n")
            commands.flush()
            assert answers.readline() == "written\n"

        assert answers.readline() == "there\n"
        assert watcher.look().status is Status.RUNNING
        for number in range(1, 30):
            ask("go on")
            state = watcher.look()
            assert (state.progress.passed, state.has_grown) == (number, True)
        ask("end")
        assert watcher.look().status is Status.FINISHED
        process.communicate()


# Folders without a log


def no_folder(folder: Path) -> None:
    pass


def a_file(folder: Path) -> None:
    folder.write_text("in the way")


def an_empty_folder(folder: Path) -> None:
    folder.mkdir()


def an_old_campaign(folder: Path) -> None:
    CampaignStore.create(folder, {}).close()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (no_folder, "does not exist"),
        (a_file, "is not a folder"),
        (an_empty_folder, "holds no campaign"),
        (an_old_campaign, "made before campaigns had one .* 'frenetic show'"),
    ],
)
def test_a_folder_without_a_log_is_one_clear_line(
    tmp_path: Path, make: Callable[[Path], None], words: str
) -> None:
    folder = tmp_path / "c"
    make(folder)
    with pytest.raises(CampaignError, match=words) as caught:
        require_log(folder)
    assert "\n" not in str(caught.value)
    assert LOG in str(caught.value)


def test_a_log_alone_will_do(tmp_path: Path) -> None:
    write(tmp_path, Event.STARTED)
    require_log(tmp_path)
