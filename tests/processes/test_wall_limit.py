"""`wall_limit` ends a block that takes too long, in the main thread and in any other."""

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
    """Execute Python instructions for ever."""
    while True:
        pass


def spin_for(seconds: float) -> None:
    """Execute Python instructions for a time in s."""
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        pass


def exceeds(call: Callable[[], object], seconds: float) -> bool:
    """Whether a call is ended by a wall limit in s."""
    try:
        with wall_limit(seconds):
            call()
    except WallLimitExceeded:
        return True
    return False


def require_no_timer() -> None:
    """Require that no timer runs and no thread watches."""
    if hasattr(signal, "getitimer"):
        assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    assert "wall-limit" not in {thread.name for thread in threading.enumerate()}


def in_thread(call: Callable[[], object]) -> None:
    """Make a call in another thread, and raise its error in this thread."""
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


# In any thread


def test_a_block_that_takes_too_long_is_ended(run: Run) -> None:
    def check() -> None:
        assert exceeds(spin, 0.1)

    run(check)


def test_a_block_within_its_limit_is_not_ended(run: Run) -> None:
    def check() -> None:
        reached = []
        with wall_limit(60.0):
            reached.append(1)
        assert reached == [1]
        require_no_timer()

    run(check)


def test_nothing_is_raised_after_the_end_of_the_block(run: Run) -> None:
    def check() -> None:
        for _ in range(20):
            exceeds(lambda: None, 0.05)
        spin_for(0.2)
        assert exceeds(spin, 0.05)
        # Nor is it raised again, as in a block that swallows the exception.
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


def test_a_limit_ends_only_the_thread_that_set_it() -> None:
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


# By signal


def handler(_number: int, _frame: FrameType | None) -> None:
    raise AssertionError("the former handler was called")


@posix
@pytest.mark.parametrize("too_long", [True, False])
def test_the_former_handler_and_timer_are_restored(too_long: bool) -> None:
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
def test_an_alarm_that_was_set_before_still_comes() -> None:
    alarms = []
    before = signal.signal(signal.SIGALRM, lambda _number, _frame: alarms.append(1))
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with wall_limit(60.0):
            pass
        spin_for(1.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert alarms == [1]


@posix
def test_a_limit_that_strikes_at_the_end_of_the_block_leaves_no_timer() -> None:
    """Limits of 1 to 60 µs: the alarm comes at each place around the end of the block."""
    before = signal.getsignal(signal.SIGALRM)
    try:
        for k in range(2000):
            exceeds(lambda: None, 1e-6 * (1 + k % 60))
            assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
            assert signal.getsignal(signal.SIGALRM) is before
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
