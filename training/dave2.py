"""Train the network of the driver `dave2`, and print how well it drives.

    python3 -m venv train && train/bin/pip install -r training/requirements.txt
    train/bin/python training/dave2.py --out dave2.onnx

An expert steers by pure pursuit of the lane's centre. In the first round the expert drives, with
random disturbances of its steering, and the network learns the expert's steering from the camera's
images. In each further round the network drives, and the expert says how it would have steered, so
the network learns to recover from its own errors (DAgger: S. Ross et al., AISTATS 2011). All roads
are random. The same seed gives the same network on the same machine with the same versions.

Training may also begin with a network that Keras has saved, made of convolutions and dense layers
and trained in Udacity's simulator:

    train/bin/python training/dave2.py --out tuned.onnx --start model.h5

`--rounds 0` writes and measures this network without training.

Training uses a graphics card if there is one. On one core it takes five minutes.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any, Final

import h5py
import numpy as np
import numpy.typing as npt
import torch
from onnx_export import Value, write_network
from torch import nn

from frenetic import (
    Camera,
    Controls,
    DriveSetup,
    EmbeddedSimulator,
    Observation,
    Outcome,
    Planner,
    Road,
    judge,
)
from frenetic.drivers.camera import Image
from frenetic.plugins.vision.neural import Convention, Network
from frenetic.plugins.vision.neural.network import Resizing
from frenetic.search.random_roads import RandomRoads

PRESET: Final = "dave2"
"""Name of the preset in the network's convention."""
INPUT_SIZE: Final = (66, 200)
"""Rows and columns of the network's input."""
UDACITY: Final[Mapping[str, Any]] = {
    "crop": [60, 25],
    "camera": {"width": 320, "height": 160, "field_of_view": 98.0, "pitch": 8.0},
}
"""Fields of the convention of networks for Udacity's simulator that differ from the preset.

Unity's default camera has a field of view of 60 degrees vertically, which is 98 horizontally. In
Udacity's pictures the horizon is in row 60, and the road is as wide as our road looks from the
preset's height of 1.4 m."""
UDACITY_STEERING: Final = -math.radians(25.0)
"""Angle of the front wheels, in rad, for an output of 1, which steers right in that simulator."""

# The numbers below are our choice.
TARGET_DISTANCE: Final = 7.0
"""Distance to the point of the lane for which the expert steers, in m."""
SPEEDS: Final = (25.0, 60.0)
"""Range of the training drives' speeds, in km/h."""
MOST_START_OFFSET: Final = 1.2
"""Largest distance from the lane's centre at which a training drive starts, in m."""
MOST_START_HEADING: Final = 0.15
"""Largest angle between car and road at the start of a training drive, in rad."""
DISTURBANCE_MEMORY: Final = 0.95
"""Share of the disturbance of the expert's steering that is left after a control period."""
DISTURBANCE_DEVIATION: Final = 0.01
"""Standard deviation of what the disturbance gains in a control period, as a share of the largest
steering angle."""
SAMPLED_EVERY: Final = 4
"""Mean number of control periods from one frame to the next; neighbouring images look alike."""
EXAM_FRAMES: Final = 1000
"""Frames on which the finished network is compared with the expert."""
OUTPUT_SCALE: Final = 8.0
"""Output of the last layer for the largest steering angle. Roads need about an eighth of this
angle, so most outputs are within -1..1."""
BATCH_SIZE: Final = 64
"""Number of frames in a step of the training."""
LEARNING_RATE: Final = 1e-3
"""Learning rate at the start of each round."""
ROUND_END_RATE: Final = LEARNING_RATE / 3
"""Learning rate at the end of each round but the last."""
FINAL_RATE: Final = 1e-5
"""Learning rate at the end of the last round."""
CONTRAST_DEVIATION: Final = 0.15
"""Standard deviation of the factor by which an image's contrast is changed."""
LIGHT_DEVIATION: Final = 15.0
"""Standard deviation of what is added to all pixels of an image, of 255."""
GRAIN_DEVIATION: Final = 3.0
"""Standard deviation of what is added to each pixel, of 255."""
EXAM_SEED: Final = 1_000_000
"""Seed of the roads and frames on which only the finished network is measured."""


