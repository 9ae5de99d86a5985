"""Units of signals that come from elsewhere: their names, and their factors to our units."""

from __future__ import annotations

import math
import re
from typing import Final, NamedTuple


class Unit(NamedTuple):
    """A unit: what it is in metres, seconds and radians."""

    factor: float
    """Number of SI units in one of the unit: 0.2778 for km/h."""
    metres: int = 0
    """Exponent of the metre."""
    seconds: int = 0
    """Exponent of the second."""

    def is_like(self, other: Unit) -> bool:
        """Return whether both units measure the same: an angle has no dimension."""
        return (self.metres, self.seconds) == (other.metres, other.seconds)


_DEGREE: Final = math.pi / 180.0
_UNITS: Final = {
    "1": Unit(1.0),
    "%": Unit(0.01),
    "rad": Unit(1.0),
    "mrad": Unit(1e-3),
    "deg": Unit(_DEGREE),
    "m": Unit(1.0, 1),
    "cm": Unit(0.01, 1),
    "mm": Unit(1e-3, 1),
    "km": Unit(1e3, 1),
    "1/m": Unit(1.0, -1),
    "1/km": Unit(1e-3, -1),
    "s": Unit(1.0, 0, 1),
    "ms": Unit(1e-3, 0, 1),
    "us": Unit(1e-6, 0, 1),
    "ns": Unit(1e-9, 0, 1),
    "m/s": Unit(1.0, 1, -1),
    "km/h": Unit(1.0 / 3.6, 1, -1),
    "mph": Unit(0.44704, 1, -1),
    "rad/s": Unit(1.0, 0, -1),
    "deg/s": Unit(_DEGREE, 0, -1),
    "m/s2": Unit(1.0, 1, -2),
    "g": Unit(9.80665, 1, -2),
}
"""Name of a unit -> the unit."""
_OTHER_NAMES: Final = {
    "": "1",
    "-": "1",
    "percent": "%",
    "kmh": "km/h",
    "kph": "km/h",
    "kmph": "km/h",
    "mps": "m/s",
    "ms-1": "m/s",
    "m.s-1": "m/s",
    "m-1": "1/m",
    "mps2": "m/s2",
    "ms-2": "m/s2",
    "m.s-2": "m/s2",
    "m/s/s": "m/s2",
    "rads-1": "rad/s",
    "rad.s-1": "rad/s",
    "radps": "rad/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "sec": "s",
    "second": "s",
}
"""Other name of a unit -> its name in `_UNITS`."""


def unit_named(name: str) -> Unit | None:
    """Return the unit that a name stands for, such as ``km/h`` or ``°/s``; None if unknown."""
    text = re.sub(r"degrees?|°", "deg", name.strip().replace("²", "2"))
    text = re.sub(r"[\s^()*]", "", text)
    for spelling in (text, text.lower()):
        if (unit := _UNITS.get(_OTHER_NAMES.get(spelling, spelling))) is not None:
            return unit
    return None


def unit_spellings() -> tuple[str, ...]:
    """Return all names of the known units, in the order in which they are declared."""
    return tuple(dict.fromkeys([*_UNITS, *_OTHER_NAMES]))


def known_units() -> str:
    """Return the names of the known units, with commas between."""
    return ", ".join(_UNITS)
