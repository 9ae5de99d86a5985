"""What a driver does in its passing drives, with which a mistake is compared."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import JSONValue
from frenetic.segments.bends import bends_of
from frenetic.segments.segment import Segment

# The values are our choice.
_LEAST_DRIVES: Final = 3  # fewest passing drives with which a mistake is compared
_LEAST_RECORDS: Final = 20  # fewest records of them
_LEAST_BENDS: Final = 5  # fewest bends of them
_OFFSET_QUANTILE: Final = 0.9  # quantile of the offsets up to which a car is as usual
_LOW, _HIGH = 0.25, 0.75  # quantiles between which demand and steering are as usual
_BEND: Final = 0.01  # [1/m] least curvature of a bend in which drives are compared
_ALIKE: Final = 0.15  # largest difference of two curvatures that are alike, as a share


@dataclass(frozen=True)
class UsualRange:
    """A quantity in passing drives, where the road bends as it does at a mistake."""

    text: str
    """The quantity in words, such as "usually has 5 to 6 m/s² in such bends"."""
    quantity: str
    """``lateral_acceleration`` in m/s², ``steering_into_bend`` in rad or ``offset`` in m."""
    low: float
    """Quantile of 25 % over bends or records; 0 for ``offset``."""
    high: float
    """Quantile of 75 % over bends or records, of 90 % for ``offset``."""
    drives: int
    """Number of drives from which the bends or records are."""

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
    steering_input: FloatArray
    """Angle of the front wheels that the driver asks for, in rad."""
    bends: FloatArray
    """Bends of the roads, (k, 3): index of the drive, sharpest curvature in 1/m, and the largest
    lateral acceleration that the road demands at the driver's speed, in m/s²."""

    @classmethod
    def of(cls, segments: Iterable[Segment]) -> PassingDrives | None:
        """Return the records of drives; None for fewer than three."""
        columns: list[list[FloatArray]] = []
        bends: list[tuple[float, float, float]] = []
        for number, segment in enumerate(segments):
            path, distance = segment.drive.trajectory, segment.assessment.distance
            curvature, n = segment.road.curvature_at(distance), len(distance)
            offset = segment.assessment.lateral_offset
            columns.append([offset, curvature, path.steering_input[:n]])
            demand = path.speed[:n] ** 2 * np.abs(curvature)
            for bend in bends_of(segment.road.curvatures, segment.road.step):
                inside = demand[(distance >= bend.start) & (distance <= bend.end)]
                if len(inside):
                    bends.append((number, bend.sharpest, float(inside.max())))
        if len(columns) < _LEAST_DRIVES:
            return None
        offset, curvature, steering_input = map(np.concatenate, zip(*columns, strict=True))
        return cls(
            drives=len(columns),
            offset=float(np.quantile(np.abs(offset), _OFFSET_QUANTILE)),
            drive=np.repeat(np.arange(len(columns)), [len(column[0]) for column in columns]),
            curvature=curvature,
            steering_input=steering_input,
            bends=np.array(bends, np.float64).reshape(-1, 3),
        )

    def usual_offset(self) -> UsualRange:
        """Return how far from its lane's middle the car is."""
        share = f"{100 * _OFFSET_QUANTILE:.0f} %"
        text = f"stays within {self.offset:.1f} m of its lane's middle for {share} of the time"
        return UsualRange(text, "offset", 0.0, self.offset, self.drives)

    def usual_demand(self, sharpest: float) -> UsualRange | None:
        """Return the largest lateral acceleration in bends alike; None with too few bends.

        Args:
            sharpest: largest curvature of the bend, in 1/m, without its sign.
        """
        drive, curvature, demand = self.bends.T
        alike = np.abs(curvature - sharpest) <= _ALIKE * sharpest
        drives = len(np.unique(drive[alike]))
        if alike.sum() < _LEAST_BENDS or drives < _LEAST_DRIVES:
            return None
        low, high = (float(value) for value in np.quantile(demand[alike], [_LOW, _HIGH]))
        text = f"usually has {_range_text(low, high)} m/s² in such bends"
        return UsualRange(text, "lateral_acceleration", low, high, drives)

    def usual_steering(self, curvature: float) -> UsualRange | None:
        """Return the steering into bends where their curvature is alike; None with few records.

        Args:
            curvature: curvature of the road, in 1/m; its sign does not matter.
        """
        if abs(curvature) < _BEND:
            return None
        into = self.steering_input * np.sign(self.curvature)
        difference = np.abs(np.abs(self.curvature) - abs(curvature))
        alike = (difference <= _ALIKE * abs(curvature)) & np.isfinite(into)
        drives = len(np.unique(self.drive[alike]))
        if alike.sum() < _LEAST_RECORDS or drives < _LEAST_DRIVES:
            return None
        low, high = (float(value) for value in np.quantile(into[alike], [_LOW, _HIGH]))
        text = f"usually steers {_range_text(np.degrees(low), np.degrees(high))}° into such bends"
        return UsualRange(text, "steering_into_bend", low, high, drives)


def _range_text(low: float, high: float) -> str:
    """Return a range of rounded numbers, such as ``38 to 44``."""
    texts = str(round(low)), str(round(high))
    return texts[0] if texts[0] == texts[1] else " to ".join(texts)
