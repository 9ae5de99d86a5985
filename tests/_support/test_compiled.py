"""Several processes compile the same kernel at the same time, for different arguments."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

KERNELS = """
from frenetic._support.compiled import njit

@njit()
def total(values):
    result = 0.0
    for value in values:
        result += value
    return result
"""

# Stops while it updates the cache: the index names machine code that is not written yet.
STOPS_WHILE_WRITING = """
import numpy as np
from numba.core.caching import IndexDataCacheFile
from kernels import total

save_data = IndexDataCacheFile._save_data

def stop(self, name, data):
    print("stopped", flush=True)
    input()
    save_data(self, name, data)

IndexDataCacheFile._save_data = stop
print(total(np.arange(5.0)))
"""

# Prints "waits" when another process holds the lock.
REPORTS_WAITING = """
import numpy as np
from filelock import FileLock, Timeout
from kernels import total

acquire = FileLock.acquire

def tell(self, *, timeout, **others):
    try:
        return acquire(self, timeout=timeout, **others)
    except Timeout:
        print("waits", flush=True)
        raise

FileLock.acquire = tell
print(total(np.arange(5)))
"""

# Prints how many of both compiled forms came from the disk.
READS_CACHE = """
import numpy as np
from kernels import total
print(total(np.arange(5)), total(np.arange(5.0)), sum(total.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a module of kernels."""
    (tmp_path / "kernels.py").write_text(KERNELS)
    return tmp_path


def start(folder: Path, code: str) -> subprocess.Popen[str]:
    """Start a Python process with the kernels and a cache in a folder."""
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.heavy
def test_processes_update_the_cache_one_after_the_other(folder: Path) -> None:
    with (
        start(folder, STOPS_WHILE_WRITING) as slow,
        start(folder, "input()\n" + REPORTS_WAITING) as other,
    ):
        assert slow.stdin
        assert slow.stdout
        assert slow.stdout.readline() == "stopped\n"
        assert other.stdin
        assert other.stdout
        other.stdin.write("\n")
        other.stdin.flush()
        assert other.stdout.readline() == "waits\n"
        assert slow.communicate("\n")[0] == "10.0\n"
        assert other.communicate()[0] == "10.0\n"
    with start(folder, READS_CACHE) as reader:
        assert reader.communicate()[0] == "10.0 10.0 2\n"


# Never gets the lock, or runs on a file system without locks.
WITHOUT_LOCK = """
import filelock
import numpy as np
from filelock import FileLock
from frenetic._support import compiled
from kernels import total

def refuse(self, **others):
    raise {error}("no turn")

FileLock.acquire = refuse
compiled.MAX_WAIT = 0.0
print(total(np.arange(5)), total(np.arange(5.0)))
"""


@pytest.mark.parametrize(
    "error", ["filelock.Timeout", pytest.param("OSError", marks=pytest.mark.heavy)]
)
def test_a_process_without_the_lock_compiles_without_the_cache(folder: Path, error: str) -> None:
    with start(folder, WITHOUT_LOCK.format(error=error)) as alone:
        assert alone.communicate()[0] == "10.0 10.0\n"


@pytest.mark.heavy
def test_a_process_killed_while_it_writes_the_cache_does_no_harm(folder: Path) -> None:
    with start(folder, STOPS_WHILE_WRITING) as slow:
        assert slow.stdout
        assert slow.stdout.readline() == "stopped\n"
        slow.kill()
    with start(folder, REPORTS_WAITING) as other:
        assert other.communicate()[0] == "10.0\n"
    with start(folder, READS_CACHE.replace("sum(total.stats.cache_hits.values())", "2")) as reader:
        assert reader.communicate()[0] == "10.0 10.0 2\n"
