"""Drives that were recorded elsewhere, in CSV or MDF files, and how ours differ from them.

The names below are imported when they are used, so the command line stays fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.recordings.comparison import RecordingComparison, compare_with_recording
    from frenetic.recordings.recording import Recording, RecordingFile, read_recording

__all__ = [
    "Recording",
    "RecordingComparison",
    "RecordingFile",
    "compare_with_recording",
    "read_recording",
]

_MODULES = {
    "Recording": "frenetic.recordings.recording",
    "RecordingComparison": "frenetic.recordings.comparison",
    "RecordingFile": "frenetic.recordings.recording",
    "compare_with_recording": "frenetic.recordings.comparison",
    "read_recording": "frenetic.recordings.recording",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
