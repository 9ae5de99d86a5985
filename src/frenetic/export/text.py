"""Tables as text: CSV, and JSON with one test per line."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import text_cell
from frenetic.campaign.trajectory_codec import RESOLUTIONS
from frenetic.errors import RoadError
from frenetic.export.tables import TRAJECTORIES, Batch, Column, Kind, Lists, Values
from frenetic.road import Pose, Road
from frenetic.road.road import START

_DIGITS: Final = 6  # decimals of road points: micrometres
_DECIMALS: Final = [round(-math.log10(step)) for step in RESOLUTIONS.values()]
_LINES_AT_ONCE: Final = 10_000


def write_csv(path: Path, columns: tuple[Column, ...], batches: Iterable[Batch]) -> None:
    """Writes a table as CSV (UTF-8): missing values empty, lists as JSON, texts as `text_cell`.

    Trajectories have the decimals to which they are stored.

    Raises:
        OSError: the file cannot be written.
    """
    rows = _rows_of_trajectories if columns is TRAJECTORIES else _rows
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(",".join(column.name for column in columns) + "\n")
        for batch in batches:
            rows(file, batch)


def _rows(file: TextIO, batch: Batch) -> None:
    cells = [_cells(column, batch.values[column.name]) for column in batch.columns]
    csv.writer(file, lineterminator="\n").writerows(zip(*cells, strict=True))


def _rows_of_trajectories(file: TextIO, batch: Batch) -> None:
    line = ",".join(["%d", *(f"%.{digits}f" for digits in _DECIMALS)]) + "\n"
    columns: Any = [batch.values[column.name] for column in TRAJECTORIES]
    table = np.column_stack(columns)
    # One template for many lines takes a fraction of the time of formatting each line.
    for start in range(0, len(table), _LINES_AT_ONCE):
        lines = table[start : start + _LINES_AT_ONCE]
        file.write(line * len(lines) % tuple(lines.ravel().tolist()))


def write_json_lines(
    path: Path,
    batches: Iterable[Batch],
    trajectories: Iterator[tuple[int, FloatArray]] | None,
    on_test: Callable[[int], None],
) -> None:
    """Writes one JSON object per line and test: the table's columns, road points, trajectory.

    ``road_points`` are [x, y] in m; ``trajectory`` holds a list for each column, and is null if
    there is none.

    Args:
        path: of the file.
        batches: the table of tests.
        trajectories: ids and (11, n) trajectories, in the same order; None to leave them out.
        on_test: called with the number of tests written, after each.

    Raises:
        OSError: the file cannot be written.
    """
    following = None if trajectories is None else next(trajectories, None)
    done = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        for batch in batches:
            for test in _objects(batch):
                test["road_points"] = _road_points(test)
                if trajectories is not None:
                    test["trajectory"] = None
                    if following is not None and following[0] == test["id"]:
                        driven = zip(RESOLUTIONS, following[1].tolist(), strict=True)
                        test["trajectory"] = dict(driven)
                        following = next(trajectories, None)
                file.write(json.dumps(test, ensure_ascii=False, allow_nan=False) + "\n")
                done += 1
                on_test(done)


def _cells(column: Column, values: Values) -> Iterable[object]:
    """The values for a CSV file: a missing one as None, which is written as nothing."""
    plain = _plain(column, values)
    if isinstance(values, Lists):
        return (json.dumps(value) for value in plain)
    if column.kind is Kind.TEXT:
        return (None if value is None else text_cell(value) for value in plain)
    return plain


def _plain(column: Column, values: Values) -> list[Any]:
    """The values for JSON."""
    if isinstance(values, list):
        return values
    if isinstance(values, Lists):
        numbers, places = values.values.tolist(), values.offsets.tolist()
        return [numbers[a:b] for a, b in pairwise(places)]
    if column.kind is Kind.MOMENT:
        return [f"{moment}+00:00" for moment in np.datetime_as_string(values)]  # type: ignore[arg-type]
    plain: list[Any] = values.tolist()
    if column.optional:
        return [None if value != value else value for value in plain]
    return plain


def _objects(batch: Batch) -> Iterator[dict[str, Any]]:
    names = [column.name for column in batch.columns]
    cells = [_plain(column, batch.values[column.name]) for column in batch.columns]
    return (dict(zip(names, row, strict=True)) for row in zip(*cells, strict=True))


def _road_points(test: dict[str, Any]) -> list[list[float]] | None:
    """Points of the road in its place on the map, or else from (0, 0) on; None if it is no road."""
    pose = START if test["x"] is None else Pose(test["x"], test["y"], test["heading"])
    try:
        road = Road(test["curvatures"], test["step"], pose)
    except RoadError:
        return None
    points: list[list[float]] = road.road_points.round(_DIGITS).tolist()
    return points
