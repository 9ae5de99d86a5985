"""Wrappers over a driver with a camera: scenery, worn markings, fog, rain, blur, light and grain.

Scenery and wear change the scene that is drawn, which only the embedded simulator can do. The
other wrappers change the finished picture of any simulator. They assume that the ground is flat.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Index, check
from frenetic.drivers.camera import Scene
from frenetic.drivers.driver import Controls, Driver, Observation, changed_observation
from frenetic.drivers.stack import AmountWrapper, camera_of
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
"""Exponent that turns a pixel's value, as a share of 255, into light; usual for screens."""
FOG_COLOUR: Final = (202.0, 206.0, 210.0)
"""Colour of thick fog, RGB; our choice."""
RAIN_COLOUR: Final = (214.0, 219.0, 226.0)
"""Colour of a streak of rain, RGB; our choice."""

# Streaks of rain are our choice, by eye.
_STREAK_RATE = 2.0  # mean number of streaks for each mm/h on _STREAK_PIXELS pixels
_STREAK_PIXELS = 160.0 * 80.0
_HEIGHT_OVER_STREAK = 7.0  # height of the picture divided by the length of the longest streaks
_LEAST_LONGEST = 2.0  # [pixels], least length of the longest streaks

_GRAIN_STARTS = 1 << 16  # places in the stored noise at which a picture's grain may begin


class CameraWrapper(AmountWrapper):
    """A wrapper that changes what a driver's camera sees.

    Args:
        driver: the driver underneath; it or one under its wrappers has a camera.
        amount: amount of the wrapper's condition.

    Raises:
        ValueError: neither the driver nor one under its wrappers has a camera, or the amount is
            out of range.
    """

    def __init__(self, driver: Driver, amount: float) -> None:
        camera = camera_of(driver)
        if camera is None:
            raise ValueError(
                f"{self.condition.name} changes what a camera sees, and the driver has none:"
                " leave it out"
            )
        super().__init__(driver, amount)
        self._camera = camera

    def act(self, observation: Observation) -> Controls:
        """Return the driver's controls for what its camera sees now."""
        if observation.image is not None:
            image = self.alter(observation.image, observation)
            image.setflags(write=False)
            observation = changed_observation(observation, image=image)
        return self.driver.act(observation)

    def alter(self, image: Image, observation: Observation) -> Image:  # noqa: ARG002
        """Return the picture that the driver sees in place of the camera's picture."""
        return image


class Elsewhere(CameraWrapper):
    """A driver in other scenery: asphalt, land, sky and sun are drawn from a seed.

    Args:
        driver: the driver underneath.
        amount: the seed; a fraction is cut off. 0 is the usual scenery.
    """

    condition = SCENE
    amount_name = "seed"
    place = 3

    def in_scene(self, scene: Scene) -> Scene:
        """Return the scene with this wrapper's seed."""
        return replace(scene, seed=int(self.amount))


class Worn(CameraWrapper):
    """A driver on a road whose markings are worn.

    Args:
        driver: the driver underneath.
        amount: share of the paint that is gone, 0..1.
    """

    condition = WEAR
    amount_name = "share"
    place = 4

    def in_scene(self, scene: Scene) -> Scene:
        """Return the scene with worn markings."""
        return replace(scene, wear=self.amount)


class Foggy(CameraWrapper):
    """A driver in fog: the share exp(-3 x / visibility) of the light from a distance x is left.

    Args:
        driver: the driver underneath.
        amount: the visibility in m, at which a twentieth of the contrast is left (the
            meteorological optical range).
    """

    condition = FOG
    amount_name = "visibility"
    place = 5

    def alter(self, image: Image, observation: Observation) -> Image:  # noqa: ARG002
        """Return the picture in fog."""
        light_left = np.exp(-3.0 / self.amount * ground_distances(self._camera))[..., None]
        return _rounded(image * light_left + (1.0 - light_left) * FOG_COLOUR)


