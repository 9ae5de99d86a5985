"""Conventions of networks: what their inputs are, and what their outputs mean."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec import Meta, Struct, convert

from frenetic._support.bounds import Finite, Index, Positive, check
from frenetic._support.outside_text import read_json

METADATA: Final = "frenetic"
"""Key of the convention, a JSON object, in a model's metadata."""
MOST_FRAMES: Final = 64
"""Largest number of images that a network takes at once; our choice."""


class _ColourSpace(NamedTuple):
    """Linear map from red, green and blue, each in 0..1, to the channels of a colour space."""

    weights: tuple[tuple[float, float, float], ...]
    """Weights of red, green and blue in each channel."""
    offsets: tuple[float, ...]
    """Number that is added to each channel."""


_YUV: Final = ((0.299, 0.587, 0.114), (-0.147, -0.289, 0.436), (0.615, -0.515, -0.1))
"""Weights of OpenCV's ``COLOR_RGB2YUV``."""
_COLOUR_SPACES: Final[Mapping[str, _ColourSpace]] = {
    "rgb": _ColourSpace(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0)),
    "bgr": _ColourSpace(((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
    "yuv": _ColourSpace(_YUV, (0.0, 0.5, 0.5)),
    "grey": _ColourSpace(_YUV[:1], (0.0,)),
}

Colour: TypeAlias = Literal["rgb", "bgr", "yuv", "grey"]
Steering: TypeAlias = Literal["share", "action", "rad", "degrees", "curvature"]


class Convention(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a network's inputs are, and what its outputs mean."""

    preset: Literal["dave2"] | None = None
    """Name of one of `PRESETS`; all other fields that are set override it."""
    inputs: Literal["image", "vector"] = "image"
    """Main input: the camera's ``image``, or the ``vector`` of `frenetic.plugins.vision.policy`,
    which is also an observation of the environment in `frenetic.plugins.gym`. The fields from
    ``layout`` to ``frames`` are about images only."""
    layout: Literal["nchw", "nhwc"] | None = None
    """Order of the input's axes; None to infer it from the axis of length 1 or 3."""
    colour: Colour = "rgb"
    """Colour space: ``rgb``, ``bgr``, ``grey``, or ``yuv`` as in OpenCV's ``COLOR_RGB2YUV``, where
    U and V are 0.5 for grey."""
    mean: Finite | tuple[Finite, ...] = 0.0
    """Number that is subtracted from pixels in 0..1, or one number for each channel."""
    std: Positive | tuple[Positive, ...] = 1.0
    """Number by which the pixels are then divided, or one number for each channel."""
    crop: tuple[Index, Index] = (0, 0)
    """Rows that are cut off the camera's image, at the top and at the bottom."""
    camera: Mapping[str, int | Finite] = {}
    """Fields of a `frenetic.Camera` that differ from its defaults."""
    frames: Annotated[int, Meta(ge=1, le=MOST_FRAMES)] | None = None
    """Number of images at once: the last ones, the oldest first. At the start the first image
    stands in for earlier ones. None to infer the number from the input's shape."""
    speed_scale: Positive = 1.0
    """Factor of the speed in m/s for an input of one number: 3.6 turns it into km/h."""
    states: Mapping[str, str] = {}
    """State, an input -> the output that is its next value, for states that are not recognised by
    their names or shapes. A state is 0 at first."""
    outputs: Literal["steering", "steering-throttle"] = "steering"
    """Outputs: steering alone, or also a throttle from -1, full brake, to 1."""
    steering: Steering = "share"
    """Unit of the steering: the ``share`` of the front wheels' largest angle, -1..1; the ``action``
    of an environment in `frenetic.plugins.gym`, -1..1; the wheels' angle in ``rad`` or ``degrees``;
    or the ``curvature`` to drive, in 1/m."""
    steering_sign: Literal[1, -1] = 1
    """1 if positive steering turns left, -1 if it turns right."""
    max_speed: Positive | None = None
    """Speed that the driver approaches if the network has no throttle, in km/h; None for the speed
    limit."""

    @classmethod
    def of(cls, metadata: Mapping[str, str], options: Mapping[str, Any]) -> Convention:
        """Return the convention of a model.

        Options override the metadata, which override the preset. A camera is merged field by field.

        Args:
            metadata: metadata of the model's file.
            options: options of the driver: field of the convention -> value.

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
        # From the weakest source to the strongest.
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
        """Number of channels of the colour space."""
        return len(_COLOUR_SPACES[self.colour].offsets)

    def channel_map(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return the linear map from a pixel's red, green and blue, in 0..255, to the input.

        Returns:
            Weights, (channels, 3), and the numbers that are added to the channels, (channels, 1).
        """
        space = _COLOUR_SPACES[self.colour]
        weights, offsets = np.array(space.weights), np.array(space.offsets)
        mean, std = (
            np.broadcast_to(np.array(values), offsets.shape) for values in (self.mean, self.std)
        )
        scaled = weights / (255.0 * std[:, None])
        shifted = ((offsets - mean) / std)[:, None]
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
"""Name of a preset -> the fields that it sets.

``dave2`` has the input of M. Bojarski et al., "End to End Learning for Self-Driving Cars"
(arXiv:1604.07316): 66 x 200 pixels in YUV, scaled to -1..1. The camera's field of view, place and
pitch are our choice."""
