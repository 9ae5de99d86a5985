"""Files of traces: CSV, which needs no other package, and MCAP."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Final, Literal, TypeAlias, get_args

from frenetic._support.files import replacing
from frenetic._support.printable import text_cell
from frenetic._support.words import pip_install
from frenetic.errors import FreneticError
from frenetic.export.trace_columns import field_name, number_text
from frenetic.export.traces import DriveTrace

EVENTS: Final = ".events.csv"
"""Suffix of the file with the events, beside a trace that is a CSV file."""
TraceForm: TypeAlias = Literal["csv", "mcap"]
"""Form of a trace's file, which is its suffix."""


def check_form(form: str) -> TraceForm:
    """Return the form of traces with this name.

    Raises:
        FreneticError: no form has this name, or the extra that it needs is not installed.
    """
    for known in get_args(TraceForm):
        if form == known:
            if form == "mcap":
                _require_mcap()
            return known  # type: ignore[no-any-return]  # `get_args` is untyped
    raise FreneticError(f"no trace is a file of the form {form!r}: choose csv or mcap")


def trace_form_of(path: Path | str) -> TraceForm:
    """Return the form of a trace's file, which its suffix says.

    Raises:
        FreneticError: the suffix is neither ``.csv`` nor ``.mcap``, or it is ``.mcap`` and the
            extra ``mcap`` is not installed.
    """
    form = Path(path).suffix.lower().removeprefix(".")
    if form not in get_args(TraceForm):
        raise FreneticError(f"{path} is no name for a trace: it must end with .csv or .mcap")
    return check_form(form)


def _require_mcap() -> None:
    """Check that the extra ``mcap`` is installed.

    Raises:
        FreneticError: it is not; the message says how to install it.
    """
    try:
        import mcap.writer  # noqa: F401  # an extra
    except ImportError:
        raise FreneticError(
            f"an MCAP file needs mcap, which is not installed: {pip_install('mcap')}"
        ) from None


def write_trace(trace: DriveTrace, path: Path | str) -> None:
    """Write a trace to a file, whole or not at all; the suffix says the form.

    A CSV file has a column for each column of the trace and a row for each record. Its events,
    which are texts, are in a file of their own beside it: ``run.csv`` has ``run.events.csv``. An
    MCAP file has the topics of `frenetic.export.trace_mcap`.

    Args:
        trace: the trace.
        path: path that ends in ``.csv`` or ``.mcap``; an existing file is replaced.

    Raises:
        FreneticError: the suffix is another one, the file cannot be written, or it is ``.mcap`` and
            the extra ``mcap`` is not installed.
    """
    path = Path(path)
    form = trace_form_of(path)
    try:
        write_form(trace, path, form)
    except OSError as error:
        raise FreneticError(
            f"{path} cannot be written: {error.strerror or error}; choose another place"
        ) from None


def write_form(trace: DriveTrace, path: Path, form: TraceForm) -> None:
    """Write a trace to a file of a form, see `write_trace`.

    Raises:
        OSError: a file cannot be written; then all is as before.
    """
    if form == "csv":
        _write_csv(trace, path)
    else:
        _write_mcap(trace, path)


def _write_csv(trace: DriveTrace, path: Path) -> None:
    """Write a trace as CSV, and its events beside it.

    Raises:
        OSError: a file cannot be written; then both are as before.
    """
    events_path = path.with_name(path.stem + EVENTS)
    with replacing(path) as partial, replacing(events_path) as partial_events:
        lines = [",".join(map(field_name, trace.columns))]
        lines += [",".join(map(number_text, row)) for row in trace.values.T.tolist()]
        partial.write_bytes(("\n".join(lines) + "\n").encode("utf-8"))
        partial_events.write_bytes(_events_text(trace).encode("utf-8"))


def _events_text(trace: DriveTrace) -> str:
    """Return the events of a trace as CSV."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time_s", "event", "distance_m", "text"])
    for event in trace.events:
        distance = "" if event.distance is None else number_text(event.distance)
        cells = number_text(event.time), text_cell(event.name), distance, text_cell(event.text)
        writer.writerow(cells)
    return text.getvalue()


def _write_mcap(trace: DriveTrace, path: Path) -> None:
    """Write a trace as MCAP.

    Raises:
        OSError: the file cannot be written; then it is as before.
    """
    from frenetic.export.trace_mcap import write_messages  # imports an extra

    with replacing(path) as partial, partial.open("wb") as file:
        write_messages(trace, file)
