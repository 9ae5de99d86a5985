"""The environment of one car."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from frenetic.drivers import Camera
from frenetic.errors import FreneticError
from frenetic.gym.cars import START, STEP, Cars, Seen, checked_actions, plain_seed
from frenetic.gym.roads import RoadSource
from frenetic.oracle import RUNNING
from frenetic.road import MAP_SIZE, Road
from frenetic.simulators import Drive, EmbeddedSimulator

Vector = npt.NDArray[np.float32]


class LaneKeepingEnv(gymnasium.Env[Seen, Vector]):
    """One car that is to keep its lane, on another road in every episode.

    `frenetic.drivers.policy` describes the observation, (26,) float32 in -1..1, and the action,
    (2,) in -1..1: steering, then throttle (above 0) or brake. `frenetic.gym.cars` describes the
    reward. A step is a control period of the embedded simulator, 0.05 s.

    An episode is terminated when the car reaches the road's end, leaves its lane by more than the
    tolerance or gets stuck, and truncated when it takes longer than the rules allow. Then ``info``
    has the ``outcome`` (PASS or FAIL), the ``moobd`` and the ``distance`` along the road in m.

    Args:
        roads: roads to draw from, see `frenetic.gym.roads.RoadSource`; random ones by default. The
            seed decides. ``reset(options={"road": road})`` takes this `Road` for one episode.
        map_size: m, side of the map of random roads.
        camera: if given, an observation is a dictionary of the ``vector`` and the camera's
            ``image``, (height, width, 3) uint8.
        render_mode: None; the environment draws nothing, see `drive`.
        simulator: further options are those of `EmbeddedSimulator`, such as ``friction``.

    Raises:
        FreneticError: a file or folder of ``roads`` holds no road.
        ValueError: an option is out of range.
    """

    def __init__(
        self,
        *,
        roads: Sequence[Road | Path | str] | None = None,
        map_size: float = MAP_SIZE,
        camera: Camera | None = None,
        render_mode: None = None,
        **simulator: Any,
    ) -> None:
        self.render_mode = render_mode
        self._source = RoadSource(roads, map_size)
        self._cars = Cars(1, EmbeddedSimulator(**simulator), camera)
        self.observation_space = self._cars.observation_space
        self.action_space = self._cars.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Seen, dict[str, Any]]:
        """Puts the car at rest on the lane of another road."""
        super().reset(seed=plain_seed(seed))
        road = (options or {}).get("road")
        if road is None:
            road = self._source.draw(self.np_random)
        elif not isinstance(road, Road):
            raise FreneticError(f"options['road'] is {road!r}: a frenetic.Road is needed")
        self._cars.place(0, road)
        self._cars.step(_START, _NO_ACTION)
        return self._cars.observation(0), {}

    def step(self, action: Vector) -> tuple[Seen, float, bool, bool, dict[str, Any]]:
        """Drives on for a control period.

        Raises:
            ResetNeeded: the episode has ended.
            ValueError: the action is not two finite numbers.
        """
        cars = self._cars
        if cars.ends[0] != RUNNING:
            raise gymnasium.error.ResetNeeded("the episode has ended: call reset() first")
        cars.step(_STEP, checked_actions(np.expand_dims(action, 0), 1))
        is_over, truncated = bool(cars.ends[0] != RUNNING), bool(cars.timed_out[0])
        return (
            cars.observation(0),
            float(cars.rewards[0]),
            is_over and not truncated,
            truncated,
            cars.info(0),
        )

    @property
    def road(self) -> Road | None:
        """The road of this episode; None before the first one."""
        return self._cars.road(0)

    def drive(self) -> Drive:
        """The episode so far as a `Drive`, for `frenetic.judge` and `frenetic.draw_drive`."""
        return self._cars.drive(0)


_START, _STEP = np.array([START]), np.array([STEP])
_NO_ACTION = np.zeros((1, 2))
