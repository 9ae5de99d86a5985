"""Processes that compile the same kernel at once, for different arguments."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from frenetic._support import shared_kernels
from frenetic._support.compiled import njit
from frenetic._support.file_locks import try_to_lock

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
from frenetic._support import shared_kernels
from frenetic._support.file_locks import try_to_lock
from kernels import total

waits = False

def tell(file):
    global waits
    try:
        try_to_lock(file)
    except OSError:
        if not waits:
            print("waits", flush=True)
        waits = True
        raise

shared_kernels.try_to_lock = tell
print(total(np.arange(5)))
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
    both = (
        "import numpy as np\nfrom kernels import total\nprint(total(np.arange(5)), "
        "total(np.arange(5.0)), sum(total.stats.cache_hits.values()))"
    )
    with start(folder, both) as reader:
        assert reader.communicate()[0] == "10.0 10.0 2\n"


def double(value: float) -> float:
    return 2.0 * value


def test_who_never_gets_a_turn_compiles_for_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))

    def refuse(file: int) -> None:
        raise BlockingIOError

    monkeypatch.setattr(shared_kernels, "try_to_lock", refuse)
    monkeypatch.setattr(shared_kernels, "PATIENCE", 0.0)
    assert njit()(double)(2.0) == 4.0
    assert not list(tmp_path.rglob("*.nb[ic]"))
    monkeypatch.setattr(shared_kernels, "try_to_lock", try_to_lock)
    assert njit()(double)(2.0) == 4.0
    assert list(tmp_path.rglob("*.nbc"))


def test_where_files_cannot_be_locked_kernels_are_kept_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))

    def fail(file: int) -> None:
        raise OSError("no locks")

    monkeypatch.setattr(shared_kernels, "try_to_lock", fail)
    assert njit()(double)(2.0) == 4.0
    assert list(tmp_path.rglob("*.nbc"))
