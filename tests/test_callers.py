"""Tests come to the same whatever the process is like that starts them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

SIGNALS = ("SIGHUP", "SIGINT", "SIGTERM", "SIGQUIT", "SIGCHLD")
CHILD = """
import json, os, signal
names = [s.name for s in signal.Signals if signal.getsignal(s) is signal.SIG_IGN]
print(json.dumps([sorted(names), dict(os.environ)]))
"""
TEST = """
import subprocess, sys

def test_a_child():
    sys.stdout.write(subprocess.check_output([sys.executable, "-c", {child!r}], text=True))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_under_nohup_in_a_background_job_and_without_colours(tmp_path: Path) -> None:
    """What a test starts hears signals, and knows nothing of the caller's terminal."""
    shutil.copy(Path(__file__).with_name("conftest.py"), tmp_path)
    (tmp_path / "test_child.py").write_text(TEST.format(child=CHILD), encoding="utf-8")
    callers = {"NO_COLOR": "1", "COLUMNS": "40", "TERM": "dumb", "MPLBACKEND": "agg"}

    def ignore() -> None:
        for name in SIGNALS:
            signal.signal(signal.Signals[name], signal.SIG_IGN)

    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-s", "-n", "0", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120.0,
        env=os.environ | callers | {"PYTHONPATH": str(Path(__file__).with_name("shared"))},
        preexec_fn=ignore,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (line,) = (line for line in done.stdout.splitlines() if line.startswith("["))
    ignored, environment = json.loads(line)
    assert set(ignored) <= {"SIGPIPE", "SIGXFSZ"}, "Python itself ignores these"
    assert not callers.keys() & environment.keys()
