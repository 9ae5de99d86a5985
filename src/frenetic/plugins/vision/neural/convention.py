"""Conventions of networks: what they are fed with, and what their outputs mean."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec import Meta, Struct, convert

from frenetic._support.bounds import Finite, Index, Positive, check
from frenetic._support.outside_text import read_json

METADATA: Final = "frenetic"
"""Key in a model's metadata of its convention, a JSON object."""
MOST_FRAMES: Final = 64
"""Largest number of images that a network is fed with at once."""

_YUV: Final = ((0.299, 0.587, 0.114), (-0.147, -0.289, 0.436), (0.615, -0.515, -0.1))
_COLOURS: Final[Mapping[str, tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]]] = {
    "rgb": (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0)),
    "bgr": (((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
    "yuv": (_YUV, (0.0, 0.5, 0.5)),
    "grey": (_YUV[:1], (0.0,)),
}
"""Colour space -> (weights of red, green and blue in its channels, what is added to these)."""

Colour: TypeAlias = Literal["rgb", "bgr", "yuv", "grey"]
Steering: TypeAlias = Literal["share", "action", "rad", "degrees", "curvature"]


class Convention(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a network is fed with, and what its outputs mean."""

    preset: Literal["dave2"] | None = None
    """Name of one of `PRESETS`, which all others override."""
    inputs: Literal["image", "vector"] = "image"
    """What it is fed with: the camera's ``image``, or the ``vector`` of
    `frenetic.plugins.vision.policy`, which the environment of `frenetic.plugins.gym` gives; a
    vector has none of the image's settings."""
    layout: Literal["nchw", "nhwc"] | None = None
    """Order of the input's axes; None to tell it by the axis of length 1 or 3."""
    colour: Colour = "rgb"
    """Colour space: ``rgb``, ``bgr``, ``grey``, or ``yuv`` as OpenCV's ``COLOR_RGB2YUV`` has it,
    with U and V in the middle of their range where there is no colour."""
    mean: Finite | tuple[Finite, ...] = 0.0
    """Subtracted from pixels in 0..1: one number, or one for each channel."""
    std: Positive | tuple[Positive, ...] = 1.0
    """Divides the pixels then: one number, or one for each channel."""
    crop: tuple[Index, Index] = (0, 0)
    """Rows that are cut off the camera's image, at the top and at the bottom."""
    camera: Mapping[str, int | Finite] = {}
    """Fields of a `frenetic.Camera` that differ from its defaults."""
    frames: Annotated[int, Meta(ge=1, le=MOST_FRAMES)] | None = None
    """Images that it is fed with at once: the last ones that it was asked with, the oldest first;
    before the first there was the same one. None to tell it by the input's shape."""
    speed_scale: Positive = 1.0
    """A further input of one number is the speed in m/s times this: 3.6 makes it km/h."""
    states: Mapping[str, str] = {}
    """Further inputs -> the outputs that give them their next value, where names and shapes do not
    tell them; they are 0 at first."""
    outputs: Literal["steering", "steering-throttle"] = "steering"
    """Whether there is a throttle, too, from -1, full brake, to 1."""
    steering: Steering = "share"
    """What steering is: the ``share`` of the front wheels' largest angle, -1..1; the ``action``
    of an environment in `frenetic.plugins.gym`, -1..1; the wheels' angle in ``rad`` or ``degrees``;
    or the ``curvature`` to drive, in 1/m."""
    steering_sign: Literal[1, -1] = 1
    """1 if positive steering turns left, -1 if it turns right."""
    max_speed: Positive | None = None
    """Speed that is kept if the network has no throttle, in km/h; None for the speed limit."""

    @classmethod
    def of(cls, metadata: Mapping[str, str], options: Mapping[str, Any]) -> Convention:
        """A model's convention: its preset, over which its metadata lie, over which the given ones.

        Args:
            metadata: of the file.
            given: name -> value.

        Raises:
            ValueError: an entry is damaged, unknown or out of range.
        """
        entries: Any = {}
        try:
            if METADATA in metadata:
                entries = read_json(metadata[METADATA])
                convert(entries, cls)
        except ValueError as error:
            raise ValueError(f"its metadata {METADATA} are damaged: {error}") from None
        check(options, cls)
        preset = options.get("preset", entries.get("preset"))
        merged: dict[str, Any] = {}
        for source in ({} if preset is None else PRESETS[preset], entries, options):
            camera = {**merged.get("camera", {}), **(source.get("camera") or {})}
            merged |= {name: value for name, value in source.items() if value is not None}
            merged["camera"] = camera
        convention = convert(merged, cls)
        for name in ("mean", "std"):
            value = getattr(convention, name)
            if isinstance(value, tuple) and len(value) != convention.channels:
                raise ValueError(
                    f"{name} is {list(value)}: a number is needed, or one for each channel of"
                    f" {convention.colour}"
                )
        return convention

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(_COLOURS[self.colour][1])

    def from_pixels(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """(weights (channels, 3), constants (channels, 1)) that make inputs of RGB in 0..255."""
        weights, constants = (np.array(values) for values in _COLOURS[self.colour])
        mean, std = (
            np.broadcast_to(np.array(values), constants.shape) for values in (self.mean, self.std)
        )
        scaled = weights / (255.0 * std[:, None])
        shifted = ((constants - mean) / std)[:, None]
        return scaled.astype(np.float32), shifted.astype(np.float32)


PRESETS: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "dave2": {
            "colour": "yuv",
            "mean": 0.5,
            "std": 0.5,
            "camera": {
                "width": 200,
                "height": 66,
                "field_of_view": 90.0,
                "forward": 0.8,
                "up": 1.4,
                "pitch": 12.0,
            },
        }
    }
)
"""Name -> what it sets: ``dave2`` is the input of M. Bojarski et al., "End to End Learning for
Self-Driving Cars" (arXiv:1604.07316), 66 x 200 pixels in YUV, scaled to -1..1."""
