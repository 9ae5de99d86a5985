"""The option ``--compare`` of ``frenetic drive``: a recorded drive on the same road."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from frenetic.cli import echo
from frenetic.cli.console import print_table

if TYPE_CHECKING:
    from frenetic.cli.drive_plan import RoadToDrive
    from frenetic.oracle.drive import Drive
    from frenetic.oracle.verdict import Result
    from frenetic.recordings import Recording, RecordingComparison


def read_compared(text: str | None) -> Recording | None:
    """Return the recording of the command line; None without ``--compare``.

    Raises:
        FreneticError: it cannot be read.
    """
    if text is None:
        return None
    from frenetic.recordings import RecordingFile, read_recording

    return read_recording(RecordingFile.of(text))


def compare_drive(
    recording: Recording,
    target: RoadToDrive,
    driven: Drive | None,
    result: Result,
    conditions: Mapping[str, float],
) -> RecordingComparison | None:
    """Return the comparison of a drive with a recording; None without a drive.

    Raises:
        FreneticError: the recording does not say where the car was, or lies elsewhere.
    """
    from frenetic.export import trace_of
    from frenetic.export.traces import has_records
    from frenetic.recordings import compare_with_recording

    if driven is None or not has_records(driven.trajectory):
        return None
    roads = [target.road, *([] if target.file_road is None else [target.file_road])]
    trace = trace_of(target.road, driven, result, conditions)
    return compare_with_recording(roads, trace, recording)


def draw_comparison(comparison: RecordingComparison, target: RoadToDrive, plot: Path) -> None:
    """Draw both drives."""
    from frenetic.report.recording_picture import draw_recording  # imports matplotlib

    draw_recording(comparison, plot, title=f"{Path(target.name).name}: driven and recorded")


def print_comparison(comparison: RecordingComparison) -> None:
    """Print how the drive differs from the recording."""
    low, high = comparison.distances[0], comparison.distances[-1]
    echo(
        f"compared with {comparison.recording.name}, {low:.0f} to {high:.0f} m along the road by"
        f" {comparison.place_source}"
    )
    channels = comparison.recording.channels
    print_table(
        ("signal", ">mean difference", ">largest", "", ">where", ">recorded", ">driven", "channel"),
        [
            (
                difference.signal.replace("_", " "),
                *(
                    f"{round(value, 2) + 0.0:.2f}"  # + 0.0 turns -0.0 into 0.0
                    for value in (difference.mean, difference.largest)
                ),
                difference.unit,
                f"{difference.distance:.0f} m",
                *(
                    f"{round(value, 2) + 0.0:.2f}"
                    for value in (difference.recorded, difference.driven)
                ),
                channels.get(difference.signal),
            )
            for difference in comparison.differences
        ],
    )
