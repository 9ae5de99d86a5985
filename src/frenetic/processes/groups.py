"""Groups of processes, which are killed as a whole."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path


def lead_group() -> None:
    """Make this process the head of a new group, with which its later children can be killed."""
    if sys.platform != "win32":
        with suppress(OSError):  # it is the head of a group already
            os.setsid()


def kill_tree(process_id: int) -> None:
    """Kill a process with all that it has started.

    On POSIX this is the group that the process heads, without processes that have left it. On
    Windows it is the process with its children, their children and so on, if it still runs.
    """
    if sys.platform == "win32":
        tool = Path(os.environ.get("SYSTEMROOT", r"C:\Windows"), "System32", "taskkill.exe")
        with suppress(OSError):  # the tool is missing
            subprocess.run(  # noqa: S603 - our own numbers
                [str(tool), "/F", "/T", "/PID", str(process_id)], capture_output=True, check=False
            )
    else:
        with suppress(OSError):  # gone already, or not yet a group
            os.killpg(process_id, signal.SIGKILL)
