"""A neural network as a driver, and the one that comes with Frenetic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.onnx_model import OnnxModel, Shape, read_model, shown_shape
from frenetic.drivers.camera import Camera
from frenetic.drivers.driver import Controls, DriveSetup, Observation
from frenetic.drivers.laws import setup_array
from frenetic.errors import DriverError
from frenetic.plugins.vision.neural.convention import Convention
from frenetic.plugins.vision.neural.inputs import ImageInput, Inputs
from frenetic.plugins.vision.policy import VECTOR_SIZE, controls_of, vector_of

if TYPE_CHECKING:
    from frenetic.drivers.camera import Image

    FloatImage = npt.NDArray[np.float32]
    """Pixels in 0..255, (height, width, 3) RGB."""

DAVE2: Final = Path(__file__).with_name("dave2.onnx")
"""The network of the driver `Dave2`; ``training/dave2.py`` made it."""


class Network:
    """A driver that steers by a neural network in an ONNX file.

    The network's `Convention` comes from a preset, the file's metadata and the arguments after
    ``model``, each of which overrides the ones before.

    By default the camera's image has the size that the network takes, plus the rows that are
    cropped; an image of another size is cropped and resized (bilinear). The network may also take
    several images, the speed, and states, which are outputs that it gets back.

    A network without a throttle gets the throttle of the DAVE-2 executor in the SBFT tool
    competition, 1 - s^2 - (v / max_speed)^2, where s is the share of the largest steering angle
    and v the speed. Then the driver never brakes.

    Args:
        model: path of the file.
        preset: name of one of `frenetic.plugins.vision.neural.PRESETS`.
        inputs, layout, colour, mean, std, crop, camera: as in a `Convention`; None leaves the value
            of the metadata or the preset.
        frames, speed_scale, states, outputs: as in a `Convention`, or None.
        steering, steering_sign, max_speed: as in a `Convention`, or None.

    Raises:
        FreneticError: onnxruntime is not installed.
        ValueError: the file holds no model that can drive, or an argument does not fit it.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, which campaigns record (see `frenetic.parts.versions`): increase it
    when the same model gives other controls."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("onnxruntime",)
    """Packages whose versions campaigns record, too."""

    def __init__(
        self,
        model: str,
        *,
        preset: str | None = None,
        inputs: str | None = None,
        layout: str | None = None,
        colour: str | None = None,
        mean: float | Sequence[float] | None = None,
        std: float | Sequence[float] | None = None,
        crop: Sequence[int] | None = None,
        camera: Mapping[str, float] | None = None,
        frames: int | None = None,
        speed_scale: float | None = None,
        states: Mapping[str, str] | None = None,
        outputs: str | None = None,
        steering: str | None = None,
        steering_sign: int | None = None,
        max_speed: float | None = None,
    ) -> None:
        arguments = dict(locals())
        del arguments["self"], arguments["model"]
        self._convention_options = {
            name: value for name, value in arguments.items() if value is not None
        }
        self._path = str(model)
        self._data = read_model(self._path)
        self._load()
        # Try the network once: a model that cannot answer is refused now, not in the first drive.
        if self.convention.inputs == "vector":
            self._run(np.zeros((1, VECTOR_SIZE)), speed=0.0)
        else:
            grey_image = np.full(self.camera.shape, 128, dtype=np.uint8)
            self._answer_to_image(grey_image, speed=0.0)

    @property
    def options(self) -> dict[str, Any]:
        """Path of the model's file, and the other arguments that are not None."""
        return {"model": self._path, **self._convention_options}

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments and the file's content: the other process may have no such file."""
        return {name: getattr(self, name) for name in ("_path", "_convention_options", "_data")}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        self._load()

    def _load(self) -> None:
        """Set all that follows from the file's content and the arguments."""
        self._model = OnnxModel(self._data)
        self.convention = Convention.of(self._model.metadata, self._convention_options)
        """Convention of the network."""
        self._inputs = Inputs.of(self._model, self.convention)
        self._forget()
        shape = self._model.inputs[self._inputs.main]
        if self.convention.inputs == "image":
            self._set_up_image(shape)
        elif len(shape) != 2 or shape[1] not in (VECTOR_SIZE, None):
            raise ValueError(
                f"its input has the shape {shown_shape(shape)}: a vector is needed,"
                f" (1, {VECTOR_SIZE}) floats"
            )

    def _set_up_image(self, shape: Shape) -> None:
        """Set the camera and the way from its image to an input of this shape."""
        convention = self.convention
        self._image_input = ImageInput.of(shape, convention)
        height, width = self._image_input.height, self._image_input.width
        cropped_rows = sum(convention.crop)
        self.camera = _camera(convention.camera, height and height + cropped_rows, width)
        """Camera of the driver; a network with vectors has none."""
        image_size = (self.camera.height - cropped_rows, self.camera.width)
        if image_size[0] < 1:
            raise ValueError(
                f"crop is {list(convention.crop)}: nothing is left of {self.camera.height} rows"
            )
        input_size = (height or image_size[0], width or image_size[1])
        self._resizing = None if input_size == image_size else Resizing(image_size, input_size)
        self._channel_weights, self._channel_offsets = convention.channel_map()

    def _forget(self) -> None:
        """Set all states to 0 and forget earlier images."""
        self._states = {
            name: np.zeros([size or 1 for size in self._model.inputs[name]], dtype=np.float32)
            for name in self._inputs.states
        }
        self._last_frames: list[npt.NDArray[np.float32]] = []

    # Driving

    def reset(self, setup: DriveSetup) -> None:
        """Forget images and states, and prepare for the next drive."""
        self._forget()
        self._setup = setup
        self._setup_array = setup_array(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the network's steering, with the network's throttle or the one of the rule.

        Raises:
            DriverError: there is no image, or the network's answer is unusable, see `_run`.
        """
        image, speed = observation.image, observation.speed
        takes_vectors = self.convention.inputs == "vector"
        if image is None and not takes_vectors:
            raise DriverError(
                "a neural network needs a camera, and this simulator draws no image: use another,"
                " such as the embedded one"
            )
        try:
            if image is None or takes_vectors:
                vector = vector_of(observation, self._setup_array)
                answer = self._run(vector[np.newaxis], speed)
            else:
                answer = self._answer_to_image(image, speed)
        except ValueError as error:
            raise DriverError(f"{self._path}: {error}") from None
        steering = self._steering(float(answer[0]))
        if self.convention.outputs == "steering-throttle":
            pedal = float(answer[1])
            return Controls(steering, throttle=max(pedal, 0.0), brake=max(-pedal, 0.0))
        return Controls(steering, throttle=self._rule_throttle(steering, observation))

    def _rule_throttle(self, steering: float, observation: Observation) -> float:
        """Return the throttle of the competition's rule, see `Network`.

        Args:
            steering: angle of the front wheels, in rad.
            observation: the observation, with the speed and the speed limit.
        """
        limit = observation.speed_limit
        if not math.isfinite(limit):  # an observation that no simulator made
            limit = self._setup.speed_limit
        if self.convention.max_speed is not None:
            limit = min(limit, self.convention.max_speed / 3.6)
        share = min(max(steering / self._setup.max_steering, -1.0), 1.0)
        return max(1.0 - share**2 - (observation.speed / limit) ** 2, 0.0)

    def _answer_to_image(self, image: Image, speed: float) -> FloatArray:
        """Return the network's answer to a camera's image and the images before it.

        Raises:
            ValueError: see `_run`.
        """
        top, bottom = self.convention.crop
        cropped = image[top : image.shape[0] - bottom]
        pixels = cropped.astype(np.float32) if self._resizing is None else self._resizing(cropped)
        height, width, _ = pixels.shape
        channels = self._channel_weights @ pixels.reshape(-1, 3).T + self._channel_offsets
        frame = channels.reshape(-1, height, width)
        layout = self._image_input
        # The first image of a drive stands in for the images before it.
        earlier_frames = self._last_frames[1:] or [frame] * (layout.frames - 1)
        self._last_frames = [*earlier_frames, frame]
        frames = np.stack(self._last_frames)  # (frames, channels, height, width)
        if not layout.has_frame_axis:
            frames = frames.reshape(1, -1, height, width)
        if not layout.is_nchw:
            frames = frames.transpose(0, 2, 3, 1)
        has_batch_and_frame_axes = len(self._model.inputs[self._inputs.main]) == 5
        return self._run(frames[np.newaxis] if has_batch_and_frame_axes else frames, speed)

    def _run(self, main: npt.NDArray[Any], speed: float) -> FloatArray:
        """Run the network, store its next states, and return its other outputs.

        Args:
            main: the main input, image or vector.
            speed: speed of the car, in m/s.

        Raises:
            ValueError: the answer has another length than the convention says, a number of it is
                not finite, or a state's next value has another shape.
        """
        inputs = self._inputs
        values = {inputs.main: np.ascontiguousarray(main, dtype=np.float32), **self._states}
        if inputs.speed is not None:
            shape = [size or 1 for size in self._model.inputs[inputs.speed]]
            values[inputs.speed] = np.full(shape, self.convention.speed_scale * speed, np.float32)
        results = self._model.run(values)
        for name, output in inputs.states.items():
            next_state = results[output].astype(np.float32)
            if next_state.shape != self._states[name].shape:
                raise ValueError(
                    f"its output {output} has the shape {shown_shape(next_state.shape)}, but the"
                    f" state {name} has {shown_shape(self._states[name].shape)}"
                )
            self._states[name] = next_state
        next_states = inputs.states.values()
        answers = [result.ravel() for name, result in results.items() if name not in next_states]
        # The empty array makes float64 of all, and is the answer if all outputs are states.
        answer = np.concatenate([np.empty(0), *answers])
        outputs = self.convention.outputs
        if len(answer) != len(outputs.split("-")):
            raise ValueError(
                f"the network gives {len(answer)} numbers, but its outputs are {outputs}: set"
                " outputs to steering for 1 number, to steering-throttle for 2"
            )
        if not np.isfinite(answer).all():
            raise ValueError(
                f"the network gives {answer[~np.isfinite(answer)][0]}: finite numbers are needed"
            )
        return answer

    def _steering(self, output: float) -> float:
        """Return the angle of the front wheels, in rad, for the network's steering."""
        value = self.convention.steering_sign * output
        if self.convention.steering == "share":
            return value * self._setup.max_steering
        if self.convention.steering == "action":
            steering, _, _ = controls_of(value, 0.0, self._setup_array)
            return steering
        if self.convention.steering == "degrees":
            return math.radians(value)
        if self.convention.steering == "curvature":
            return math.atan(self._setup.wheelbase * value)
        return value


class Dave2(Network):
    """A network with the layers of DAVE-2 (M. Bojarski et al., arXiv:1604.07316).

    ``training/dave2.py`` trained it, in the embedded simulator, to steer as pure pursuit does.

    Args:
        max_speed: speed that the throttle's rule approaches, in km/h, see `Network`.

    Raises:
        FreneticError: onnxruntime is not installed.
        ValueError: `max_speed` is out of range.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour: increase it also when the network is trained again."""

    def __init__(self, *, max_speed: float = 50.0) -> None:
        super().__init__(str(DAVE2), max_speed=max_speed)

    @property
    def options(self) -> dict[str, Any]:
        """Arguments of the driver; its model belongs to the driver's behaviour."""
        return dict(self._convention_options)


class Resizing:
    """Bilinear resizing of images from one size to another.

    The values of an image lie at the centres of its pixels.

    Args:
        size: height and width of the images to resize.
        new_size: height and width of the resized images.
    """

    def __init__(self, size: tuple[int, int], new_size: tuple[int, int]) -> None:
        self._above, self._below, down = _neighbours(size[0], new_size[0])
        self._left, self._right, across = _neighbours(size[1], new_size[1])
        self._down, self._across = down[:, None, None], across[:, None]

    def __call__(self, image: Image) -> FloatImage:
        """Return the resized image."""
        pixels = image.astype(np.float32)
        above, below = pixels[self._above], pixels[self._below]
        rows = above + self._down * (below - above)
        left, right = rows[:, self._left], rows[:, self._right]
        resized: FloatImage = left + self._across * (right - left)
        return resized


def _neighbours(
    size: int, new_size: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.float32]]:
    """Return between which pixels the pixels of a resized axis lie.

    Args:
        size: number of pixels of the axis.
        new_size: number of pixels of the resized axis.

    Returns:
        For each pixel of the resized axis: index of the pixel before it, index of the pixel after
        it, weight of the latter.
    """
    positions = ((np.arange(new_size) + 0.5) * size / new_size - 0.5).clip(0.0, size - 1.0)
    before = positions.astype(np.intp)
    after = np.minimum(before + 1, size - 1)
    return before, after, (positions - before).astype(np.float32)


def _camera(options: Mapping[str, float], height: int | None, width: int | None) -> Camera:
    """Return a camera.

    Args:
        options: fields of the camera.
        height, width: size of the image where ``options`` names none; None for the default.

    Raises:
        ValueError: there is no such field, or a value is out of range.
    """
    if unknown := options.keys() - Camera.__dataclass_fields__.keys():
        known = ", ".join(Camera.__dataclass_fields__)
        raise ValueError(f"a camera has no {min(unknown)!r}; it has: {known}")
    sizes = {"height": height, "width": width}
    fields = {name: size for name, size in sizes.items() if size is not None} | dict(options)
    return Camera(**fields)  # type: ignore[arg-type]
