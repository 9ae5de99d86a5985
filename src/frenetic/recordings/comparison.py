"""How a drive differs from a recorded drive on the same road, place by place."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import FreneticError
from frenetic.export.traces import DriveTrace
from frenetic.recordings.recording import Recording
from frenetic.road import Road

SPACING: Final = 1.0
"""Distance along the road between two places of a comparison, in m; our choice."""
_FARTHEST: Final = 20.0
"""Largest median distance between a recording and its road, in m; our choice."""
_LATEST_SPEED: Final = 0.2
"""Latest time of the first known speed, in s, where places follow from speeds; our choice."""
_MIN_PLACES: Final = 2
"""Fewest places of a comparison."""


class ShownSignal(NamedTuple):
    """How people see a signal."""

    text: str
    unit: str
    scale: float = 1.0
    """Number of shown units in one of our units."""


SHOWN: Final[Mapping[str, ShownSignal]] = {
    "lateral_offset": ShownSignal("lateral offset, + is left", "m"),
    "heading_error": ShownSignal("heading error, + is left", "°", math.degrees(1.0)),
    "speed": ShownSignal("speed", "km/h", 3.6),
    "time": ShownSignal("time", "s"),
    "steering": ShownSignal("steering, + is left", "°", math.degrees(1.0)),
    "yaw_rate": ShownSignal("yaw rate, + is left", "°/s", math.degrees(1.0)),
    "lateral_speed": ShownSignal("lateral speed, + is left", "m/s"),
    "lateral_acceleration": ShownSignal("lateral acceleration, + is left", "m/s²"),
    "acceleration": ShownSignal("acceleration", "m/s²"),
    "throttle": ShownSignal("throttle", ""),
    "brake": ShownSignal("brake", ""),
}
"""Signals that are compared, in the order in which they are shown."""


class SignalDifference(NamedTuple):
    """How much a signal of a drive differs from the recorded one."""

    signal: str
    unit: str
    mean: float
    """Mean of the differences without their signs."""
    largest: float
    """Largest difference, driven minus recorded."""
    distance: float
    """Where it is, in m along the road."""
    recorded: float
    """Recorded value there."""
    driven: float
    """Value of the drive there."""

    def as_json(self) -> dict[str, Any]:
        """Return the difference for JSON."""
        return {
            "signal": self.signal,
            "unit": self.unit,
            "mean_difference": self.mean,
            "largest_difference": self.largest,
            "distance": self.distance,
            "recorded": self.recorded,
            "driven": self.driven,
        }


@dataclass(frozen=True, eq=False)
class RecordingComparison:
    """A drive beside a recorded drive on the same road."""

    recording: Recording
    place_source: str
    """The channels from which the recording's place on the road follows."""
    distances: FloatArray
    """Places along the road where both were, (n,) in m."""
    recorded: Mapping[str, FloatArray]
    """Name of a signal -> recorded values in shown units, (n,); NaN where unknown."""
    driven: Mapping[str, FloatArray]
    """Name of a signal -> values of the drive in shown units, (n,)."""

    @property
    def differences(self) -> list[SignalDifference]:
        """Differences of the signals that both have."""
        differences = []
        for signal, recorded in self.recorded.items():
            error = self.driven[signal] - recorded
            if not np.isfinite(error).any():
                continue
            place = int(np.nanargmax(np.abs(error)))
            differences.append(
                SignalDifference(
                    signal,
                    SHOWN[signal].unit,
                    float(np.nanmean(np.abs(error))),
                    float(error[place]),
                    float(self.distances[place]),
                    float(recorded[place]),
                    float(self.driven[signal][place]),
                )
            )
        return differences

    def as_json(self) -> dict[str, Any]:
        """Return the comparison for JSON."""
        return {
            "recording": self.recording.name,
            "channels": dict(self.recording.channels),
            "place_source": self.place_source,
            "from": float(self.distances[0]),
            "to": float(self.distances[-1]),
            "signals": [difference.as_json() for difference in self.differences],
        }


