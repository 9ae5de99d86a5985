"""Wrappers over a driver with a camera: scenery, worn markings, fog, rain, blur, light and grain.

Scenery and wear say what is drawn, which only the embedded simulator does. The others
change the picture of any simulator: each is a function of the picture, the camera and the
observation, on the assumption that the ground is flat.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar, Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, check
from frenetic.conditions.condition import Condition
from frenetic.drivers.camera import Scene
from frenetic.drivers.driver import (
    Controls,
    Driver,
    Observation,
    OwnWrapper,
    camera_of,
)
from frenetic.plugins.vision.conditions import (
    BLUR,
    CONDITIONS,
    FOG,
    GRAIN,
    LIGHT,
    RAIN,
    SCENE,
    WEAR,
)
from frenetic.plugins.vision.motion import ground_distances, picture_motion, smear

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.drivers.camera import Image

GAMMA: Final = 2.2
"""Exponent that takes a value of a picture, from 0 to 1, to light."""
FOG_COLOUR: Final = (202.0, 206.0, 210.0)
"""Colour of fog without anything in it."""
RAIN_COLOUR: Final = (214.0, 219.0, 226.0)
"""Colour of a streak of rain."""

_BANK = 1 << 16  # different beginnings of the grain


class CameraWrapper(OwnWrapper):
    """A wrapper that changes what a driver's camera sees.

    Args:
        driver: the driver underneath; it or one under its wrappers has a camera.

    Raises:
        ValueError: neither the driver nor one under its wrappers has a camera.
    """

    condition: ClassVar[Condition]
    name: ClassVar[str]
    """Name of its amount."""

    def __init__(self, driver: Driver, amount: float) -> None:
        camera = camera_of(driver)
        if camera is None:
            raise ValueError(
                f"{self.condition.name} changes what a camera sees, and the driver has none:"
                " leave it out"
            )
        super().__init__(driver)
        self.amount = self.condition.require(amount)
        self._camera = camera

    @classmethod
    def over(cls, driver: Driver, amount: float, **seed: int) -> Self:
        """A driver under this wrapper; a random one takes a seed."""
        return cls(driver, amount, **seed)

    @property
    def options(self) -> dict[str, float]:
        """Options of the wrapper."""
        return {self.name: self.amount}

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for what its camera sees now."""
        if observation.image is not None:
            image = self.alter(observation.image, observation)
            image.setflags(write=False)
            observation = replace(observation, image=image)
        return self.driver.act(observation)

    def alter(self, image: Image, observation: Observation) -> Image:  # noqa: ARG002
        """Return what the camera sees instead of a picture."""
        return image


class Elsewhere(CameraWrapper):
    """A driver in another place: other asphalt, land, sky and sun, drawn from a seed.

    Args:
        driver: the driver underneath.
        amount: the seed, rounded down; 0 is the usual scene.
    """

    condition, name, place = SCENE, "seed", 3

    def in_scene(self, scene: Scene) -> Scene:
        """Return the scene with another seed."""
        return replace(scene, seed=int(self.amount))


class Worn(CameraWrapper):
    """A driver on a road whose markings are worn.

    Args:
        driver: the driver underneath.
        amount: share of the paint that is gone, 0..1.
    """

    condition, name, place = WEAR, "share", 4

    def in_scene(self, scene: Scene) -> Scene:
        """Return the scene with worn markings."""
        return replace(scene, wear=self.amount)


class Foggy(CameraWrapper):
    """A driver in fog. Light from a distance x comes through to exp(-3 x / visibility).

    Args:
        driver: the driver underneath.
        amount: the visibility in m: the meteorological optical range, at which a twentieth of the
            contrast is left.
    """

    condition, name, place = FOG, "visibility", 5

    def alter(self, image: Image, observation: Observation) -> Image:  # noqa: ARG002
        """Return the picture in fog."""
        through = np.exp(-3.0 / self.amount * ground_distances(self._camera))[..., None]
        return _picture(image * through + (1.0 - through) * FOG_COLOUR)


class _SeededWrapper(CameraWrapper):
    """A wrapper with chance in it.

    Args:
        driver: the driver underneath.
        amount: amount of the wrapper.
        seed: seed of the wrapper's random numbers, from 0.
    """

    def __init__(self, driver: Driver, amount: float, *, seed: Index = 0) -> None:
        check({"seed": seed}, _SeededWrapper.__init__)
        super().__init__(driver, amount)
        self.seed = int(seed)

    @property
    def options(self) -> dict[str, float]:
        """Options of the wrapper."""
        return {**super().options, "seed": self.seed}


