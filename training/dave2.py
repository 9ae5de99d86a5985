"""Trains the network of the driver `dave2`, and says how it drives.

    python3 -m venv train && train/bin/pip install -r training/requirements.txt
    train/bin/python training/dave2.py --out dave2.onnx

An expert, pure pursuit of the lane's centre, says how to steer at what the camera sees. The first
frames are of its own drives, in which it is pushed about; then the network drives and the expert
says what would have been right, round after round (DAgger: S. Ross et al., AISTATS 2011), so it
learns to recover from its own errors. All roads are random ones. The same seed gives the same
network on the same machine with the same versions.

    train/bin/python training/dave2.py --out tuned.onnx --start model.h5

begins with a network that Keras has saved, made of convolutions and dense layers, which has learnt
in Udacity's simulator; `--rounds 0` writes and measures it as it is.

It uses a graphics card if there is one; without, it takes five minutes of one core's time.
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
from pathlib import Path
from statistics import median
from typing import Any, Final

import h5py
import numpy as np
import numpy.typing as npt
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
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
from frenetic.plugins.vision.neural import METADATA, Convention, Network
from frenetic.plugins.vision.neural.network import Resizing
from frenetic.search.random_search import RandomRoads

PRESET: Final = "dave2"
SIZE: Final = (66, 200)
"""Rows and columns that the network sees."""
UDACITY: Final[Mapping[str, Any]] = {
    "crop": [60, 25],
    "camera": {"width": 320, "height": 160, "field_of_view": 98.0, "pitch": 8.0},
}
"""What networks for Udacity's simulator see, over the preset. Unity's usual camera looks 60 degrees
up and down, which is 98 across; the horizon is in row 60 of its pictures, and its road is as wide
as ours is from the preset's 1.4 m."""
UDACITY_STEERING: Final = -math.radians(25.0)
"""Angle of the front wheels for an answer of 1: positive is right there."""
MAX_IN_FLIGHT: Final = 7.0
"""Distance of the place on the lane that the expert steers for, in m."""
SPEEDS: Final = (25.0, 60.0)
"""Range of the speeds at which is learnt, in km/h."""
KEPT: Final = 4
"""One in so many frames is kept: neighbours look alike."""
EXAMINED: Final = 1000
"""Frames that the finished network answers beside the expert."""
SCALE: Final = 8.0
"""What the last layer gives per share of the steering angle; roads need about an eighth of it."""
BATCH: Final = 64
RATE: Final = 1e-3
FRESH: Final = 1_000_000
"""Seed of the roads that only the finished network drives, and of the frames that it answers."""


@dataclass
class Frames:
    """What was seen, and how the expert steers there."""

    images: list[npt.NDArray[np.uint8]] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)
    """Shares of the front wheels' largest angle."""
    answers: list[float] = field(default_factory=list)
    """How the network steers there, likewise; NaN without one."""

    def __len__(self) -> int:
        return len(self.shares)


class Pupil:
    """A driver that keeps what it sees with the expert's steering.

    Args:
        convention: of the network.
        network: which is asked, if there is one.
        by_expert: whether the expert steers.
        frames: to which it adds.
        rng: for its choices.
        speed: km/h, by the rule of `Network`.
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
        self._kept = slice(top, self.camera.height - bottom)
        seen = (self.camera.height - top - bottom, self.camera.width)
        self._resizing = None if seen == SIZE else Resizing(seen, SIZE)
        self._by_expert = by_expert
        self._network, self._frames, self._rng = network, frames, rng
        self._speed = speed / 3.6
        self._expert = Planner(lookahead_time=0.0, lookahead_min=MAX_IN_FLIGHT)

    def reset(self, setup: DriveSetup) -> None:
        """Prepares for the next drive."""
        self._most = setup.max_steering
        self._push = 0.0
        self._expert.reset(setup)
        if self._network is not None:
            self._network.reset(setup)

    def act(self, observation: Observation) -> Controls:
        """The network's controls, or the expert's, pushed about."""
        right = self._expert.act(observation).steering / self._most
        answer = math.nan
        if self._network is not None:
            answer = self._network.act(observation).steering / self._most
        assert observation.image is not None
        if self._rng.random() < 1.0 / KEPT:
            self._frames.images.append(self._seen(observation.image))
            self._frames.shares.append(right)
            self._frames.answers.append(answer)
        if self._by_expert:
            self._push = 0.95 * self._push + self._rng.normal(0.0, 0.01)
            share = right + self._push
        else:
            share = answer
        throttle = max(1.0 - share**2 - (observation.speed / self._speed) ** 2, 0.0)
        return Controls(share * self._most, throttle)

    def _seen(self, image: Image) -> Image:
        """What the network sees of it."""
        kept = image[self._kept]
        if self._resizing is None:
            return kept.copy()
        resized: Image = np.rint(self._resizing(kept)).astype(np.uint8)
        return resized


def random_roads(seed: int) -> Iterator[Road]:
    """Valid random roads, as the search `random` proposes them on the usual map."""
    return RandomRoads().valid(np.random.default_rng(seed))


def drive(
    roads: Iterator[Road],
    n: int,
    convention: Convention,
    network: Network | None,
    frames: Frames,
    rng: np.random.Generator,
    by_expert: bool,
) -> None:
    """Adds n frames of drives along the roads, which begin beside the lane's centre."""
    until = len(frames) + n
    simulator = EmbeddedSimulator()
    while len(frames) < until:
        simulator.start_offset = float(rng.uniform(-1.2, 1.2))
        simulator.start_heading = float(rng.uniform(-0.15, 0.15))
        speed = float(rng.uniform(*SPEEDS))
        pupil = Pupil(convention, network, by_expert, frames, rng, speed)
        trouble = simulator.drive(next(roads), pupil).trouble
        assert trouble is None, trouble
    del frames.images[until:], frames.shares[until:], frames.answers[until:]


