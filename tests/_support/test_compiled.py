"""Processes that compile the same kernel at once, for different arguments."""

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

# Stops in the middle of the cache's update, when its index names machine code not written yet.
SLOW = """
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

# Tells when it has to wait for its turn.
OTHER = """
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


# Says how many of both forms were read from the disk.
BOTH = """
import numpy as np
from kernels import total
print(total(np.arange(5)), total(np.arange(5.0)), sum(total.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "kernels.py").write_text(KERNELS)
    return tmp_path


def start(folder: Path, code: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


@pytest.mark.heavy
def test_processes_take_turns(folder: Path) -> None:
    with start(folder, SLOW) as slow, start(folder, "input()\n" + OTHER) as other:
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
    with start(folder, BOTH) as reader:
        assert reader.communicate()[0] == "10.0 10.0 2\n"


# Compiles in spite of another process that holds the lock all the time, or of files without locks.
ALONE = """
import filelock
import numpy as np
from filelock import FileLock
from frenetic._support import compiled
from kernels import total

def refuse(self, **others):
    raise {error}("no turn")

FileLock.acquire = refuse
compiled.PATIENCE = 0.0
print(total(np.arange(5)), total(np.arange(5.0)))
"""


@pytest.mark.parametrize("error", ["filelock.Timeout", "OSError"])
def test_who_never_gets_a_turn_does_without(folder: Path, error: str) -> None:
    with start(folder, ALONE.format(error=error)) as alone:
        assert alone.communicate()[0] == "10.0 10.0\n"


@pytest.mark.heavy
def test_one_that_is_killed_while_it_compiles_hurts_nobody(folder: Path) -> None:
    with start(folder, SLOW) as slow:
        assert slow.stdout
        assert slow.stdout.readline() == "stopped\n"
        slow.kill()
    with start(folder, OTHER) as other:
        assert other.communicate()[0] == "10.0\n"
    with start(folder, BOTH.replace("sum(total.stats.cache_hits.values())", "2")) as reader:
        assert reader.communicate()[0] == "10.0 10.0 2\n"
