"""The options of ``frenetic drive`` for a trace: ``--trace`` and ``--layouts``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from frenetic.oracle.drive import Drive
    from frenetic.oracle.verdict import Result
    from frenetic.road import Road


@dataclass(frozen=True)
class TraceFile:
    """Where the trace of a drive is written."""

    path: Path
    """The file, which ends in .csv or .mcap."""
    has_layouts: bool
    """Whether layouts for Foxglove and PlotJuggler are written beside it."""

    @classmethod
    def of(cls, path: Path | None, *, has_layouts: bool) -> TraceFile | None:
        """Return the file of the command line; None without ``--trace``.

        Raises:
            click.UsageError: layouts are wanted without a trace.
        """
        if path is None:
            if has_layouts:
                raise click.UsageError("--layouts lie beside a trace: add --trace FILE")
            return None
        return cls(path, has_layouts)

    def write(
        self, road: Road, drive: Drive | None, result: Result, conditions: Mapping[str, float]
    ) -> dict[str, str]:
        """Write the trace of a drive; return its path for JSON, nothing without records.

        Args:
            road: the road.
            drive: the drive; None if the road was not driven.
            result: verdict on the drive.
            conditions: conditions of the drive.

        Raises:
            FreneticError: a file cannot be written.
        """
        from frenetic.export import trace_of, write_layouts, write_trace
        from frenetic.export.trace_files import trace_form_of
        from frenetic.export.traces import has_records

        if drive is None or not has_records(drive.trajectory):
            return {}
        write_trace(trace_of(road, drive, result, conditions), self.path)
        if self.has_layouts:
            write_layouts(self.path.parent, trace_form_of(self.path))
        return {"trace": str(self.path)}
