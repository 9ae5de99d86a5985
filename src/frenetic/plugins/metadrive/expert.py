"""MetaDrive's PPO expert: its network, and its input, made from an `Observation` of any simulator.

The network's file comes with the package ``metadrive-simulator``; nothing of MetaDrive is imported.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import pip_install
from frenetic.drivers import DriveSetup, Observation
from frenetic.errors import FreneticError

WEIGHTS: Final = Path("examples", "ppo_expert", "expert_weights.npz")
"""Path of the network's file in MetaDrive's package."""
SIZE: Final = 275
"""Size of the network's input, whose numbers are in 0..1: 9 of the car, 10 of the road ahead, 16 of
other cars and 240 of the lidar."""
ACTION_SIZES: Final = (2, 4)
"""Sizes of a network's output: steering, and throttle or brake; the two spreads may follow."""
PIECE_LENGTH: Final = 40.0
"""Approximate length of a piece of road, in m: our choice, since MetaDrive's own maps have lanes of
40 m and more."""
STRAIGHT_RADIUS: Final = 200.0
"""Radius in m from which on an arc counts as straight; our choice."""
# Full scales of the input, as MetaDrive has them
_CHECKPOINT_REACH: Final = 50.0  # m, largest distance of a checkpoint
_LARGEST_RADIUS: Final = 60.0  # m, of a curve at its middle
_LARGEST_ANGLE: Final = 135.0  # degrees, of a curve
_MAP_WIDTH: Final = 18.0  # m
_LANE_WIDTH: Final = 4.5  # m, of the widest lane
_TOP_SPEED: Final = 80.0  # km/h
_STEERING_SCALE: Final = 60.0  # MetaDrive divides the steering, -1..1, by this angle in degrees
_DECISION_PERIOD: Final = 0.1  # s
# Layout of the input
_CAR_NUMBERS: Final = 9
_ROAD_NUMBERS: Final = 10
_OTHER_CAR_NUMBERS: Final = 16  # all 0 without other cars; the lidar's numbers follow, 1 without
_MIRRORED: Final = [10, 15]  # the two checkpoints' positions across the car


@cache
def weights() -> Mapping[str, FloatArray]:
    """Return the expert's network: name of an array -> array.

    Raises:
        FreneticError: MetaDrive is not installed.
    """
    package = find_spec("metadrive")
    if package is None or not package.submodule_search_locations:
        raise FreneticError(
            f"the driver metadrive-expert needs the package metadrive: {pip_install('metadrive')}"
        )
    return read_weights((Path(package.submodule_search_locations[0]) / WEIGHTS).read_bytes())


def read_weights(data: bytes) -> Mapping[str, FloatArray]:
    """Return a network: name of an array -> array, named as in the expert's file.

    The hidden layers may have any sizes.

    Args:
        data: content of a ``.npz`` file; nothing in it is executed.

    Raises:
        ValueError: the data are no ``.npz`` file, lack an array, or an array has another shape.
    """
    try:
        with np.load(BytesIO(data), allow_pickle=False) as file:
            network = dict(file)
    except Exception:  # zip archive and arrays raise errors of many classes
        raise ValueError("it is no .npz file of numbers, as numpy.savez writes it") from None
    size = SIZE
    for layer, sizes in (("fc_1", None), ("fc_2", None), ("fc_out", ACTION_SIZES)):
        kernel, bias = (f"default_policy/{layer}/{part}" for part in ("kernel", "bias"))
        for name in (kernel, bias):
            if name not in network:
                raise ValueError(f"it has no array {name}")
            if network[name].dtype.kind != "f" or not np.isfinite(network[name]).all():
                raise ValueError(f"its {name} must be finite floats")
        shape, last = network[kernel].shape, network[kernel].shape[-1:]
        if len(shape) != 2 or shape[0] != size or shape[1] not in (sizes or last):
            wanted = " or ".join(map(str, sizes)) if sizes else "any"
            raise ValueError(f"its {kernel} has the shape {shape}: ({size}, {wanted}) is needed")
        if network[bias].shape != last:
            raise ValueError(f"its {bias} has the shape {network[bias].shape}: {last} is needed")
        size = shape[1]
    return network


