"""What a driver does in its passing drives, with which a mistake is compared."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import JSONValue
from frenetic.segments.segment import Segment

# The values are our choice.
_LEAST_DRIVES: Final = 3  # fewest passing drives with which a mistake is compared
_LEAST_RECORDS: Final = 20  # fewest records of them
_OFFSET_QUANTILE: Final = 0.9  # quantile of the offsets up to which a car is as usual
_LOW, _HIGH = 0.25, 0.75  # quantiles between which speed and steering are as usual
_BEND: Final = 0.01  # [1/m] least curvature of a bend in which drives are compared
_ALIKE: Final = 0.15  # largest difference of two curvatures that are alike, as a share


@dataclass(frozen=True)
class Usual:
    """A quantity in passing drives, where the road bends as it does at a mistake."""

    text: str
    """The quantity in words, such as "usually takes such bends at 38 to 44 km/h"."""
    quantity: str
    """``speed`` in m/s, ``steering_into_bend`` in rad or ``offset`` in m."""
    low: float
    """Quantile of 25 % over the records; 0 for ``offset``."""
    high: float
    """Quantile of 75 % over the records, of 90 % for ``offset``."""
    drives: int
    """Number of drives from which the records are."""

    def as_json(self) -> dict[str, JSONValue]:
        """Return the quantity as a JSON object, without its text."""
        return {
            "quantity": self.quantity,
            "low": round(self.low, 4),
            "high": round(self.high, 4),
            "drives": self.drives,
        }


@dataclass(frozen=True, eq=False)
class PassingDrives:
    """Records of a driver's passing drives, one after the other: (n,) arrays."""

    drives: int
    """Number of drives."""
    offset: float
    """Offset from the lane's middle within which the car is for 90 % of the records, in m."""
    drive: npt.NDArray[np.int64]
    """Index of the drive."""
    curvature: FloatArray
    """Curvature of the road beside the car, in 1/m, positive to the left."""
    speed: FloatArray
    """Speed, in m/s."""
    steering_input: FloatArray
    """Angle of the front wheels that the driver asks for, in rad."""

    @classmethod
    def of(cls, segments: Iterable[Segment]) -> PassingDrives | None:
        """Return the records of drives; None for fewer than three."""
        columns: list[list[FloatArray]] = []
        for segment in segments:
            path, n = segment.drive.trajectory, len(segment.assessment.distance)
            columns.append(
                [
                    segment.assessment.lateral_offset,
                    segment.road.curvature_at(segment.assessment.distance),
                    path.speed[:n],
                    path.steering_input[:n],
                ]
            )
        if len(columns) < _LEAST_DRIVES:
            return None
        offset, curvature, speed, steering_input = map(np.concatenate, zip(*columns, strict=True))
        return cls(
            drives=len(columns),
            offset=float(np.quantile(np.abs(offset), _OFFSET_QUANTILE)),
            drive=np.repeat(np.arange(len(columns)), [len(column[0]) for column in columns]),
            curvature=curvature,
            speed=speed,
            steering_input=steering_input,
        )

    def usual_offset(self) -> Usual:
        """Return how far from its lane's middle the car is."""
        text = f"stays within {self.offset:.1f} m of its lane's middle for 90 % of the time"
        return Usual(text, "offset", 0.0, self.offset, self.drives)

    def usual_speed(self, curvature: float) -> Usual | None:
        """Return the speed in bends of a curvature, in 1/m; None with too few records."""
        values = self._in_bends_like(curvature, self.speed)
        if values is None:
            return None
        low, high, drives = values
        text = f"usually takes such bends at {_range_text(low * 3.6, high * 3.6)} km/h"
        return Usual(text, "speed", low, high, drives)

    def usual_steering(self, curvature: float) -> Usual | None:
        """Return the steering into bends of a curvature, in 1/m; None with too few records."""
        into = self.steering_input * np.sign(self.curvature)
        values = self._in_bends_like(curvature, into)
        if values is None:
            return None
        low, high, drives = values
        text = f"usually steers {_range_text(np.degrees(low), np.degrees(high))}° into such bends"
        return Usual(text, "steering_into_bend", low, high, drives)

    def _in_bends_like(
        self, curvature: float, values: FloatArray
    ) -> tuple[float, float, int] | None:
        """Return two quantiles of values in bends of a curvature to either side, and the drives."""
        if abs(curvature) < _BEND:
            return None
        difference = np.abs(np.abs(self.curvature) - abs(curvature))
        alike = np.flatnonzero((difference <= _ALIKE * abs(curvature)) & np.isfinite(values))
        drives = len(np.unique(self.drive[alike]))
        if len(alike) < _LEAST_RECORDS or drives < _LEAST_DRIVES:
            return None
        low, high = np.quantile(values[alike], [_LOW, _HIGH])
        return float(low), float(high), drives


def _range_text(low: float, high: float) -> str:
    """Return a range of rounded numbers, such as ``38 to 44``."""
    texts = f"{low:.0f}", f"{high:.0f}"
    return texts[0] if texts[0] == texts[1] else " to ".join(texts)
