"""MetaDrive's PPO expert: its network, and what it sees, from an `Observation` of any simulator.

The network comes with the package ``metadrive-simulator``; none of MetaDrive is imported for it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import pip_install
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.errors import FreneticError
from frenetic.metadrive.car import VEHICLE, Decision

WEIGHTS: Final = Path("examples", "ppo_expert", "expert_weights.npz")
"""Place of the network in MetaDrive's package."""
SIZE: Final = 275
"""Numbers that it sees, each in 0..1: 9 of the car, 10 of the road ahead, then of other cars."""
PIECE_LENGTH: Final = 40.0
"""Approximate length of a piece of road, in m; MetaDrive's own maps have lanes of 40 m and more."""
STRAIGHT_RADIUS: Final = 200.0
"""Least radius of an arc that is called straight, in m."""
_REACH: Final = 50.0  # m to a checkpoint at most
_LARGEST_RADIUS: Final = 60.0  # m, of MetaDrive's curves, at their middle
_LARGEST_ANGLE: Final = 135.0  # degrees, likewise
_MAP_WIDTH: Final = 18.0  # m
_LANE_WIDTH: Final = 4.5  # m, of the widest lane
_TOP_SPEED: Final = 80.0  # km/h
_OTHERS: Final = 16  # numbers of other cars, 0 without any; then the lidar's, 1


@cache
def weights() -> Mapping[str, FloatArray]:
    """The network, layer by layer.

    Raises:
        FreneticError: MetaDrive is not installed.
    """
    found = find_spec("metadrive")
    if found is None or not found.submodule_search_locations:
        raise FreneticError(
            f"the driver metadrive-expert needs the package metadrive: {pip_install('metadrive')}"
        )
    with np.load(Path(found.submodule_search_locations[0]) / WEIGHTS) as file:
        return dict(file)


def expert_action(seen: FloatArray) -> tuple[float, float]:
    """The expert's mean action, not cut to -1..1: steering to the left, throttle or brake.

    Args:
        seen: (275,), as MetaDrive's `LidarStateObservation` has it.
    """
    network = weights()

    def layer(name: str, inputs: FloatArray) -> FloatArray:
        kernel, bias = (network[f"default_policy/{name}/{part}"] for part in ("kernel", "bias"))
        outputs: FloatArray = inputs @ kernel + bias
        return outputs

    seen = seen.copy()
    seen[[10, 15]] = 1.0 - seen[[10, 15]]  # it was trained when MetaDrive's y pointed elsewhere
    hidden = np.tanh(layer("fc_2", np.tanh(layer("fc_1", seen))))
    steering, throttle_brake, *_spreads = layer("fc_out", hidden).tolist()
    return steering, throttle_brake


def state_of(
    observation: Observation,
    setup: DriveSetup,
    action: tuple[float, float] = (0.0, 0.0),
    turned: float = 0.0,
) -> FloatArray:
    """What MetaDrive's `LidarStateObservation` sees on an empty road, (275,) float32 in 0..1.

    Of the road it sees the ends of the present piece of 40 m and of the next, each taken for an
    arc that turns as far. It cannot know where the road ends: there it goes on straight.

    Args:
        observation: of the car.
        setup: of the drive.
        action: its last one, in -1..1: steering to the left, throttle or brake.
        turned: rad, change of the heading since then, within 0.1 s.
    """
    offset, width = observation.lateral_offset, setup.lane_width
    left = 0.5 * width - offset
    steering, pedal = action
    car = [
        left / _MAP_WIDTH,
        (width - left) / _MAP_WIDTH,
        0.5 - 0.5 * math.sin(observation.heading_error),
        (3.6 * math.hypot(observation.speed, observation.lateral_speed) + 1.0) / (_TOP_SPEED + 1.0),
        0.5 * (steering / 60.0 + 1.0),
        0.5 * (steering + 1.0),
        0.5 * (pedal + 1.0),
        abs(turned) / 0.1,
        0.5 - offset / _LANE_WIDTH,
    ]
    seen = np.zeros(SIZE, dtype=np.float32)
    seen[:9], seen[9:19] = car, _road_ahead(observation, width)
    seen[19 + _OTHERS :] = 1.0
    return np.clip(seen, 0.0, 1.0)


def _road_ahead(observation: Observation, width: float) -> list[float]:
    """Five numbers for the end of each of two pieces, as MetaDrive's navigation scales them."""
    lane = observation.lane(ahead=2.0 * PIECE_LENGTH + 1.0, behind=PIECE_LENGTH + 1.0)
    began = -(observation.distance % PIECE_LENGTH)
    ends = began + PIECE_LENGTH * np.arange(3)
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
        near = min(_REACH / max(math.hypot(ahead[i], left[i]), 1e-9), 1.0)
        numbers += [
            0.5 * (near * ahead[i] / _REACH + 1.0),
            0.5 * (near * left[i] / _REACH + 1.0),
            radius / (_LARGEST_RADIUS + width),
            0.5 - 0.5 * math.copysign(1.0, turn) if turn else 0.5,
            0.5 * (math.degrees(abs(turn)) / _LARGEST_ANGLE + 1.0),
        ]
    return numbers


class MetaDriveExpert:
    """The neural network that comes with MetaDrive, trained there by PPO; its mean action.

    Alone in MetaDrive it sees MetaDrive's own observation. Elsewhere, and under layers, it steers
    the wheels by the same angle as MetaDrive's car and accelerates like it, as far as that car can.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("metadrive-simulator",)
    """Distributions whose versions belong to it."""
    period: ClassVar[float] = 0.1
    """s: the time between two decisions in MetaDrive."""

    def reset(self, setup: DriveSetup) -> None:
        """Forgets the last drive.

        Raises:
            FreneticError: MetaDrive is not installed.
        """
        weights()
        self._setup, self._action, self._heading = setup, (0.0, 0.0), math.nan

    def act(self, observation: Observation) -> Controls:
        """The network's action, as the controls of this car."""
        turned = observation.heading - self._heading
        turned = 0.0 if math.isnan(turned) else turned
        seen = state_of(observation, self._setup, self._action, turned)
        steering, pedal = (min(max(value, -1.0), 1.0) for value in expert_action(seen))
        self._action, self._heading = (steering, pedal), observation.heading
        decision = Decision.of_action(steering, pedal)
        acceleration = (
            decision.throttle * VEHICLE.engine_acceleration
            - decision.brake * VEHICLE.brake_deceleration
        )
        return Controls.from_acceleration(
            acceleration, decision.steering, speed=observation.speed, setup=self._setup
        )
