"""A neural network as a driver, and the one that comes with Frenetic."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.onnx_model import OnnxModel, read_model, shown_shape
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

    The network's `Convention` comes from a preset, the file's metadata and the arguments, each of
    which overrides the ones before. The camera's image has by default the size that the network
    takes, with the rows to be cropped; one of another size is cropped and resized (bilinear).
    Besides, it may take several images, the speed, and states that its outputs give back.

    Without a throttle it keeps its speed by the rule of the DAVE-2 executor in the SBFT tool
    competition: throttle = 1 - s^2 - (v / max_speed)^2, where s is the share of the largest
    steering angle, and no brake.

    The arguments after the first two make its `Convention`.

    Args:
        model: path of the file.
        preset: name of one of `frenetic.plugins.vision.neural.PRESETS`.

    Raises:
        FreneticError: onnxruntime is not installed.
        ValueError: the file holds no model that can drive, or an argument does not fit it.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it, see `frenetic.parts.versions`."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("onnxruntime",)

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
        options = dict(locals())  # the arguments, by now
        del options["self"], options["model"]
        self._given = {name: value for name, value in options.items() if value is not None}
        self._path = str(model)
        self._data = read_model(self._path)
        self._load()
        # Without an answer it is of no use.
        if self.convention.inputs == "vector":
            self._run(np.zeros((1, VECTOR_SIZE)), 0.0)
        else:
            self._answer(np.full(self.camera.shape, 128, dtype=np.uint8), 0.0)

    @property
    def options(self) -> dict[str, Any]:
        """Its file and the given arguments."""
        return {"model": self._path, **self._given}

    def __getstate__(self) -> dict[str, Any]:
        """Return the file's content and the arguments: the other process may have no such file."""
        return {name: getattr(self, name) for name in ("_path", "_given", "_data")}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        self._load()

    def _load(self) -> None:
        self._model = OnnxModel(self._data)
        self.convention = convention = Convention.of(self._model.metadata, self._given)
        """What it is fed with, and what its outputs mean."""
        self._inputs = Inputs.of(self._model, convention)
        self._forget()
        shape = self._model.inputs[self._inputs.main]
        if convention.inputs == "vector":
            if len(shape) != 2 or shape[1] not in (VECTOR_SIZE, None):
                raise ValueError(
                    f"its input has the shape {shown_shape(shape)}: a vector is needed,"
                    f" (1, {VECTOR_SIZE}) floats"
                )
            return
        self._image = ImageInput.of(shape, convention)
        height, width = self._image.height, self._image.width
        cut = sum(convention.crop)
        self.camera = _camera(convention.camera, height and height + cut, width)
        """Its camera; a network that is fed with vectors has none."""
        image_size = (self.camera.height - cut, self.camera.width)
        if image_size[0] < 1:
            raise ValueError(
                f"crop is {list(convention.crop)}: nothing is left of {self.camera.height} rows"
            )
        wanted = (height or image_size[0], width or image_size[1])
        self._resizing = None if wanted == image_size else Resizing(image_size, wanted)
        self._weights, self._constants = convention.from_pixels()

    def _forget(self) -> None:
        self._states = {
            name: np.zeros([size or 1 for size in self._model.inputs[name]], dtype=np.float32)
            for name in self._inputs.states
        }
        self._seen: list[npt.NDArray[np.float32]] = []

    # Driving

    def reset(self, setup: DriveSetup) -> None:
        """Prepares for the next drive: forgets images and states."""
        self._forget()
        self._setup = setup
        self._numbers = setup_array(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the network's steering, with its throttle or the speed rule's.

        Raises:
            DriverError: there is no image, or the network gives no finite numbers for it.
        """
        image, takes_vectors = observation.image, self.convention.inputs == "vector"
        if image is None and not takes_vectors:
            raise DriverError("a neural network needs a camera, and this simulator draws no image")
        try:
            if image is None or takes_vectors:
                answer = self._run(
                    vector_of(observation, self._numbers)[np.newaxis], observation.speed
                )
            else:
                answer = self._answer(image, observation.speed)
        except ValueError as error:
            raise DriverError(f"{self._path}: {error}") from None
        setup = self._setup
        steering = self._steering(answer, setup)
        if self.convention.outputs == "steering-throttle":
            return Controls(steering, max(float(answer[1]), 0.0), max(-float(answer[1]), 0.0))
        limit = observation.speed_limit
        if not math.isfinite(limit):  # an observation made by hand
            limit = setup.speed_limit
        if self.convention.max_speed is not None:
            limit = min(limit, self.convention.max_speed / 3.6)
        share = min(max(steering / setup.max_steering, -1.0), 1.0)
        return Controls(steering, max(1.0 - share**2 - (observation.speed / limit) ** 2, 0.0))

    def _answer(self, image: Image, speed: float) -> FloatArray:
        """Return the network's numbers for a camera's image, with the images before it.

        Raises:
            ValueError: they are too few or too many, or one is not finite.
        """
        top, bottom = self.convention.crop
        cropped = image[top : image.shape[0] - bottom]
        pixels = cropped.astype(np.float32) if self._resizing is None else self._resizing(cropped)
        height, width, _ = pixels.shape
        channels = self._weights @ pixels.reshape(-1, 3).T + self._constants
        planes = channels.reshape(-1, height, width)
        layout = self._image
        self._seen = [*(self._seen[1:] or [planes] * (layout.frames - 1)), planes]
        fed = np.stack(self._seen)  # (frames, channels, height, width)
        if layout.has_frame_axis:
            fed = fed if layout.is_nchw else fed.transpose(0, 2, 3, 1)
            is_batch = len(self._model.inputs[self._inputs.main]) == 5
            return self._run(fed[np.newaxis] if is_batch else fed, speed)
        fed = fed.reshape(1, -1, height, width)
        return self._run(fed if layout.is_nchw else fed.transpose(0, 2, 3, 1), speed)

    def _run(self, main: npt.NDArray[Any], speed: float) -> FloatArray:
        """The network's numbers for the image or vector, the speed and its states, which go on.

        Raises:
            ValueError: see `_answer`; or a state's next value has another shape.
        """
        inputs = self._inputs
        fed = {inputs.main: np.ascontiguousarray(main, dtype=np.float32), **self._states}
        if inputs.speed is not None:
            shape = [size or 1 for size in self._model.inputs[inputs.speed]]
            fed[inputs.speed] = np.full(shape, self.convention.speed_scale * speed, np.float32)
        results = self._model.run(fed)
        for name, output in inputs.states.items():
            value = results[output].astype(np.float32)
            if value.shape != self._states[name].shape:
                raise ValueError(
                    f"its output {output} has the shape {shown_shape(value.shape)}, but the state"
                    f" {name} has {shown_shape(self._states[name].shape)}"
                )
            self._states[name] = value
        fed_back = inputs.states.values()
        answer = np.concatenate(
            [
                np.empty(0),
                *(values.ravel() for name, values in results.items() if name not in fed_back),
            ]
        )
        outputs = self.convention.outputs
        if len(answer) != len(outputs.split("-")):
            raise ValueError(
                f"the network gives {len(answer)} numbers, but its outputs are {outputs}: give"
                " outputs"
            )
        if not np.isfinite(answer).all():
            raise ValueError(f"the network gives {answer[~np.isfinite(answer)][0]}")
        return answer

    def _steering(self, answer: FloatArray, setup: DriveSetup) -> float:
        """Angle of the front wheels in rad."""
        value = self.convention.steering_sign * float(answer[0])
        if self.convention.steering == "share":
            return value * setup.max_steering
        if self.convention.steering == "action":
            return controls_of(value, 0.0, self._numbers)[0]
        if self.convention.steering == "degrees":
            return math.radians(value)
        if self.convention.steering == "curvature":
            return math.atan(setup.wheelbase * value)
        return value


class Dave2(Network):
    """A network with the layers of DAVE-2 (M. Bojarski et al., arXiv:1604.07316).

    It has learnt in the embedded simulator to steer as pure pursuit does: ``training/dave2.py``
    made it.

    Args:
        max_speed: speed that its rule keeps, in km/h, see `Network`.

    Raises:
        FreneticError: onnxruntime is not installed.
        ValueError: `max_speed` is out of range.
    """

    BEHAVIOUR: ClassVar[int] = 1

    def __init__(self, *, max_speed: float = 50.0) -> None:
        super().__init__(str(DAVE2), max_speed=max_speed)

    @property
    def options(self) -> dict[str, Any]:
        """Its arguments; its file is part of its behaviour."""
        return dict(self._given)


class Resizing:
    """Bilinear resizing of images from one size to another, pixels' centres on pixels' centres.

    Args:
        size: (height, width) of the images that come.
        wanted: (height, width) of the images that go.
    """

    def __init__(self, size: tuple[int, int], wanted: tuple[int, int]) -> None:
        (self._above, self._below, down), (self._before, self._behind, across) = (
            _neighbours(*sizes) for sizes in zip(size, wanted, strict=True)
        )
        self._down, self._across = down[:, None, None], across[:, None]

    def __call__(self, image: Image) -> FloatImage:
        """Return the resized image."""
        pixels = image.astype(np.float32)
        above, below = pixels[self._above], pixels[self._below]
        rows = above + self._down * (below - above)
        before, behind = rows[:, self._before], rows[:, self._behind]
        resized: FloatImage = before + self._across * (behind - before)
        return resized


def _neighbours(
    size: int, wanted: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.float32]]:
    """(index before, index behind, weight of the latter), (wanted,) each, along an axis."""
    places = ((np.arange(wanted) + 0.5) * size / wanted - 0.5).clip(0.0, size - 1.0)
    before = places.astype(np.intp)
    behind = np.minimum(before + 1, size - 1)
    return before, behind, (places - before).astype(np.float32)


def _camera(options: Mapping[str, float], height: int | None, width: int | None) -> Camera:
    """Return the camera with the given fields, of the given size unless they say another.

    Raises:
        ValueError: there is no such field, or it is out of range.
    """
    if unknown := options.keys() - Camera.__dataclass_fields__.keys():
        known = ", ".join(Camera.__dataclass_fields__)
        raise ValueError(f"a camera has no {min(unknown)!r}; it has: {known}")
    sizes = {"height": height, "width": width}
    fields = {name: size for name, size in sizes.items() if size is not None} | dict(options)
    return Camera(**fields)  # type: ignore[arg-type]
