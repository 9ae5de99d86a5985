"""Kinds of a network's inputs, by their shapes and names."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping
from typing import Final, NamedTuple

from frenetic._support.onnx_model import OnnxModel, Shape, shown_shape
from frenetic.plugins.vision.neural.convention import MOST_FRAMES, Convention
from frenetic.plugins.vision.policy import VECTOR_SIZE

_WORD: Final = re.compile(r"(?<![a-z])[hc](?=n(?![a-z]))|[a-z]+|\d+")  # hn is h and n
_DIRECTIONS: Final = frozenset(
    ["in", "out", "input", "output", "next", "new", "prev", "previous", "old", "last", "0", "n"]
)
"""Words by which the names of a state and of its next value differ."""


class Inputs(NamedTuple):
    """The inputs of a network, by their names."""

    main: str
    """The image or the vector."""
    speed: str | None
    """The speed, one number."""
    states: Mapping[str, str]
    """State -> the output that is its next value."""

    @classmethod
    def of(cls, model: OnnxModel, convention: Convention) -> Inputs:
        """Tell the states by the convention or their names, the speed, the image, more states.

        Raises:
            ValueError: an input is none of these.
        """
        states = dict(convention.states)
        if not (states.keys() <= model.inputs.keys() and {*states.values()} <= {*model.outputs}):
            raise ValueError(
                f"states is {states}: its inputs are {', '.join(model.inputs)}, its outputs"
                f" {', '.join(model.outputs)}"
            )
        for name in _left(model.inputs, states):
            shapes = {name: model.outputs[name] for name in _left(model.outputs, states.values())}
            if (following := _following(name, model.inputs[name], shapes)) is not None:
                states[name] = following
        left = _left(model.inputs, states)
        speed = next((name for name in left if _is_number(model.inputs[name])), None)
        left = [name for name in left if name != speed]
        if not left:
            raise ValueError(
                f"none of its inputs ({', '.join(model.inputs)}) takes the {convention.inputs}"
            )
        main = next((name for name in left if _is_main(model.inputs[name], convention)), left[0])
        for name in _left(left, [main]):
            outputs = _left(model.outputs, states.values())
            fitting = [
                output for output in outputs if _fit(model.inputs[name], model.outputs[output])
            ]
            if len(fitting) != 1 or len(outputs) == 1 or _is_number(model.inputs[name]):
                raise ValueError(
                    f"its input {name}, {shown_shape(model.inputs[name])}, is neither the"
                    f" {convention.inputs}, one speed, nor a state that just one further output"
                    " gives by its name or shape: name both in states"
                )
            states[name] = fitting[0]
        return cls(main, speed, states)


class ImageInput(NamedTuple):
    """How a network takes images."""

    is_nchw: bool
    """Whether the channels come before the rows."""
    height: int | None
    """Rows; None if the network takes any number."""
    width: int | None
    """Columns; None if the network takes any number."""
    frames: int
    """Number of images, the oldest first."""
    has_frame_axis: bool
    """Whether they have an axis of their own; else they are stacked in the channels."""

    @classmethod
    def of(cls, shape: Shape, convention: Convention) -> ImageInput:
        """Return what images an input of this shape takes.

        Raises:
            ValueError: it takes no images of the convention.
        """
        n, text, frames = convention.channels, shown_shape(shape), convention.frames
        is_batch = shape[:1] in ((1,), (None,))
        has_frame_axis = len(shape) == 5 or (not is_batch and shape[:1] == (frames,))
        if len(shape) not in (4, 5) or not (is_batch or (has_frame_axis and len(shape) == 4)):
            raise ValueError(
                f"its input has the shape {text}: one image is needed, (1, channels, height, width)"
                " or (1, height, width, channels), or frames of it, (1, frames, ...)"
            )
        first, *_, last = axes = shape[-3:]
        layout = convention.layout
        if layout is None:
            is_last = first not in (1, 3) and (last in (1, 3) or (last or 0) < (first or 0))
            layout = "nhwc" if is_last else "nchw"
        is_nchw = layout == "nchw"
        channels, height, width = axes if is_nchw else (last, *axes[:2])
        if has_frame_axis:
            number, fits = shape[-4] or frames, channels in (n, None)
        else:
            number = frames or 1 if channels in (1, 3, None) else channels // n
            fits = channels in (n * number, None)
        if not fits:
            raise ValueError(
                f"its input has the shape {text}, {layout}: {convention.colour} has {n}"
                f" channel{'s' * (n > 1)}; give colour, layout or frames"
            )
        if number is None or number > MOST_FRAMES or frames not in (number, None):
            raise ValueError(
                f"its input has the shape {text}, which is {number or 'any number of'} frames, and"
                f" frames is {frames}: give their number, at most {MOST_FRAMES}"
            )
        return cls(is_nchw, height, width, number, has_frame_axis)


def _is_main(shape: Shape, convention: Convention) -> bool:
    """Return whether an input of this shape may take the image, or the vector."""
    if convention.inputs == "vector":
        return len(shape) == 2 and shape[1] in (VECTOR_SIZE, None)
    return len(shape) >= 4


def _is_number(shape: Shape) -> bool:
    return shape in ((), (1,), (None,), (1, 1), (None, 1))


def _fit(shape: Shape, other_shape: Shape) -> bool:
    return len(shape) == len(other_shape) and all(
        a == b or None in (a, b) for a, b in zip(shape, other_shape, strict=True)
    )


def _following(name: str, shape: Shape, outputs: Mapping[str, Shape]) -> str | None:
    """Return the only output named as an input but for a direction, such as ``h_out`` for ``h_in``.

    One that has a direction goes first. A speed is no state.
    """
    words = _WORD.findall(name.lower())
    stem = [word for word in words if word not in _DIRECTIONS]
    if "speed" in stem or not any(word.isalpha() for word in stem):
        return None
    alike: dict[bool, list[str]] = {True: [], False: []}
    for output, output_shape in outputs.items():
        others = _WORD.findall(output.lower())
        other_stem = [word for word in others if word not in _DIRECTIONS]
        if other_stem == stem and others != words and _fit(shape, output_shape):
            alike[other_stem != others].append(output)
    fitting = alike[True] or alike[False]
    return fitting[0] if len(fitting) == 1 else None


def _left(names: Iterable[str], without: Container[str]) -> list[str]:
    return [name for name in names if name not in without]