@dataclass
class Frames:
    """Images of a camera with the steering of expert and network."""

    images: list[npt.NDArray[np.uint8]] = field(default_factory=list)
    """Images of the size of the network's input, (66, 200, 3) RGB."""
    shares: list[float] = field(default_factory=list)
    """The expert's steering, as shares of the front wheels' largest angle."""
    answers: list[float] = field(default_factory=list)
    """The network's steering, as shares of the largest angle; NaN without a network."""

    def __len__(self) -> int:
        return len(self.shares)


class Pupil:
    """A driver that collects frames.

    Args:
        convention: convention of the network.
        network: network that is asked, too; None if there is none yet.
        by_expert: whether the expert steers rather than the network.
        frames: frames to which the pupil adds.
        rng: generator for the choice of frames and for disturbances.
        speed: speed that the throttle approaches by the rule of `Network`, in km/h.
    """

    def __init__(
        self,
        convention: Convention,
        network: Network | None,
        by_expert: bool,
        frames: Frames,
        rng: np.random.Generator,
        speed: float,
    ) -> None:
        self.camera = Camera(**convention.camera)  # type: ignore[arg-type]
        top, bottom = convention.crop
        self._cropped_rows = slice(top, self.camera.height - bottom)
        image_size = (self.camera.height - top - bottom, self.camera.width)
        self._resizing = None if image_size == INPUT_SIZE else Resizing(image_size, INPUT_SIZE)
        self._by_expert = by_expert
        self._network, self._frames, self._rng = network, frames, rng
        self._speed = speed / 3.6
        self._expert = Planner(lookahead_time=0.0, lookahead_min=TARGET_DISTANCE)

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self._max_steering = setup.max_steering
        self._disturbance = 0.0
        self._expert.reset(setup)
        if self._network is not None:
            self._network.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """Return the network's controls, or the expert's with a disturbance."""
        expert_share = self._expert.act(observation).steering / self._max_steering
        answer = math.nan
        if self._network is not None:
            answer = self._network.act(observation).steering / self._max_steering
        assert observation.image is not None
        if self._rng.random() < 1.0 / SAMPLED_EVERY:
            self._frames.images.append(self._input_image(observation.image))
            self._frames.shares.append(expert_share)
            self._frames.answers.append(answer)
        if self._by_expert:
            gain = self._rng.normal(0.0, DISTURBANCE_DEVIATION)
            self._disturbance = DISTURBANCE_MEMORY * self._disturbance + gain
            share = expert_share + self._disturbance
        else:
            share = answer
        throttle = max(1.0 - share**2 - (observation.speed / self._speed) ** 2, 0.0)
        return Controls(share * self._max_steering, throttle)

    def _input_image(self, image: Image) -> Image:
        """Return the image cropped and resized to the network's input."""
        cropped = image[self._cropped_rows]
        if self._resizing is None:
            return cropped.copy()
        resized: Image = np.rint(self._resizing(cropped)).astype(np.uint8)
        return resized


def random_roads(seed: int) -> Iterator[Road]:
    """Yield valid random roads, as the search `random` proposes them on the default map."""
    return RandomRoads().valid(np.random.default_rng(seed))


def drive(
    roads: Iterator[Road],
    frames: Frames,
    count: int,
    rng: np.random.Generator,
    convention: Convention,
    network: Network | None,
    *,
    by_expert: bool,
) -> None:
    """Add frames of drives along the roads.

    Args:
        roads: roads, each for one drive.
        frames: frames to which the drives' frames are added.
        count: number of frames to add.
        rng: generator for starts, speeds and the `Pupil`.
        convention, network, by_expert: as in a `Pupil`.
    """
    target = len(frames) + count
    simulator = EmbeddedSimulator()
    while len(frames) < target:
        simulator.start_offset = float(rng.uniform(-MOST_START_OFFSET, MOST_START_OFFSET))
        simulator.start_heading = float(rng.uniform(-MOST_START_HEADING, MOST_START_HEADING))
        speed = float(rng.uniform(*SPEEDS))
        pupil = Pupil(convention, network, by_expert, frames, rng, speed)
        trouble = simulator.drive(next(roads), pupil).trouble
        assert trouble is None, trouble
    # The last drive may have added more frames than asked for.
    del frames.images[target:], frames.shares[target:], frames.answers[target:]