def expert_action(state: FloatArray) -> tuple[float, float]:
    """Return the expert's mean action, see `mean_action`.

    Args:
        state: (275,) observation, as MetaDrive's `LidarStateObservation` returns it.
    """
    state = state.copy()
    state[_MIRRORED] = 1.0 - state[_MIRRORED]  # MetaDrive's y axis has been turned since training
    return mean_action(state, weights())


def mean_action(state: FloatArray, network: Mapping[str, FloatArray]) -> tuple[float, float]:
    """Return a network's mean action, not cut to -1..1: steering to the left, throttle or brake.

    Args:
        state: (275,) input of the network.
        network: network, as `read_weights` returns it.
    """

    def layer(name: str, inputs: FloatArray) -> FloatArray:
        outputs: FloatArray = (
            inputs @ network[f"default_policy/{name}/kernel"]
            + network[f"default_policy/{name}/bias"]
        )
        return outputs

    for name in ("fc_1", "fc_2"):
        state = np.tanh(layer(name, state))
    steering, throttle_brake, *_spreads = layer("fc_out", state).tolist()
    return steering, throttle_brake


def state_of(
    observation: Observation,
    setup: DriveSetup,
    action: tuple[float, float] = (0.0, 0.0),
    turned: float = 0.0,
) -> FloatArray:
    """Return the observation that `LidarStateObservation` makes on an empty road, (275,) in 0..1.

    Of the road it has the ends of the present piece of 40 m and of the next piece. Each piece is
    taken for an arc that turns by the same angle. After the road's end the road is straight,
    because an `Observation` does not say where it ends.

    Args:
        observation: observation of the car.
        setup: setup of the drive.
        action: last action, -1..1: steering to the left, throttle or brake.
        turned: change of the heading since the last action, in rad, within 0.1 s.
    """
    offset, width = observation.lateral_offset, setup.lane_width
    left = 0.5 * width - offset
    steering, pedal = action
    car = [
        left / _MAP_WIDTH,
        (width - left) / _MAP_WIDTH,
        0.5 - 0.5 * math.sin(observation.heading_error),
        (3.6 * math.hypot(observation.speed, observation.lateral_speed) + 1.0) / (_TOP_SPEED + 1.0),
        0.5 * (steering / _STEERING_SCALE + 1.0),
        0.5 * (steering + 1.0),
        0.5 * (pedal + 1.0),
        abs(turned) / _DECISION_PERIOD,
        0.5 - offset / _LANE_WIDTH,
    ]
    state = np.zeros(SIZE, dtype=np.float32)
    end_of_road = _CAR_NUMBERS + _ROAD_NUMBERS
    state[:_CAR_NUMBERS] = car
    state[_CAR_NUMBERS:end_of_road] = _road_ahead(observation, width)
    state[end_of_road + _OTHER_CAR_NUMBERS :] = 1.0
    return np.clip(state, 0.0, 1.0)


def _road_ahead(observation: Observation, width: float) -> list[float]:
    """Return five numbers for the end of each of two pieces, as MetaDrive scales them."""
    lane = observation.lane(ahead=2.0 * PIECE_LENGTH + 1.0, behind=PIECE_LENGTH + 1.0)
    piece_start = -(observation.distance % PIECE_LENGTH)  # m ahead of the car
    ends = piece_start + PIECE_LENGTH * np.arange(3)
    heading, ahead, left = (
        np.interp(ends, lane.distances, values) for values in (lane.headings, *lane.points.T)
    )
    numbers: list[float] = []
    for i in (1, 2):
        turn = float(heading[i] - heading[i - 1])
        # A parallel on the right is longer where the road turns left.
        length = PIECE_LENGTH + 0.5 * width * turn
        radius = length / abs(turn) if turn else math.inf
        if radius > STRAIGHT_RADIUS:
            radius, turn = 0.0, 0.0
        # A checkpoint farther away than the reach moves nearer, in the same direction.
        near = min(_CHECKPOINT_REACH / max(math.hypot(ahead[i], left[i]), 1e-9), 1.0)
        numbers += [
            0.5 * (near * ahead[i] / _CHECKPOINT_REACH + 1.0),
            0.5 * (near * left[i] / _CHECKPOINT_REACH + 1.0),
            radius / (_LARGEST_RADIUS + width),
            0.5 - 0.5 * math.copysign(1.0, turn) if turn else 0.5,
            0.5 * (math.degrees(abs(turn)) / _LARGEST_ANGLE + 1.0),
        ]
    return numbers
