"""A drive that was recorded elsewhere: its signals, which are recognised by names and units."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from frenetic._support.arrays import FloatArray
from frenetic._support.car_signals import CAR_SIGNALS, PEDALS, CarSignal
from frenetic._support.option_text import read_part
from frenetic._support.signal_links import SignalLink, known_unit, units_in
from frenetic._support.signal_names import compact, spellings
from frenetic._support.units import unit_named
from frenetic.errors import FreneticError
from frenetic.parts.registry import hint
from frenetic.recordings.channels import RecordedChannel, Samples, open_channels
from frenetic.spec import read_entries

MEASURED: Final[Mapping[str, CarSignal]] = {
    **CAR_SIGNALS,
    "lateral_acceleration": CarSignal("m/s2", "", ("ay", "latacc", "lateralacc", "accy", "ya")),
    "acceleration": CarSignal("m/s2", "along the car", ("ax", "longacc", "accx", "axlong")),
    **PEDALS,
}
"""Signals that a recording may hold, by name; left is positive."""
_TIME: Final = "time"
_MOST_NAMES: Final = 100
"""More than the number of names of any signal."""
_BASES: Final = ("x", "lateral_offset", "distance", "speed")
"""Signals of which the first that is there gives the times of a recording."""


class ChannelTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Which channels of a recording are which signals."""

    channels: Mapping[str, bool | str | SignalLink] = {}
    """Channel -> its signal; false for a channel that is no signal."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A drive that was recorded elsewhere."""

    name: str
    """Path of its file."""
    time: FloatArray
    """Times, which grow, (n,) in s; the first is 0."""
    signals: Mapping[str, FloatArray]
    """Name of a signal of `MEASURED` -> values in our units, (n,); NaN where unknown."""
    channels: Mapping[str, str]
    """Name of a signal -> its channel with its unit, as text."""


class RecordingFile(NamedTuple):
    """A recording's file and the options after its name: ``run.mf4,signals=table.toml``."""

    path: Path
    options: Mapping[str, Any]

    @classmethod
    def of(cls, text: str, allowed: Iterable[str] = ("signals",)) -> RecordingFile:
        """Return the file and options of a text.

        The path of an existing file or folder has no options, whatever its name.

        Raises:
            FreneticError: there is no name, or an option is unknown or has no value.
        """
        if (path := Path(text).expanduser()).exists():
            return cls(path, {})
        try:
            name, options = read_part(text)
        except ValueError as error:
            raise FreneticError(f"{text}: {error}") from None
        if not name:
            raise FreneticError(f"{text} names no file: the file comes first, then its options")
        names = list(allowed)
        for option in options:
            if option not in names:
                raise FreneticError(
                    f"{text}: a recording has no option {option!r}{hint(option, names)} It has:"
                    f" {', '.join(names)}"
                )
        return cls(Path(name).expanduser(), options)


class _Choice(NamedTuple):
    """A channel that may be a signal."""

    rank: int
    """0 for a channel of the table. For others, the fuller the spelling of the name that is known,
    the lower; then the place of this name among the signal's names."""
    channel: RecordedChannel
    link: SignalLink
    factor: float
    """Number of our units in one unit of the channel, divided by the link's factor."""


def read_recording(file: RecordingFile) -> Recording:
    """Read a recording.

    Raises:
        FreneticError: the file or its table cannot be read, two channels may be one signal, or
            there are no times.
    """
    table = ChannelTable()
    if (table_path := file.options.get("signals")) is not None:
        table = read_entries(
            Path(str(table_path)).expanduser(), ChannelTable, "a table of channels"
        )
    try:
        with open_channels(file.path) as channels:
            choices = _choose(channels, table)
            samples = {signal: _read(choice) for signal, choice in choices.items()}
        time, values = _on_one_clock(samples)
    except ValueError as error:
        raise FreneticError(f"{file.path}: {error}") from None
    texts = {
        signal: f"{choice.channel.name} in {unit}"
        if (unit := choice.link.unit or choice.channel.unit)
        else choice.channel.name
        for signal, choice in choices.items()
    }
    return Recording(str(file.path), time, values, texts)


def _choose(channels: Iterable[RecordedChannel], table: ChannelTable) -> dict[str, _Choice]:
    """Return the channel of each signal.

    Raises:
        ValueError: the table names no channel or no signal, or two channels may be one signal.
    """
    channels = list(channels)
    names = {channel.name for channel in channels}
    for name in table.channels:
        if name not in names:
            raise ValueError(f"it has no channel {name!r}{hint(name, names)}")
    choices: dict[str, list[_Choice]] = {}
    for channel in channels:
        choice = _choice(channel, table.channels.get(channel.name))
        if choice is not None:
            choices.setdefault(choice.link.signal, []).append(choice)
    return {signal: _best(signal, candidates) for signal, candidates in choices.items()}


