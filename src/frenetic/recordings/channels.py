"""Channels of a recording's file: CSV, or MDF, which asammdf reads."""

from __future__ import annotations

import csv
import gc
import io
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.files import open_file
from frenetic._support.words import pip_install
from frenetic.errors import FreneticError, describe_error

CSV: Final = ".csv"
"""Suffix of recordings as tables."""
MDF: Final = (".mf4", ".mf3", ".mdf", ".dat")
"""Suffixes of recordings in MDF, ASAM's measurement data format."""
SUFFIXES: Final = (CSV, *MDF)
"""Suffixes of all recordings."""
_MOST_BYTES: Final = 2**28
"""Largest size of a CSV file, in bytes; our choice."""
_UNIT: Final = re.compile(r"(.*\S)\s*[\[(]([^\])]*)[\])]")
"""Heading of a column with its unit in brackets, such as ``speed [km/h]``."""


class Samples(NamedTuple):
    """Samples of a channel."""

    time: FloatArray | None
    """Times in s, (n,); None if another channel holds the times."""
    values: FloatArray
    """Values in the channel's unit, (n,); NaN for a missing value."""


class RecordedChannel(NamedTuple):
    """A channel of a recording, whose samples are read when they are needed."""

    name: str
    unit: str | None
    """Name of the unit; None if the file names none."""
    size: int
    """Number of samples."""
    read: Callable[[], Samples]
    """Function that reads the samples.

    Raises:
        ValueError: the samples are no numbers.
    """


@contextmanager
def open_channels(path: Path) -> Iterator[list[RecordedChannel]]:
    """Open a recording's file and yield its channels, which can be read until the file is closed.

    Raises:
        FreneticError: there is no such file, it is damaged or too large, it has another suffix, or
            asammdf is not installed.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise FreneticError(f"{path} is no recording: it must end with {' or '.join(SUFFIXES)}")
    if not path.is_file():
        raise FreneticError(f"there is no file {path}")
    if suffix == CSV:
        yield _csv_channels(path)
        return
    file, channels = _open_mdf(path)
    try:
        yield channels
    finally:
        file.close()


def _csv_channels(path: Path) -> list[RecordedChannel]:
    """Return the columns of a CSV file, whose first row has their names.

    Raises:
        FreneticError: the file cannot be read, is too large, or is no table.
    """
    try:
        with open_file(path) as file:
            data = file.read(_MOST_BYTES + 1)
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise FreneticError(f"{path} is no CSV file: it is no UTF-8") from None
    if len(data) > _MOST_BYTES:
        raise FreneticError(f"{path} is too large: more than {_MOST_BYTES / 2**20:.0f} MiB")
    heading = text.partition("\n")[0]
    delimiter = max(",;\t", key=heading.count)
    try:
        names, *rows = [row for row in csv.reader(io.StringIO(text), delimiter=delimiter) if row]
    except (ValueError, csv.Error) as error:
        raise FreneticError(f"{path} is no CSV file with a row of names: {error}") from None

    def reader(column: int) -> Callable[[], Samples]:
        def read() -> Samples:
            cells = (row[column].strip() if column < len(row) else "" for row in rows)
            return Samples(None, np.array([float(cell) if cell else np.nan for cell in cells]))

        return read

    channels = []
    for column, heading in enumerate(names):
        heading = heading.strip()
        match = _UNIT.fullmatch(heading)
        name, unit = (match[1], match[2]) if match is not None else (heading, None)
        channels.append(RecordedChannel(name, unit, len(rows), reader(column)))
    return channels


def _open_mdf(path: Path) -> tuple[Any, list[RecordedChannel]]:
    """Return an open MDF file and its channels.

    Raises:
        FreneticError: asammdf is not installed, or cannot read the file.
    """
    try:
        import asammdf  # of the extra "mdf"
    except ImportError as error:
        raise FreneticError(f"an MDF file needs asammdf: {pip_install('mdf')}") from error
    with _unheard_deletions():
        try:
            file: Any = asammdf.MDF(path)
            return file, [
                _mdf_channel(file, number, index, channel)
                for number, group in enumerate(file.groups)
                for index, channel in enumerate(group.channels)
                if file.masters_db.get(number) != index
            ]
        except Exception as error:  # asammdf raises many classes
            reason = describe_error(error)
        # Not within `except`: the error, which holds asammdf's object, must be gone.
        gc.collect()
        raise FreneticError(f"{path} is no MDF file that can be read: {reason}")


@contextmanager
def _unheard_deletions() -> Iterator[None]:
    """Say nothing about errors that deleted objects raise, as asammdf's do for damaged files."""
    before = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = before


def _mdf_channel(file: Any, group: int, index: int, channel: Any) -> RecordedChannel:
    """Return a channel of an MDF file."""

    def read() -> Samples:
        try:
            signal = file.get(group=group, index=index)
        except Exception as error:  # asammdf raises many classes
            raise ValueError(f"it cannot be read: {describe_error(error)}") from None
        values = np.asarray(signal.samples)
        if values.ndim != 1 or values.dtype.kind not in "biuf":
            raise ValueError("its samples are no numbers")
        return Samples(np.asarray(signal.timestamps, dtype=np.float64), values.astype(np.float64))

    unit = channel.unit or getattr(channel.conversion, "unit", "") or None
    size = int(file.groups[group].channel_group.cycles_nr)
    return RecordedChannel(channel.name, unit, size, read)
