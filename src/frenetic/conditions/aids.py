"""Conditions that help a driver, by which the cause of a failure is tried.

`frenetic.drivers.aids` has their wrappers. The ranges are our choice.
"""

from __future__ import annotations

import math
from typing import Final

from frenetic.conditions.declaration import Condition

_AIDS: Final = "frenetic.drivers.aids"

PACE: Final = Condition(
    name="pace",
    about="speed of the car as a share of the speed that its driver wants",
    low=0.2,
    high=2.0,
    usual=(0.8, 1.0),
    no_effect=1.0,
    wrapper=f"{_AIDS}:Paced",
    words=("slower driving", "faster driving"),
)
PREVIEW: Final = Condition(
    name="preview",
    about="time by which the driver sees the road earlier",
    unit="s",
    low=0.0,
    high=5.0,
    usual=(0.0, 0.5),
    no_effect=0.0,
    wrapper=f"{_AIDS}:SeesEarlier",
    words=("less preview", "more preview"),
)
PEDAL_RELEASE: Final = Condition(
    name="pedal_release",
    about="slip angle of an axle beyond which the pedals are released",
    unit="rad",
    low=0.01,
    high=1.5,
    usual=(0.05, 0.2),
    no_effect=math.inf,
    wrapper=f"{_AIDS}:ReleasesPedals",
    words=("pedals released sooner", "pedals released later"),
)
AIDS: Final = (PACE, PREVIEW, PEDAL_RELEASE)
"""All conditions that help a driver."""