class _SeededWrapper(CameraWrapper):
    """A wrapper that draws random numbers.

    Args:
        driver: the driver underneath.
        amount: amount of the wrapper's condition.
        seed: seed of the random numbers, at least 0.
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
    """A driver that sees streaks of rain, new ones in each picture.

    160 x 80 pixels have 2 streaks on average for each mm/h. The longest are a seventh of the
    picture's height.

    Args:
        driver: the driver underneath.
        amount: rate of the rain, in mm/h.
        seed: seed of the streaks, at least 0.
    """

    condition = RAIN
    amount_name = "rate"
    place = 6

    def alter(self, image: Image, observation: Observation) -> Image:
        """Return the picture with streaks."""
        height, width, _ = image.shape
        rng = _generator_at(self.seed, observation.time)
        count = rng.poisson(_STREAK_RATE * self.amount * height * width / _STREAK_PIXELS)
        u, v, length, slant, strength = rng.random((5, count, 1))  # all in 0..1
        longest = max(height / _HEIGHT_OVER_STREAK, _LEAST_LONGEST)
        # In these arrays a row is a streak, and a column is a pixel along it, from the top on. A
        # streak leans by a quarter of a column per row at most, and has 40 to 100 % of the longest
        # length and 20 to 50 % of the opacity.
        along = np.arange(math.ceil(longest))
        rows = (v * (height + longest) - longest + along).astype(np.int64)
        columns = np.floor(u * width + (slant - 0.5) * 0.5 * along).astype(np.int64)
        is_seen = (along < longest * (0.4 + 0.6 * length)) & (rows >= 0) & (rows < height)
        is_seen &= (columns >= 0) & (columns < width)
        opacity = np.zeros((height, width))
        shares = np.broadcast_to(0.2 + 0.3 * strength, rows.shape)
        # Where streaks cross, the more opaque one counts.
        np.maximum.at(opacity, (rows[is_seen], columns[is_seen]), shares[is_seen])
        return _rounded(image + opacity[..., None] * (np.array(RAIN_COLOUR) - image))


class Blurred(CameraWrapper):
    """A driver whose camera exposes a picture for some time, while the car drives and turns.

    Each pixel is the mean of what it saw during the exposure, at the present speed and yaw rate.

    Args:
        driver: the driver underneath.
        amount: the exposure time, in s.
    """

    condition = BLUR
    amount_name = "exposure"
    place = 7

    def __init__(self, driver: Driver, amount: float) -> None:
        super().__init__(driver, amount)
        # Compile the kernel now: later the time would count as the driver's.
        smear(np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1, 2)), np.zeros((1, 1, 3), np.uint8))

    def alter(self, image: Image, observation: Observation) -> Image:
        """Return the blurred picture."""
        per_second = picture_motion(self._camera, observation.speed, observation.yaw_rate)
        blurred: Image = np.empty_like(image)
        smear(image, per_second * self.amount, blurred)
        return blurred


class Lit(CameraWrapper):
    """A driver in more or less light than its camera, whose exposure is fixed, is set for.

    Args:
        driver: the driver underneath.
        amount: factor of the light; above 1, bright colours are cut at 255.
    """

    condition = LIGHT
    amount_name = "factor"
    place = 8

    def alter(self, image: Image, observation: Observation) -> Image:  # noqa: ARG002
        """Return the picture in this light."""
        brightened = np.arange(256) * self.amount ** (1.0 / GAMMA)
        lit: Image = _rounded(brightened)[image]
        return lit


class Grainy(_SeededWrapper):
    """A driver whose camera's sensor is noisy: Gaussian noise in each colour of each pixel.

    Args:
        driver: the driver underneath.
        amount: standard deviation of the noise, where a pixel's values are 0 to 255.
        seed: seed of the noise, at least 0.
    """

    condition = GRAIN
    amount_name = "deviation"
    place = 9

    def alter(self, image: Image, observation: Observation) -> Image:
        """Return the picture with noise."""
        # Each picture takes another piece of one long noise: drawing new noise takes longer.
        rng = _generator_at(self.seed, observation.time)
        start = int(rng.integers(_GRAIN_STARTS))
        grain = _noise(self.seed, _GRAIN_STARTS + image.size)[start : start + image.size]
        return _rounded(image + self.amount * grain.reshape(image.shape))


def _rounded(values: FloatArray | npt.NDArray[np.float32]) -> Image:
    """Return colours rounded to whole numbers and cut to 0..255."""
    picture: Image = np.clip(values + 0.5, 0.0, 255.0).astype(np.uint8)
    return picture


def _generator_at(seed: int, time: float) -> np.random.Generator:
    """Return the generator of a seed and a time in s, which is rounded to milliseconds."""
    return np.random.default_rng([seed, round(1e3 * time)])


@lru_cache(maxsize=4)
def _noise(seed: int, size: int) -> npt.NDArray[np.float32]:
    """Return numbers of the standard normal distribution, (size,)."""
    return np.random.default_rng(seed).standard_normal(size, dtype=np.float32)


ALL: Final[dict[str, type[CameraWrapper]]] = {
    condition.name: condition.wrapper_class() for condition in CONDITIONS
}
"""Name of a condition -> class of its wrapper."""
