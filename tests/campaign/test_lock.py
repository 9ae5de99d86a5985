"""The lock of a campaign's folder: one process may write, and others see which one."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from campaigns import refused
from filelock import lock_descriptor
from permissions import bound_by_permissions
from pids import LIMIT, until

from frenetic.campaign import lock
from frenetic.campaign.lock import holder, lock_file

HOLD = """
import os, sys, time
from pathlib import Path
from frenetic.campaign.lock import lock_file

lock = lock_file(Path(sys.argv[1]))
child = os.fork() if "fork" in sys.argv else 1
if child == 0:
    lock.release()  # the parent's lock: nothing happens
else:
    print(child, flush=True)
time.sleep(600)
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "c.lock"


@contextmanager
def holding(path: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A process that holds the lock, and the id of its fork."""
    command = [sys.executable, "-W", "ignore", "-c", HOLD, str(path), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, int(process.stdout.readline())
        finally:
            process.kill()


def test_a_lock_has_one_holder_until_its_release(path: Path) -> None:
    first = lock_file(path)
    assert holder(path) == "this process"
    with refused("is being written by this process: wait"):
        lock_file(path)
    assert holder(path) == "this process"
    first.release()
    assert holder(path) is None
    with lock_file(path):
        first.release()  # released before: nothing happens
        assert holder(path) == "this process"


def test_another_thread_may_release_a_lock(path: Path) -> None:
    held = lock_file(path)
    thread = threading.Thread(target=held.release)
    thread.start()
    thread.join()
    assert holder(path) is None


@pytest.mark.skipif(sys.platform != "linux", reason="compares when processes have started")
def test_a_lock_names_the_process_that_holds_it(path: Path) -> None:
    with holding(path) as (process, _):
        assert holder(path) == f"process {process.pid}"
        with refused(f"written by process {process.pid}: wait"):
            lock_file(path)
        process.kill()
        process.wait()
        assert holder(path) is None
        lock_file(path).release()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no forking here")
def test_a_fork_neither_holds_nor_releases_the_lock(path: Path) -> None:
    with holding(path, "fork") as (process, child):
        try:
            assert holder(path) is not None
            process.kill()
            process.wait()
            until(lambda: holder(path) is None, "the fork has let go of it")
        finally:
            os.kill(child, signal.SIGKILL)


@pytest.mark.parametrize(
    "lie", [{"host": "elsewhere"}, {"process_start": 1}, {"process_id": 1 << 30}, {"host": 3}]
)
def test_a_process_id_in_a_lock_file_counts_only_if_host_and_start_match(
    path: Path, lie: dict[str, Any]
) -> None:
    with lock_file(path):
        content = json.loads(path.read_text())
        assert (content["process_id"], content["host"]) == (os.getpid(), platform.node())
        path.write_text(f" {json.dumps(content | lie)}")
        assert holder(path) == "another process"
        path.write_text("")
        assert holder(path) == "another process"


def test_a_look_at_a_lock_makes_no_file_and_locks_nobody_out(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert holder(path) is None
    assert not path.exists()
    lock_file(path).release()
    monkeypatch.setattr(lock, "LONGEST_WAIT", LIMIT)
    with path.open("rb") as file:  # a look locks the file for a moment, too
        assert lock_descriptor(file.fileno(), blocking=False)
        threading.Timer(0.1, file.close).start()
        lock_file(path).release()


def test_a_lock_that_cannot_be_made_is_refused_in_one_line(tmp_path: Path) -> None:
    with refused("cannot lock .*; check"):
        lock_file(tmp_path)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="needs POSIX permissions")
def test_a_reader_without_permission_to_write_sees_the_holder(path: Path) -> None:
    with lock_file(path):
        path.chmod(0o444)
        with bound_by_permissions(path.parent):
            assert holder(path) == "this process"
    with bound_by_permissions(path.parent):
        assert holder(path) is None