def compare_with_recording(
    roads: Sequence[Road], trace: DriveTrace, recording: Recording
) -> RecordingComparison:
    """Compare a drive with a recorded one at the same places of the road.

    Args:
        roads: the road that was driven, and the same road where a recording's x and y may have it.
        trace: trace of the drive.
        recording: the recorded drive.

    Raises:
        FreneticError: the recording does not say where on the road the car was, lies elsewhere, or
            shares no stretch of road with the drive.
    """
    sources, signals = along_road(recording, roads)
    columns = {column.name: trace.column(column.name) for column in trace.columns}
    low = max(_first(signals["distance"]), _first(columns["distance"]))
    high = min(np.nanmax(signals["distance"]), np.nanmax(columns["distance"]))
    start = math.ceil(low / SPACING)
    distances = SPACING * np.arange(start, math.floor(high / SPACING) + 1, dtype=np.float64)
    if len(distances) < _MIN_PLACES:
        raise FreneticError(
            f"{recording.name} is from {low:.0f} m of the road on: the drive and it share no"
            " stretch of the road"
        )
    recorded, driven = {}, {}
    for signal, shown in SHOWN.items():
        if signal in signals and signal in columns:
            values = at_distances(signals, signal, distances)
            if np.isfinite(values).any():
                recorded[signal] = shown.scale * values
                driven[signal] = shown.scale * at_distances(columns, signal, distances)
    if "time" in recorded:  # from the first common place on
        recorded["time"] = recorded["time"] - recorded["time"][0]
        driven["time"] = driven["time"] - driven["time"][0]
    place_source = " and ".join(recording.channels[source] for source in sources)
    return RecordingComparison(recording, place_source, distances, recorded, driven)


def along_road(
    recording: Recording, roads: Sequence[Road]
) -> tuple[tuple[str, ...], dict[str, FloatArray]]:
    """Return a recording's signals with its distance along the road, and its offset if known.

    Args:
        recording: the recording.
        roads: the same road at several places; the one nearest to the recording counts.

    Returns:
        Names of the signals from which the distance follows, and name of a signal -> values.

    Raises:
        FreneticError: the recording does not say where the car was or how fast at the beginning, or
            lies elsewhere.
    """
    signals = {**recording.signals, "time": recording.time}
    if "distance" in signals and "lateral_offset" in signals:
        return ("distance",), signals
    if "x" in signals and "y" in signals:
        return ("x", "y"), {**signals, **_tracked(recording, roads)}
    source = "distance"
    if "distance" not in signals:
        source = "speed"
        if "speed" not in signals:
            raise FreneticError(
                f"{recording.name} does not say where the car was: it needs x and y, the distance"
                " along the road, or the speed"
            )
        signals["distance"] = _driven(recording)
    return (source,), signals


def _driven(recording: Recording) -> FloatArray:
    """Return the distance that a recorded car has driven, (n,) in m, by its speed.

    The first known speed holds before it. After the last known speed the distance is unknown.

    Raises:
        FreneticError: the speed is not known at the beginning.
    """
    speed = recording.signals["speed"].copy()
    known = np.flatnonzero(np.isfinite(speed))
    if not len(known) or recording.time[known[0]] > _LATEST_SPEED:
        raise FreneticError(
            f"{recording.name} has no speed in its first {_LATEST_SPEED:g} s, and neither x and y"
            " nor the distance along the road: where the car was does not follow"
        )
    speed[: known[0]] = speed[known[0]]
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(recording.time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _tracked(recording: Recording, roads: Sequence[Road]) -> dict[str, FloatArray]:
    """Return distance and lateral offset of a recording's path.

    Raises:
        FreneticError: the path lies far from the road.
    """
    path = np.column_stack([recording.signals["x"], recording.signals["y"]])
    is_known = np.isfinite(path).all(axis=1)
    if not is_known.any():
        raise FreneticError(f"{recording.name} has no record with both x and y")
    tracks = [road.track(path[is_known]) for road in roads]
    nearest = min(range(len(roads)), key=lambda i: float(np.median(np.abs(tracks[i][:, 1]))))
    offset = tracks[nearest][:, 1] + 0.5 * roads[nearest].lane_width
    if (far := float(np.median(np.abs(offset)))) > _FARTHEST:
        raise FreneticError(
            f"{recording.name} lies {far:.0f} m beside the road: is it of another road, or on"
            " another map?"
        )
    columns = np.full((2, len(path)), np.nan)
    columns[:, is_known] = tracks[nearest][:, 0], offset
    return {"distance": columns[0], "lateral_offset": columns[1]}


def at_distances(
    signals: Mapping[str, FloatArray], signal: str, distances: FloatArray
) -> FloatArray:
    """Return a signal at distances along the road, (n,); NaN where it is unknown.

    Where the car went backwards, its first time at a place counts.
    """
    place, values = signals["distance"], signals[signal]
    is_known = np.isfinite(place) & np.isfinite(values)
    place, values = place[is_known], values[is_known]
    if not len(place):
        return np.full(len(distances), np.nan)
    is_new = np.diff(np.maximum.accumulate(place), prepend=-np.inf) > 0.0
    at: FloatArray = np.interp(distances, place[is_new], values[is_new], left=np.nan, right=np.nan)
    return at


def _first(values: FloatArray) -> float:
    """Return the first known value.

    The caller has a value: a recording has known distances.
    """
    return float(values[np.isfinite(values)][0])
