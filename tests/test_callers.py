"""Tests come to the same whatever the process is like that starts them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent / "cli" / "test_cli.py"


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
def test_under_nohup_in_a_background_job_and_without_colours(tmp_path: Path) -> None:
    def ignore() -> None:
        for name in ("SIGHUP", "SIGINT", "SIGTERM", "SIGQUIT", "SIGCHLD"):
            signal.signal(signal.Signals[name], signal.SIG_IGN)

    chosen = f"{TESTS}::test_a_signal_ends_a_run_with_its_summary_and_its_simulator"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", chosen],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120.0,
        env=os.environ | {"NO_COLOR": "1", "COLUMNS": "40", "TERM": "dumb", "CI": "true"},
        preexec_fn=ignore,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "3 passed" in done.stdout
