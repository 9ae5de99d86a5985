"""Drivers by name, with their options and layers.

The table `LAYERS` declares the layers; command line, campaigns' records and reports read it. A
layer is imported when it is laid, so help takes no time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from frenetic.errors import FreneticError
from frenetic.registry import DRIVERS

if TYPE_CHECKING:
    from frenetic.drivers.driver import Driver


@dataclass(frozen=True)
class Layer:
    """A kind of layer over any driver, with one number: its amount."""

    name: str
    """Name of its option, in a campaign's record and as an argument of `load_driver`."""
    target: str
    """``module:Class``; the class method ``over(driver, amount)`` lays it."""
    unit: str
    """Unit of the amount."""
    nothing: float
    """Amount without effect, which removes a recorded layer."""
    help: str
    """Description of the amount, in one sentence."""
    is_needed: bool = False
    """Whether every record of a command line holds it, null for no such layer. Records older than
    a layer lack it."""

    @property
    def another(self) -> str:
        """Help where the layer replaces a campaign's."""
        what = "all" if math.isinf(self.nothing) else "usual" if self.nothing else "none"
        return f"Another {self.name}, as in run; {self.nothing:g}: {what}."

    def over(self, driver: Driver, amount: float) -> Driver:
        """The driver under this layer.

        Raises:
            ValueError: the amount is out of range.
        """
        module, _, name = self.target.partition(":")
        layered: Driver = getattr(import_module(module), name).over(driver, amount)
        return layered


LAYERS: Final = [
    Layer(
        name="delay",
        target="frenetic.drivers.layers:Delayed",
        unit="s",
        nothing=0.0,
        help="Let the controls arrive this many s late.",
        is_needed=True,
    ),
    Layer(
        name="noise",
        target="frenetic.drivers.layers:Noisy",
        unit="m",
        nothing=0.0,
        help="Let the driver err about its lateral place, by this standard deviation in m.",
        is_needed=True,
    ),
    Layer(
        name="view",
        target="frenetic.drivers.layers:LimitedView",
        unit="m",
        nothing=math.inf,
        help="Let the driver see only this many m ahead.",
        is_needed=True,
    ),
    Layer(
        name="scene",
        target="frenetic.drivers.appearance:Elsewhere",
        unit="seed",
        nothing=0.0,
        help="Let a camera see another place: asphalt, land, sky and sun drawn from this seed.",
    ),
    Layer(
        name="wear",
        target="frenetic.drivers.appearance:Worn",
        unit="share",
        nothing=0.0,
        help="Let this share of the markings' paint be gone, for a camera.",
    ),
    Layer(
        name="fog",
        target="frenetic.drivers.appearance:Foggy",
        unit="m",
        nothing=math.inf,
        help="Let a camera see through fog, with a visibility of this many m.",
    ),
    Layer(
        name="rain",
        target="frenetic.drivers.appearance:Rainy",
        unit="mm/h",
        nothing=0.0,
        help="Let a camera see streaks of rain, of this rate in mm/h.",
    ),
    Layer(
        name="blur",
        target="frenetic.drivers.appearance:Blurred",
        unit="s",
        nothing=0.0,
        help="Let a camera expose for this many s, while the car moves.",
    ),
    Layer(
        name="light",
        target="frenetic.drivers.appearance:Lit",
        unit="factor",
        nothing=1.0,
        help="Let a camera get this many times the light that it is set for.",
    ),
    Layer(
        name="grain",
        target="frenetic.drivers.appearance:Grainy",
        unit="levels",
        nothing=0.0,
        help="Let a camera's sensor err, by this standard deviation of the values 0 to 255.",
    ),
]
"""All layers, the outermost first."""


def load_driver(
    spec: str, options: Mapping[str, Any] | None = None, **layers: float | None
) -> Driver:
    """The driver of a name, ``package.module:Class`` or ``file.py:Class``.

    Args:
        spec: which driver.
        options: passed to its class.
        layers: name -> amount of a layer of `LAYERS` to be laid over it, None for no such layer:
            ``noise`` in m, standard deviation of the lateral error of a `Noisy` layer, whose
            heading error is a tenth of it in rad per m; ``delay`` in s, of a `Delayed` layer;
            ``view`` in m, of a `LimitedView` layer; the others change what a camera sees, see
            `frenetic.drivers.appearance`.

    Raises:
        FreneticError: it cannot be loaded or made, or a layer's amount is out of range.
        TypeError: there is no such layer.
    """
    driver: Driver = DRIVERS.make(spec, **(options or {}))
    return under(layers, driver)


def under(layers: Mapping[str, float | None], driver: Driver) -> Driver:
    """A driver under layers, which are given as to `load_driver`; likewise."""
    if unknown := layers.keys() - {layer.name for layer in LAYERS}:
        raise TypeError(f"there is no layer {', '.join(sorted(unknown))}")
    for layer in reversed(LAYERS):
        amount = layers.get(layer.name)
        if amount is not None:
            try:
                driver = layer.over(driver, amount)
            except ValueError as error:
                raise FreneticError(str(error)) from None
    return driver
