"""Conventions of networks: what they are fed with, and what their outputs mean."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

METADATA: Final = "frenetic"
"""Key in a model's metadata of its convention, a JSON object."""

_YUV: Final = ((0.299, 0.587, 0.114), (-0.147, -0.289, 0.436), (0.615, -0.515, -0.1))
_COLOURS: Final[Mapping[str, tuple[tuple[tuple[float, ...], ...], tuple[float, ...]]]] = {
    "rgb": (((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), (0.0, 0.0, 0.0)),
    "bgr": (((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), (0.0, 0.0, 0.0)),
    "yuv": (_YUV, (0.0, 0.5, 0.5)),
    "grey": (_YUV[:1], (0.0,)),
}
"""Colour space -> (weights of red, green and blue in its channels, what is added to these)."""
_CHOICES: Final[Mapping[str, Sequence[str]]] = {
    "inputs": ("image", "vector"),
    "layout": ("nchw", "nhwc"),
    "colour": tuple(_COLOURS),
    "outputs": ("steering", "steering-throttle", "waypoints"),
    "steering": ("share", "action", "rad", "degrees", "curvature"),
}


@dataclass(frozen=True, kw_only=True)
class Convention:
    """What a network is fed with, and what its outputs mean.

    Raises:
        ValueError: a value is out of range.
    """

    inputs: str = "image"
    """What it is fed with: the camera's ``image``, or the ``vector`` of `frenetic.vision.policy`,
    which the environment of `frenetic.vision.gym` gives; a vector has none of the image's
    settings."""
    layout: str | None = None
    """Order of the input's axes: ``nchw`` or ``nhwc``; None to tell it by the axis of
    length 1 or 3."""
    colour: str = "rgb"
    """Colour space: ``rgb``, ``bgr``, ``grey``, or ``yuv`` as OpenCV's ``COLOR_RGB2YUV`` has it,
    with U and V in the middle of their range where there is no colour."""
    mean: tuple[float, ...] = (0.0,)
    """Subtracted from pixels in 0..1: one number, or one for each channel."""
    std: tuple[float, ...] = (1.0,)
    """Divides them then, likewise."""
    crop: tuple[int, int] = (0, 0)
    """Rows that are cut off the camera's image, at the top and at the bottom."""
    camera: Mapping[str, float] = field(default_factory=dict)
    """Fields of a `frenetic.Camera` that differ from its defaults."""
    outputs: str = "steering"
    """``steering``; ``steering-throttle``, the latter from -1, full brake, to 1; or ``waypoints``,
    pairs (ahead, left) in m from the centre of mass, the nearest first."""
    steering: str = "share"
    """What steering is: the ``share`` of the front wheels' largest angle, -1..1; that of an
    ``action`` in `frenetic.vision.gym`, -1..1; their angle in ``rad`` or ``degrees``; or the
    ``curvature`` to drive, in 1/m."""
    steering_sign: int = 1
    """1 if positive steering turns left, -1 if it turns right."""
    lookahead: float = 6.0
    """Distance from the rear axle to the place among waypoints that is steered for, in m."""
    max_speed: float | None = None
    """Speed that is kept if the network has no throttle, in km/h; None for the speed limit."""

    def __post_init__(self) -> None:
        for name, allowed in _CHOICES.items():
            value = getattr(self, name)
            if value not in allowed and not (name == "layout" and value is None):
                raise ValueError(f"{name} is {shown(value)}: {', '.join(allowed)} are allowed")
        for name in ("mean", "std"):
            values = _numbers(getattr(self, name))
            if len(values) not in (1, self.channels) or (name == "std" and min(values) <= 0.0):
                what = "a positive number" if name == "std" else "a number"
                raise ValueError(
                    f"{name} is {shown(getattr(self, name))}: {what} is needed, or one for each"
                    f" channel of {self.colour}"
                )
            object.__setattr__(self, name, values)
        crop = _numbers(self.crop)
        if len(crop) != 2 or any(rows < 0.0 or rows % 1.0 for rows in crop):
            raise ValueError(
                f"crop is {shown(self.crop)}: the number of rows at the top and that at the bottom"
                " are needed"
            )
        object.__setattr__(self, "crop", (int(crop[0]), int(crop[1])))
        if not isinstance(self.camera, Mapping):
            raise ValueError(f"camera is {shown(self.camera)}: an object of numbers is needed")
        if self.steering_sign not in (1, -1):
            raise ValueError(f"steering_sign is {shown(self.steering_sign)}: 1 or -1 is needed")
        for name in ("lookahead", "max_speed"):
            value = getattr(self, name)
            if value is None and name == "max_speed":
                continue
            if not _is_number(value) or value <= 0.0:
                raise ValueError(f"{name} is {shown(value)}: a positive number is needed")

    @classmethod
    def of(cls, metadata: Mapping[str, str], given: Mapping[str, Any]) -> Convention:
        """A model's convention: its preset, over which its metadata lie, over which the given ones.

        Args:
            metadata: of the file.
            given: name -> value, ``preset`` among them.

        Raises:
            ValueError: an entry is damaged, unknown or out of range.
        """
        own = _decoded(metadata[METADATA]) if METADATA in metadata else {}
        name = given.get("preset", own.get("preset"))
        if name is not None and (not isinstance(name, str) or name not in PRESETS):
            raise ValueError(f"preset is {shown(name)}: {', '.join(PRESETS)} is allowed")
        merged: dict[str, Any] = {}
        for source in ({} if name is None else PRESETS[name], own, given):
            camera = merged.get("camera", {})
            merged |= source
            if isinstance(merged.get("camera"), Mapping):
                merged["camera"] = {**camera, **merged["camera"]}
        merged.pop("preset", None)
        return cls(**merged)

    @property
    def channels(self) -> int:
        """Number of channels."""
        return len(_COLOURS[self.colour][1])

    def from_pixels(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """(weights (channels, 3), constants (channels, 1)) that make inputs of RGB in 0..255."""
        weights, constants = (np.array(one) for one in _COLOURS[self.colour])
        mean, std = (
            np.broadcast_to(np.array(one), constants.shape) for one in (self.mean, self.std)
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


def _decoded(text: str) -> dict[str, Any]:
    """The convention in a file's metadata.

    Raises:
        ValueError: it is none.
    """
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError(f"its metadata {METADATA} is {shown(text)}: JSON is needed") from None
    known = ["preset", *(item.name for item in fields(Convention))]
    if not isinstance(value, dict):
        raise ValueError(f"its metadata {METADATA} is {shown(value)}: a JSON object is needed")
    if unknown := [name for name in value if name not in known]:
        raise ValueError(
            f"its metadata {METADATA} has an entry {shown(unknown[0])}: {', '.join(known)} are"
            " allowed"
        )
    return {name: one for name, one in value.items() if one is not None}


def shown(value: object) -> str:
    """The repr of a value, shortened."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _is_number(value: object) -> bool:
    # A whole number may be too large for a float.
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) <= sys.float_info.max


def _numbers(value: object) -> tuple[float, ...]:
    """A number or some as a tuple; empty for anything else."""
    values = (value,) if _is_number(value) else value
    if not isinstance(values, Sequence) or not all(map(_is_number, values)):
        return ()
    return tuple(float(one) for one in values)