def _choice(channel: RecordedChannel, entry: bool | str | SignalLink | None) -> _Choice | None:
    """Return which signal a channel may be; None if none is known.

    Raises:
        ValueError: the table's entry names no signal, or the channel's unit does not suit it.
    """
    if isinstance(entry, bool):
        if entry:
            raise ValueError(f"the channel {channel.name} is true: a signal, or false, is needed")
        return None
    unit = None if channel.unit is None else unit_named(channel.unit)
    if entry is None:
        guess = _ranked(channel.name)
        if guess is None:
            return None
        rank, link = guess
        try:
            factor = units_in(
                link, channel.name, channel.unit, unit, known_unit(MEASURED[link.signal].unit)
            )
        except ValueError:  # so it is another signal of the same name
            return None
        return _Choice(rank, channel, link, factor)
    link = entry if isinstance(entry, SignalLink) else SignalLink(signal=entry)
    if link.signal not in MEASURED:
        raise ValueError(
            f"the channel {channel.name}: there is no signal {link.signal!r}"
            f"{hint(link.signal, MEASURED)} There are {', '.join(MEASURED)}"
        )
    our_unit = known_unit(MEASURED[link.signal].unit)
    try:
        factor = units_in(link, channel.name, channel.unit, unit, our_unit)
    except ValueError as error:
        raise ValueError(f"the channel {error}") from None
    return _Choice(0, channel, link, factor / link.factor)


def _ranked(name: str) -> tuple[int, SignalLink] | None:
    """Return the rank of a channel's name, and the link with its signal; None if not known."""
    for omitted, spelling in enumerate(spellings(name)):
        for signal, item in MEASURED.items():
            usual_names = (compact(signal), *item.names)
            if spelling in usual_names:
                rank = 1 + _MOST_NAMES * omitted + usual_names.index(spelling)
                return rank, SignalLink(signal=signal)
    return None


def _best(signal: str, choices: list[_Choice]) -> _Choice:
    """Return the channel of a signal: of the table, else of the most usual name.

    Of channels with the same name, the one with the most samples counts.

    Raises:
        ValueError: two names are equally usual.
    """
    rank = min(choice.rank for choice in choices)
    best = [choice for choice in choices if choice.rank == rank]
    names = list(dict.fromkeys(choice.channel.name for choice in best))
    if len(names) > 1:
        raise ValueError(
            f"its channels {' and '.join(names[:5])} may each be the {signal}: name one in a table,"
            " signals=table.toml"
        )
    return max(best, key=lambda choice: choice.channel.size)


def _read(choice: _Choice) -> Samples:
    """Return the samples of a channel in our unit.

    Raises:
        ValueError: the samples are no numbers.
    """
    try:
        samples = choice.channel.read()
    except ValueError as error:
        raise ValueError(f"its channel {choice.channel.name}: {error}") from None
    return samples._replace(values=choice.factor * samples.values)


def _on_one_clock(samples: Mapping[str, Samples]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the times of a recording and its signals at these times.

    Raises:
        ValueError: there are no times, no signal, or fewer than two times.
    """
    base = next((signal for signal in _BASES if signal in samples), None)
    if base is None:
        raise ValueError(
            "no channel is known for x and y, lateral_offset, distance or speed: name one in a"
            " table, signals=table.toml"
        )
    times = {signal: _times(signal, samples) for signal in samples if signal != _TIME}
    time = times[base][_grow(times[base])]
    if len(time) < 2:
        raise ValueError(f"it has {len(time)} times that grow: two or more are needed")
    values = {}
    for signal, signal_times in times.items():
        column = samples[signal].values
        is_known = _grow(signal_times) & np.isfinite(column)
        if is_known.any():
            known = column[is_known]
            if signal == "heading":
                known = np.unwrap(known)
            values[signal] = np.interp(
                time, signal_times[is_known], known, left=np.nan, right=np.nan
            )
    return time - time[0], values


def _grow(times: FloatArray) -> npt.NDArray[np.bool_]:
    """Return which times are later than all times before, (n,)."""
    is_later: npt.NDArray[np.bool_] = np.isfinite(times)
    is_later[is_later] = np.diff(np.maximum.accumulate(times[is_later]), prepend=-np.inf) > 0.0
    return is_later


def _times(signal: str, samples: Mapping[str, Samples]) -> FloatArray:
    """Return the times of a signal's samples, (n,) in s.

    Raises:
        ValueError: there are none.
    """
    times = samples[signal].time
    if times is None:
        if _TIME not in samples:
            raise ValueError(
                "no channel is known for the time: name one in a table, signals=table.toml"
            )
        times = samples[_TIME].values
    return times