def dave2() -> nn.Sequential:
    """Return the untrained network.

    It maps images, (n, 3, 66, 200), to `OUTPUT_SCALE` times the share of the largest steering
    angle, (n, 1). The first two layers have 16 and 32 channels rather than DAVE-2's 24 and 36,
    which halves the time.
    """
    return nn.Sequential(
        *(nn.Conv2d(3, 16, 5, 2), nn.ReLU()),
        *(nn.Conv2d(16, 32, 5, 2), nn.ReLU()),
        *(nn.Conv2d(32, 48, 5, 2), nn.ReLU()),
        *(nn.Conv2d(48, 64, 3), nn.ReLU()),
        *(nn.Conv2d(64, 64, 3), nn.ReLU(), nn.Flatten()),
        *(nn.Linear(1152, 100), nn.ReLU()),
        *(nn.Linear(100, 50), nn.ReLU()),
        *(nn.Linear(50, 10), nn.ReLU()),
        nn.Linear(10, 1),
    )


def from_keras(path: Path, with_weights: bool) -> nn.Sequential:
    """Return the network in a file of Keras, with inputs and outputs like the one of `dave2`.

    Dropout and the scaling of pixels are left out. Keras orders axes in another way: its kernels
    have the axes rows, columns, inputs, outputs, and it flattens rows, columns, channels. In torch
    outputs, inputs and channels come first.

    Args:
        path: the file, HDF5.
        with_weights: whether to take the file's weights rather than random weights.
    """
    layers: list[nn.Module] = []
    channels = 3
    with h5py.File(path) as file:
        config = json.loads(file.attrs["model_config"])["config"]
        for entry in config if isinstance(config, list) else config["layers"]:
            options = entry["config"]
            if entry["class_name"] == "Flatten":
                layers.append(nn.Flatten())
            if entry["class_name"] not in ("Conv2D", "Convolution2D", "Dense"):
                continue
            group = file["model_weights"][options["name"]]
            names = group.attrs["weight_names"]
            kernel, bias = (torch.from_numpy(group[name][()]) for name in names)
            layer: nn.Conv2d | nn.Linear
            if kernel.ndim == 4:
                rows, columns, channels_in, channels = kernel.shape
                stride = tuple(options.get("strides") or options["subsample"])
                layer = nn.Conv2d(channels_in, channels, (rows, columns), stride)
                kernel = kernel.permute(3, 2, 0, 1)
            else:
                layer = nn.Linear(*kernel.shape)
                if isinstance(layers[-1], nn.Flatten):
                    by_place = kernel.reshape(-1, channels, kernel.shape[1])
                    kernel = by_place.transpose(0, 1).reshape(kernel.shape)
                kernel = kernel.T
            if with_weights:
                layer.load_state_dict({"weight": kernel, "bias": bias})
            layers.append(layer)
            if options["activation"] != "linear":
                layers.append({"elu": nn.ELU, "relu": nn.ReLU}[options["activation"]]())
    if with_weights:
        # From Udacity's unit of steering to the output of `dave2`.
        unit = OUTPUT_SCALE * UDACITY_STEERING / EmbeddedSimulator().vehicle.steering_limit
        with torch.no_grad():
            for values in layers[-1].parameters():
                values.mul_(unit)
    return nn.Sequential(*layers)