def dave2() -> nn.Sequential:
    """The network: inputs (n, 3, 66, 200), `SCALE` times the steering share (n, 1).

    DAVE-2 has 24 and 36 channels in its first two layers: these take half the time.
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
    """The network in a file of Keras, for inputs and outputs as those of `dave2`.

    Dropout and the scaling of pixels are left out. Kernels of Keras have rows, columns, inputs and
    outputs, and it flattens rows, columns and channels; here channels come first.

    Args:
        path: of the file, HDF5.
        with_weights: whether it has the file's weights; else random ones.
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
        unit = SCALE * UDACITY_STEERING / EmbeddedSimulator().vehicle.steering_limit
        with torch.no_grad():
            for values in layers[-1].parameters():
                values.mul_(unit)
    return nn.Sequential(*layers)


class Teacher:
    """Fits the network to frames.

    Args:
        make: of it.
        convention: of the network.
        seed: of its weights and of its lessons.
        device: that computes.
    """

    def __init__(
        self, make: Callable[[], nn.Sequential], convention: Convention, seed: int, device: str
    ) -> None:
        torch.manual_seed(seed)
        torch.use_deterministic_algorithms(True)
        self.network = make().to(device)
        self._device = device
        self._optimiser = torch.optim.AdamW(self.network.parameters(), lr=RATE, weight_decay=1e-4)
        self._generator = torch.Generator().manual_seed(seed)
        weights, constants = convention.from_pixels()
        self._weights = torch.from_numpy(weights).to(device)
        self._constants = torch.from_numpy(constants).to(device)

    def teach(self, frames: Frames, epochs: float, last_rate: float = RATE) -> float:
        """Fits for some passes over the frames; the rate falls to the last one by a cosine.

        Returns the mean absolute error over the last tenth, as a share of the steering angle.
        """
        images = np.stack(frames.images)
        wanted = torch.tensor(frames.shares, dtype=torch.float32)
        steps = round(epochs * len(frames) / BATCH)
        errors = []
        for step in range(steps):
            share = 0.5 + 0.5 * math.cos(math.pi * step / steps)
            for group in self._optimiser.param_groups:
                group["lr"] = last_rate + share * (RATE - last_rate)
            rows = torch.randint(len(frames), (BATCH,), generator=self._generator)
            seen = self._inputs(torch.from_numpy(images[rows.numpy()]))
            wished = SCALE * wanted[rows].to(self._device)
            missed = self.network(seen)[:, 0] - wished
            loss = nn.functional.huber_loss(missed, torch.zeros_like(missed), delta=0.3)
            self._optimiser.zero_grad()
            loss.backward()
            self._optimiser.step()
            errors.append(missed.detach().abs().mean().item() / SCALE)
        return float(np.mean(errors[-max(steps // 10, 1) :]))

    def _inputs(self, images: torch.Tensor) -> torch.Tensor:
        """Inputs of images, each in another light and with noise."""
        n = len(images)

        def drawn(*shape: int) -> torch.Tensor:
            return torch.randn(*shape, generator=self._generator).to(self._device)

        pixels = images.to(self._device).float()
        contrast, light = 1.0 + 0.15 * drawn(n, 1, 1, 1), 15.0 * drawn(n, 1, 1, 1)
        grain = 3.0 * drawn(n, pixels.shape[1], pixels.shape[2], 1)
        pixels = (pixels * contrast + light + grain).clamp(0.0, 255.0)
        channels = pixels.reshape(n, -1, 3) @ self._weights.T + self._constants[:, 0]
        return channels.reshape(pixels.shape).permute(0, 3, 1, 2)


def save(network: nn.Sequential, path: Path, entries: Mapping[str, Any]) -> None:
    """Writes the network as ONNX, with its convention; the same weights give the same bytes."""
    nodes, tensors, value = [], [], "image"
    layers = list(network.cpu())
    for i, layer in enumerate(layers):
        name = "steering" if i == len(layers) - 1 else f"x{i}"
        inputs = [value]
        if isinstance(layer, (nn.Conv2d, nn.Linear)):
            scale = SCALE if name == "steering" else 1.0
            for kind, values in layer.state_dict().items():
                inputs.append(f"{kind}{i}")
                tensors.append(
                    numpy_helper.from_array(values.numpy() / np.float32(scale), inputs[-1])
                )
        if isinstance(layer, nn.Conv2d):
            stride = [int(one) for one in layer.stride]
            nodes.append(helper.make_node("Conv", inputs, [name], strides=stride))
        elif isinstance(layer, nn.Linear):
            nodes.append(helper.make_node("Gemm", inputs, [name], transB=1))
        else:
            kind = {nn.ReLU: "Relu", nn.ELU: "Elu", nn.Flatten: "Flatten"}[type(layer)]
            nodes.append(helper.make_node(kind, inputs, [name]))
        value = name
    graph = helper.make_graph(
        nodes,
        "dave2",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, *SIZE])],
        [helper.make_tensor_value_info("steering", TensorProto.FLOAT, [1, 1])],
        tensors,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    model.producer_name, model.producer_version = "frenetic", ""
    helper.set_model_props(model, {METADATA: json.dumps(entries)})
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString(deterministic=True))


def measure(path: Path, speeds: Sequence[float], n: int) -> None:
    """Prints how the network steers beside the expert, and keeps its lane on fresh random roads."""
    network, frames, rng = Network(str(path)), Frames(), np.random.default_rng(FRESH)
    drive(random_roads(FRESH), EXAMINED, network.convention, network, frames, rng, by_expert=True)
    most = math.degrees(EmbeddedSimulator().vehicle.steering_limit)
    right, answers = most * np.array(frames.shares), most * np.array(frames.answers)
    print(
        f"{EXAMINED} frames of the expert's drives: it steers {np.abs(right).mean():.2f} degrees,"
        f" the network {np.abs(answers - right).mean():.2f} degrees from there,"
        f" {(answers - right).mean():+.2f} on average where left is positive,"
        f" correlation {np.corrcoef(right, answers)[0, 1]:.3f}",
        flush=True,
    )
    for speed in speeds:
        driver, simulator, roads = (
            Network(str(path), max_speed=speed),
            EmbeddedSimulator(),
            random_roads(FRESH),
        )
        driven = (next(roads) for _ in range(n))
        results = [judge(road, simulator.drive(road, driver)) for road in driven]
        passed = sum(result.outcome is Outcome.PASS for result in results)
        moobd = median(result.moobd for result in results if result.moobd is not None)
        print(f"{speed:g} km/h: {passed} of {n} random roads passed, median MOOBD {moobd:.2f} m")


def main() -> None:
    """Trains as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="The ONNX file.")
    parser.add_argument("--start", type=Path, help="Keras file of the network to begin with.")
    parser.add_argument("--forget", action="store_true", help="Only its layers, not its weights.")
    parser.add_argument(
        "--convention",
        type=json.loads,
        help="JSON, over the preset; of a start by default Udacity's.",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--frames", type=int, default=2000, help="Frames of each round.")
    parser.add_argument("--rounds", type=int, default=6, help="The first one by the expert.")
    parser.add_argument("--passes", type=float, default=1.5, help="Passes over all frames a round.")
    parser.add_argument("--last-passes", type=float, default=5.0, help="Passes at the end.")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--roads", type=int, default=200, help="Fresh roads of each measurement.")
    parser.add_argument("--speeds", type=float, nargs="*", default=[50.0])
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    make = dave2 if given.start is None else partial(from_keras, given.start, not given.forget)
    usual = {} if given.start is None else UDACITY
    entries = {"preset": PRESET, **(usual if given.convention is None else given.convention)}
    convention = Convention.of({}, entries)
    start, rng, frames = time.perf_counter(), np.random.default_rng(given.seed), Frames()
    teacher, roads, network = (
        Teacher(make, convention, given.seed, device),
        random_roads(given.seed),
        None,
    )
    save(teacher.network, given.out, entries)
    for i in range(given.rounds):
        teacher.network.to(device)
        drive(roads, given.frames, convention, network, frames, rng, by_expert=i == 0)
        driven = time.perf_counter() - start
        is_last = i == given.rounds - 1
        error = teacher.teach(
            frames, given.last_passes if is_last else given.passes, 1e-5 if is_last else RATE / 3
        )
        save(teacher.network, given.out, entries)
        network = Network(str(given.out))
        print(
            f"round {i + 1}: {len(frames)} frames after {driven:.0f} s, error {error:.4f} after"
            f" {time.perf_counter() - start:.0f} s",
            flush=True,
        )
    data = given.out.read_bytes()
    print(f"{given.out}: {len(data)} bytes, SHA-256 {hashlib.sha256(data).hexdigest()}")
    measure(given.out, given.speeds, given.roads)


if __name__ == "__main__":
    main()