class Rainy(_SeededWrapper):
    """A driver that sees streaks of rain; each picture has its own.

    On 160 x 80 pixels there are about 2 streaks for each mm/h, up to a seventh of the height long.

    Args:
        driver: the driver underneath.
        amount: rate of the rain, in mm/h.
        seed: of the streaks, from 0.
    """

    condition, name, place = RAIN, "rate", 6

    def alter(self, image: Image, observation: Observation) -> Image:
        """Return the picture with streaks."""
        height, width, _ = image.shape
        rng = _of_moment(self.seed, observation)
        number = rng.poisson(2.0 * self.amount * height * width / (160.0 * 80.0))
        u, v, length, slant, strength = rng.random((5, number, 1))
        longest = max(height / 7.0, 2.0)
        along = np.arange(math.ceil(longest))
        rows = (v * (height + longest) - longest + along).astype(np.int64)
        columns = np.floor(u * width + (slant - 0.5) * 0.5 * along).astype(np.int64)
        is_seen = (along < longest * (0.4 + 0.6 * length)) & (rows >= 0) & (rows < height)
        is_seen &= (columns >= 0) & (columns < width)
        opaque = np.zeros((height, width))
        shares = np.broadcast_to(0.2 + 0.3 * strength, rows.shape)
        np.maximum.at(opaque, (rows[is_seen], columns[is_seen]), shares[is_seen])
        return _picture(image + opaque[..., None] * (np.array(RAIN_COLOUR) - image))


class Blurred(CameraWrapper):
    """A driver whose camera takes time for a picture, while the car drives and turns.

    Each pixel is the mean along the way of what it sees, with the speed and yaw rate of now.

    Args:
        driver: the driver underneath.
        amount: the time of exposure, in s.
    """

    condition, name, place = BLUR, "exposure", 7

    def __init__(self, driver: Driver, amount: float) -> None:
        super().__init__(driver, amount)
        # Compiles the kernel, which is not on the driver's time.
        smear(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1, 2)), np.zeros((1, 1, 3), np.uint8))

    def alter(self, image: Image, observation: Observation) -> Image:
        """Return the blurred picture."""
        ways = picture_motion(self._camera, observation.speed, observation.yaw_rate) * self.amount
        blurred: Image = np.empty_like(image)
        smear(image, ways, blurred)
        return blurred


class Lit(CameraWrapper):
    """A driver in more or less light than a camera with a fixed exposure is set for.

    Args:
        driver: the driver underneath.
        amount: factor of the light, 1 is the usual; bright colours saturate above.
    """

    condition, name, place = LIGHT, "factor", 8

    def alter(self, image: Image, observation: Observation) -> Image:  # noqa: ARG002
        """Return the picture in this light."""
        values = np.arange(256) * self.amount ** (1.0 / GAMMA)
        lit: Image = _picture(values)[image]
        return lit


class Grainy(_SeededWrapper):
    """A driver whose camera's sensor is noisy: Gaussian noise in each colour of each pixel.

    Args:
        driver: the driver underneath.
        amount: standard deviation of the noise, of the values 0 to 255.
        seed: of the noise, from 0.
    """

    condition, name, place = GRAIN, "deviation", 9

    def alter(self, image: Image, observation: Observation) -> Image:
        """Return the picture with noise."""
        start = int(_of_moment(self.seed, observation).integers(_BANK))
        grain = _grain(self.seed, _BANK + image.size)[start : start + image.size]
        return _picture(image + self.amount * grain.reshape(image.shape))


def _picture(values: FloatArray | npt.NDArray[np.float32]) -> Image:
    """Colours as a picture."""
    picture: Image = np.clip(values + 0.5, 0.0, 255.0).astype(np.uint8)
    return picture


def _of_moment(seed: int, observation: Observation) -> np.random.Generator:
    """Random numbers that belong to a seed and a time, to a millisecond."""
    return np.random.default_rng([seed, round(1e3 * observation.time)])


@lru_cache(maxsize=4)
def _grain(seed: int, size: int) -> npt.NDArray[np.float32]:
    return np.random.default_rng(seed).standard_normal(size, dtype=np.float32)


ALL: Final[dict[str, type[CameraWrapper]]] = {row.name: row.wrapper_class() for row in CONDITIONS}
"""Name of a condition -> its wrapper."""
