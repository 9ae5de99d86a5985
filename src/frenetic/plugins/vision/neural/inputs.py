"""Recognise a network's inputs by their names and shapes: image or vector, speed, states."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Mapping
from typing import Final, NamedTuple

from frenetic._support.onnx_model import OnnxModel, Shape, shown_shape
from frenetic.plugins.vision.neural.convention import MOST_FRAMES, Convention
from frenetic.plugins.vision.policy import VECTOR_SIZE

_WORD: Final = re.compile(r"(?<![a-z])[hc](?=n(?![a-z]))|[a-z]+|\d+")
"""A word of a name: letters or digits. ``hn`` and ``cn``, usual for the next h and c, are two."""
_DIRECTION_WORDS: Final = frozenset(
    ["in", "out", "input", "output", "next", "new", "prev", "previous", "old", "last", "0", "n"]
)
"""Words by which the names of a state and of its next value differ."""


class Inputs(NamedTuple):
    """The inputs of a network, by their names."""

    main: str
    """Image or vector."""
    speed: str | None
    """Speed, one number."""
    states: Mapping[str, str]
    """State -> the output that is its next value."""

    @classmethod
    def of(cls, model: OnnxModel, convention: Convention) -> Inputs:
        """Return the inputs of a model.

        In this order are recognised: states that the convention names, states by their names, the
        speed, the image or the vector, and states by their shapes.

        Raises:
            ValueError: the convention names a state that the model lacks, no input takes the image
                or the vector, or an input is not recognised.
        """
        states = dict(convention.states)
        if not (states.keys() <= model.inputs.keys() and {*states.values()} <= {*model.outputs}):
            raise ValueError(
                f"states is {states}: its inputs are {', '.join(model.inputs)}, its outputs"
                f" {', '.join(model.outputs)}"
            )
        for name in _without(model.inputs, states):
            shapes = {
                output: model.outputs[output] for output in _without(model.outputs, states.values())
            }
            if (output := _next_value_by_name(name, model.inputs[name], shapes)) is not None:
                states[name] = output
        rest = _without(model.inputs, states)
        speed = next((name for name in rest if _is_number(model.inputs[name])), None)
        rest = [name for name in rest if name != speed]
        if not rest:
            raise ValueError(
                f"none of its inputs ({', '.join(model.inputs)}) takes the {convention.inputs}"
            )
        main = next((name for name in rest if _is_main(model.inputs[name], convention)), rest[0])
        for name in _without(rest, [main]):
            outputs = _without(model.outputs, states.values())
            fitting = [
                output
                for output in outputs
                if _may_equal(model.inputs[name], model.outputs[output])
            ]
            # At least one output must remain: the steering.
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
    """Whether the images have an axis of their own; else they are stacked in the channels."""

    @classmethod
    def of(cls, shape: Shape, convention: Convention) -> ImageInput:
        """Return how an input of this shape takes images.

        Raises:
            ValueError: the shape does not fit images of the convention.
        """
        image_channels, text, frames = convention.channels, shown_shape(shape), convention.frames
        has_batch_axis = shape[:1] in ((1,), (None,))
        has_frame_axis = len(shape) == 5 or (not has_batch_axis and shape[:1] == (frames,))
        if len(shape) not in (4, 5) or not (has_batch_axis or (has_frame_axis and len(shape) == 4)):
            raise ValueError(
                f"its input has the shape {text}: one image is needed, (1, channels, height, width)"
                " or (1, height, width, channels), or frames of it, (1, frames, ...)"
            )
        layout = convention.layout or _layout_of(shape)
        is_nchw = layout == "nchw"
        channels, height, width = shape[-3:] if is_nchw else (shape[-1], *shape[-3:-1])
        if has_frame_axis:
            number, fits = shape[-4] or frames, channels in (image_channels, None)
        else:
            # 1 and 3 channels are one image, unless the convention names more frames.
            number = (frames or 1) if channels in (1, 3, None) else channels // image_channels
            fits = channels in (image_channels * number, None)
        if not fits:
            raise ValueError(
                f"its input has the shape {text}, {layout}: {convention.colour} has"
                f" {image_channels} channel{'s' * (image_channels > 1)}; give colour, layout or"
                " frames"
            )
        if number is None or number > MOST_FRAMES or frames not in (number, None):
            raise ValueError(
                f"its input has the shape {text}, which is {number or 'any number of'} frames, and"
                f" frames is {frames}: give their number, at most {MOST_FRAMES}"
            )
        return cls(is_nchw, height, width, number, has_frame_axis)


def _layout_of(shape: Shape) -> str:
    """Return the layout of images: the axis of length 1 or 3, else the shorter, has the channels.

    Only the first and the last of the last three axes can have them.
    """
    first, _, last = shape[-3:]
    is_last = first not in (1, 3) and (last in (1, 3) or (last or 0) < (first or 0))
    return "nhwc" if is_last else "nchw"


def _is_main(shape: Shape, convention: Convention) -> bool:
    """Return whether an input of this shape may take the image, or the vector."""
    if convention.inputs == "vector":
        return len(shape) == 2 and shape[1] in (VECTOR_SIZE, None)
    return len(shape) >= 4


def _is_number(shape: Shape) -> bool:
    """Return whether an input of this shape takes one number."""
    return shape in ((), (1,), (None,), (1, 1), (None, 1))


def _may_equal(shape: Shape, other_shape: Shape) -> bool:
    """Return whether two shapes are equal, or can be where one leaves a size open."""
    return len(shape) == len(other_shape) and all(
        a == b or None in (a, b) for a, b in zip(shape, other_shape, strict=True)
    )


def _next_value_by_name(name: str, shape: Shape, outputs: Mapping[str, Shape]) -> str | None:
    """Return the output whose name differs from an input's by direction words alone.

    ``h_out``, for example, is the next value of ``h_in``. Outputs with a direction word go before
    others. None if there is no such output of this shape or more than one, or if the name is no
    state's: it has the word "speed", or no word but directions and digits.

    Args:
        name: name of the input.
        shape: shape of the input.
        outputs: name -> shape of the outputs in question.
    """
    words = _WORD.findall(name.lower())
    stem = _stem(words)
    if "speed" in stem or not any(word.isalpha() for word in stem):
        return None
    with_direction: list[str] = []
    without_direction: list[str] = []
    for output, output_shape in outputs.items():
        output_words = _WORD.findall(output.lower())
        output_stem = _stem(output_words)
        if output_stem == stem and output_words != words and _may_equal(shape, output_shape):
            is_plain = output_stem == output_words
            (without_direction if is_plain else with_direction).append(output)
    fitting = with_direction or without_direction
    return fitting[0] if len(fitting) == 1 else None


def _stem(words: Iterable[str]) -> list[str]:
    """Return the words without direction words."""
    return [word for word in words if word not in _DIRECTION_WORDS]


def _without(names: Iterable[str], excluded: Container[str]) -> list[str]:
    """Return the names that are not excluded."""
    return [name for name in names if name not in excluded]
