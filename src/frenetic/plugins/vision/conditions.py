"""The conditions that change what a driver's camera sees.

`frenetic.plugins.vision.appearance` has their wrappers. The conditions are in the order in which a
picture is made: the world first, the camera's sensor last. The ranges are our choice.
"""

from __future__ import annotations

import math
from typing import Final

from frenetic.conditions.declaration import FARTHEST, Condition

_MODULE: Final = "frenetic.plugins.vision.appearance"

SCENE: Final = Condition(
    name="scene",
    about="seed of the asphalt, land, sky and sun that a camera sees",
    low=0.0,
    high=1e6,
    usual=(0.0, 1000.0),
    no_effect=0.0,
    wrapper=f"{_MODULE}:Elsewhere",
    needs_camera=True,
    words=("a scene of a lower seed", "a scene of a higher seed"),
)
WEAR: Final = Condition(
    name="wear",
    about="share of the markings' paint that is gone, for a camera",
    low=0.0,
    high=1.0,
    usual=(0.0, 0.8),
    no_effect=0.0,
    wrapper=f"{_MODULE}:Worn",
    needs_camera=True,
)
FOG: Final = Condition(
    name="fog",
    about="visibility in the fog that a camera sees",
    unit="m",
    low=2.0,
    high=FARTHEST,
    usual=(30.0, 300.0),
    no_effect=math.inf,
    wrapper=f"{_MODULE}:Foggy",
    needs_camera=True,
    words=("thicker fog", "thinner fog"),
)
RAIN: Final = Condition(
    name="rain",
    about="rate of the rain that a camera sees",
    unit="mm/h",
    low=0.0,
    high=200.0,
    usual=(0.0, 20.0),
    no_effect=0.0,
    wrapper=f"{_MODULE}:Rainy",
    needs_camera=True,
    is_seeded=True,
)
BLUR: Final = Condition(
    name="blur",
    about="time of a camera's exposure, while the car moves",
    unit="s",
    low=0.0,
    high=0.5,
    usual=(0.0, 0.05),
    no_effect=0.0,
    wrapper=f"{_MODULE}:Blurred",
    needs_camera=True,
)
LIGHT: Final = Condition(
    name="light",
    about="factor of the light that a camera gets, 1 is what it is set for",
    low=0.01,
    high=10.0,
    usual=(0.4, 1.6),
    no_effect=1.0,
    wrapper=f"{_MODULE}:Lit",
    needs_camera=True,
)
GRAIN: Final = Condition(
    name="grain",
    about="standard deviation of a camera's noise, of the values 0 to 255",
    low=0.0,
    high=128.0,
    usual=(0.0, 20.0),
    no_effect=0.0,
    wrapper=f"{_MODULE}:Grainy",
    needs_camera=True,
    is_seeded=True,
)

CONDITIONS: Final = (SCENE, WEAR, FOG, RAIN, BLUR, LIGHT, GRAIN)