class Teacher:
    """Fits the network to frames.

    Args:
        make: function that returns the network to train.
        convention: convention of the network.
        seed: seed of the first weights and of the choice of frames.
        device: device that computes, "cpu" or "cuda".
    """

    def __init__(
        self, make: Callable[[], nn.Sequential], convention: Convention, seed: int, device: str
    ) -> None:
        torch.manual_seed(seed)
        torch.use_deterministic_algorithms(True)
        self.network = make().to(device)
        self._device = device
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=LEARNING_RATE, weight_decay=1e-4
        )
        self._generator = torch.Generator().manual_seed(seed)
        weights, constants = convention.channel_map()
        self._weights = torch.from_numpy(weights).to(device)
        self._constants = torch.from_numpy(constants).to(device)

    def teach(self, frames: Frames, epochs: float, last_rate: float) -> float:
        """Train the network; the learning rate falls from `LEARNING_RATE` along a cosine.

        Args:
            frames: frames to learn from.
            epochs: number of passes over the frames.
            last_rate: learning rate at the end.

        Returns:
            Mean absolute error over the last tenth of the steps, as a share of the largest
            steering angle.
        """
        images = np.stack(frames.images)
        expert_shares = torch.tensor(frames.shares, dtype=torch.float32)
        steps = round(epochs * len(frames) / BATCH_SIZE)
        errors = []
        for step in range(steps):
            share = 0.5 + 0.5 * math.cos(math.pi * step / steps)  # from 1 to 0
            for group in self._optimiser.param_groups:
                group["lr"] = last_rate + share * (LEARNING_RATE - last_rate)
            rows = torch.randint(len(frames), (BATCH_SIZE,), generator=self._generator)
            inputs = self._inputs(torch.from_numpy(images[rows.numpy()]))
            targets = OUTPUT_SCALE * expert_shares[rows].to(self._device)
            residuals = self.network(inputs)[:, 0] - targets
            loss = nn.functional.huber_loss(residuals, torch.zeros_like(residuals), delta=0.3)
            self._optimiser.zero_grad()
            loss.backward()
            self._optimiser.step()
            errors.append(residuals.detach().abs().mean().item() / OUTPUT_SCALE)
        return float(np.mean(errors[-max(steps // 10, 1) :]))

    def _inputs(self, images: torch.Tensor) -> torch.Tensor:
        """Return the network's inputs for images, with random contrast, light and noise."""
        n = len(images)

        def normal(*shape: int) -> torch.Tensor:
            """Return random numbers of the standard normal distribution."""
            return torch.randn(*shape, generator=self._generator).to(self._device)

        pixels = images.to(self._device).float()
        contrast = 1.0 + CONTRAST_DEVIATION * normal(n, 1, 1, 1)
        light = LIGHT_DEVIATION * normal(n, 1, 1, 1)
        grain = GRAIN_DEVIATION * normal(n, pixels.shape[1], pixels.shape[2], 1)
        pixels = (pixels * contrast + light + grain).clamp(0.0, 255.0)
        channels = pixels.reshape(n, -1, 3) @ self._weights.T + self._constants[:, 0]
        return channels.reshape(pixels.shape).permute(0, 3, 1, 2)


def save(network: nn.Sequential, path: Path, entries: Mapping[str, Any]) -> None:
    """Write the network as ONNX; the same weights give the same bytes.

    Args:
        network: the network; it is moved to the processor.
        path: the file.
        entries: fields of the network's convention.
    """
    write_network(
        network.cpu(),
        path,
        name="dave2",
        takes=Value("image", [1, 3, *INPUT_SIZE]),
        gives=Value("steering", [1, 1]),
        entries=entries,
        output_scale=OUTPUT_SCALE,
    )


def measure(path: Path, speeds: Sequence[float], count: int) -> None:
    """Print how the network's steering differs from the expert's, and how often it keeps its lane.

    Args:
        path: the network's file.
        speeds: speeds of the drives, in km/h.
        count: number of fresh random roads that the network drives at each speed.
    """
    network, frames, rng = Network(str(path)), Frames(), np.random.default_rng(EXAM_SEED)
    roads = random_roads(EXAM_SEED)
    drive(roads, frames, EXAM_FRAMES, rng, network.convention, network, by_expert=True)
    limit = math.degrees(EmbeddedSimulator().vehicle.steering_limit)
    expert, answers = limit * np.array(frames.shares), limit * np.array(frames.answers)
    print(
        f"{EXAM_FRAMES} frames of the expert's drives: it steers {np.abs(expert).mean():.2f}"
        f" degrees, the network {np.abs(answers - expert).mean():.2f} degrees from there,"
        f" {(answers - expert).mean():+.2f} on average where left is positive,"
        f" correlation {np.corrcoef(expert, answers)[0, 1]:.3f}",
        flush=True,
    )
    for speed in speeds:
        driver, simulator = Network(str(path), max_speed=speed), EmbeddedSimulator()
        exam_roads = islice(random_roads(EXAM_SEED), count)
        results = [judge(road, simulator.drive(road, driver)) for road in exam_roads]
        passed = sum(result.outcome is Outcome.PASS for result in results)
        moobd = median(result.moobd for result in results if result.moobd is not None)
        print(
            f"{speed:g} km/h: {passed} of {count} random roads passed, median MOOBD {moobd:.2f} m"
        )


def parsed_arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="The ONNX file.")
    parser.add_argument("--start", type=Path, help="Keras file of the network to begin with.")
    parser.add_argument(
        "--forget", action="store_true", help="Take the layers of --start, not their weights."
    )
    parser.add_argument(
        "--convention",
        type=json.loads,
        help="JSON, over the preset. [default: with --start that of Udacity's simulator]",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=2000, help="Frames of each round.")
    parser.add_argument(
        "--rounds", type=int, default=6, help="Rounds; the expert drives the first."
    )
    parser.add_argument(
        "--passes", type=float, default=1.5, help="Passes over all frames in a round."
    )
    parser.add_argument("--last-passes", type=float, default=5.0, help="Passes in the last round.")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--roads", type=int, default=200, help="Fresh roads of each measurement.")
    parser.add_argument("--speeds", type=float, nargs="*", default=[50.0], help="km/h.")
    return parser.parse_args()


def train(options: argparse.Namespace, entries: Mapping[str, Any]) -> None:
    """Train the network in rounds; write its file and print the errors after each.

    Args:
        options: the arguments, see `parsed_arguments`.
        entries: fields of the network's convention.
    """
    device = "cuda" if torch.cuda.is_available() else "cpu"
    make = (
        dave2 if options.start is None else partial(from_keras, options.start, not options.forget)
    )
    convention = Convention.of({}, entries)
    start, rng, frames = time.perf_counter(), np.random.default_rng(options.seed), Frames()
    teacher, roads = Teacher(make, convention, options.seed, device), random_roads(options.seed)
    network = None
    save(teacher.network, options.out, entries)
    for i in range(options.rounds):
        teacher.network.to(device)
        drive(roads, frames, options.frames, rng, convention, network, by_expert=i == 0)
        drive_end = time.perf_counter() - start
        is_last = i == options.rounds - 1
        error = teacher.teach(
            frames,
            epochs=options.last_passes if is_last else options.passes,
            last_rate=FINAL_RATE if is_last else ROUND_END_RATE,
        )
        save(teacher.network, options.out, entries)
        network = Network(str(options.out))
        print(
            f"round {i + 1}: {len(frames)} frames after {drive_end:.0f} s, error {error:.4f} after"
            f" {time.perf_counter() - start:.0f} s",
            flush=True,
        )


def main() -> None:
    """Train and measure as the arguments say."""
    options = parsed_arguments()
    torch.set_num_threads(options.threads)
    defaults = {} if options.start is None else UDACITY
    train(
        options,
        {"preset": PRESET, **(defaults if options.convention is None else options.convention)},
    )
    data = options.out.read_bytes()
    print(f"{options.out}: {len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()}")
    measure(options.out, options.speeds, options.roads)


if __name__ == "__main__":
    main()
