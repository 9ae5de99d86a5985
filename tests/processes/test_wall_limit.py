from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import FrameType
from typing import NoReturn

import pytest

from frenetic.processes.wall_limit import WallLimitExceeded, wall_limit

posix = pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="needs POSIX timers")


def spin() -> NoReturn:
    while True:
        pass


def spin_for(seconds: float) -> None:
    """Python instructions for a while."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def exceeds(call: Callable[[], object], seconds: float) -> bool:
    try:
        with wall_limit(seconds):
            call()
    except WallLimitExceeded:
        return True
    return False


def assert_over() -> None:
    """No timer runs and nobody watches."""
    if hasattr(signal, "getitimer"):
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert "wall-limit" not in {thread.name for thread in threading.enumerate()}


def in_thread(call: Callable[[], object]) -> None:
    """Runs the call in another thread and raises here what it raised there."""
    errors: list[BaseException] = []

    def run() -> None:
        try:
            call()
        except BaseException as error:
            errors.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive()
    for error in errors:
        raise error


Run = Callable[[Callable[[], object]], None]


@pytest.fixture(params=["main thread", "another thread"])
def run(request: pytest.FixtureRequest) -> Run:
    if request.param == "main thread":
        return lambda call: (call(), None)[1]
    return in_thread


# --- In any thread -------------------------------------------------------------------------------


def test_a_block_that_takes_too_long_is_left(run: Run) -> None:
    def check() -> None:
        assert exceeds(spin, 0.1)

    run(check)


def test_a_block_in_time_is_left_alone(run: Run) -> None:
    def check() -> None:
        reached = []
        with wall_limit(60.0):
            reached.append(1)
        assert reached == [1]
        assert_over()

    run(check)


def test_nothing_is_raised_after_the_block(run: Run) -> None:
    def check() -> None:
        for _ in range(20):
            exceeds(lambda: None, 0.05)
        spin_for(0.2)
        assert exceeds(spin, 0.05)
        # Not once more either, as for a block that swallows the exception.
        spin_for(1.3)

    run(check)


def test_a_block_that_swallows_the_exception_gets_another(run: Run) -> None:
    caught = []

    def swallow() -> None:
        for _ in range(2):
            try:
                spin()
            except WallLimitExceeded:
                caught.append(1)
        spin()

    def check() -> None:
        assert exceeds(swallow, 0.1)
        assert caught == [1, 1]

    run(check)


def test_a_thread_limits_itself_only() -> None:
    stop = threading.Event()
    broken: list[BaseException] = []

    def bystander() -> None:
        try:
            while not stop.is_set():
                pass
        except BaseException as error:
            broken.append(error)

    thread = threading.Thread(target=bystander)
    thread.start()
    try:
        in_thread(lambda: exceeds(spin, 0.1))
        assert exceeds(spin, 0.1)
    finally:
        stop.set()
        thread.join()
    assert broken == []


# --- By signal -----------------------------------------------------------------------------------


def handler(_number: int, _frame: FrameType | None) -> None:
    raise AssertionError("the alarm of somebody else")


@posix
@pytest.mark.parametrize("too_long", [True, False])
def test_the_handler_and_the_timer_are_put_back(too_long: bool) -> None:
    before = signal.signal(signal.SIGALRM, handler)
    try:
        assert exceeds(spin if too_long else lambda: None, 0.05 if too_long else 60.0) is too_long
        assert signal.getsignal(signal.SIGALRM) is handler
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    finally:
        signal.signal(signal.SIGALRM, before)


@posix
def test_a_blocking_call_is_ended() -> None:
    assert exceeds(lambda: time.sleep(3600.0), 0.05)
    lock = threading.Lock()
    with lock:
        assert exceeds(lambda: lock.acquire(), 0.05)


@posix
def test_an_inner_limit_ends_the_inner_block_only() -> None:
    with wall_limit(60.0):
        assert exceeds(spin, 0.05)
        assert not exceeds(lambda: None, 60.0)
        spin_for(0.2)


@posix
def test_an_outer_limit_goes_on_after_an_inner_one() -> None:
    def block() -> None:
        with wall_limit(60.0):
            pass
        spin_for(5.0)

    assert exceeds(block, 0.2)


@posix
def test_the_alarm_of_somebody_else_still_comes() -> None:
    rang = []
    before = signal.signal(signal.SIGALRM, lambda _number, _frame: rang.append(1))
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with wall_limit(60.0):
            pass
        spin_for(1.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert rang == [1]


@posix
def test_a_limit_that_strikes_just_as_the_block_ends_leaves_nothing_behind() -> None:
    """The block is about as long as its limit, so that the alarm comes at all places around it."""
    before = signal.getsignal(signal.SIGALRM)
    try:
        for k in range(2000):
            exceeds(lambda: None, 1e-6 * (1 + k % 60))
            assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
            assert signal.getsignal(signal.SIGALRM) is before
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
