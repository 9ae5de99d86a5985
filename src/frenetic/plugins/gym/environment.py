"""The environments: of one car, and of many that are stepped in one compiled call; their roads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from frenetic._support.bounds import Count, check
from frenetic._support.files import require_list
from frenetic.campaign.database import DATABASE
from frenetic.campaign.store import CampaignStore
from frenetic.drivers import Camera
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import RUNNING
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.gym.cars import START, STEP, WAIT, Cars, Seen, checked_actions
from frenetic.road import MAP_SIZE, Road
from frenetic.road.folders import find_roads
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators import Drive, EmbeddedSimulator

Vector = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]


class LaneKeepingEnv(gymnasium.Env[Seen, Vector]):
    """One car that is to keep its lane, on another road in every episode.

    `frenetic.plugins.vision.policy` describes the observation, (26,) float32 in -1..1, and the
    action, (2,) in -1..1: steering, then throttle (above 0) or brake. `frenetic.plugins.gym.cars`
    describes the reward. A step is a control period of the embedded simulator, 0.05 s.

    An episode is terminated when the car reaches the road's end, leaves its lane by more than the
    tolerance or gets stuck, and truncated when it takes longer than the rules allow. Then ``info``
    has the ``outcome`` (PASS or FAIL), the ``moobd`` and the ``distance`` along the road in m.

    Args:
        roads: roads to draw from, see `RoadSource`; random ones by default. The
            seed decides. ``reset(options={"road": road})`` takes this `Road` for one episode.
        map_size: m, side of the map of random roads.
        camera: if given, an observation is a dictionary of the ``vector`` and the camera's
            ``image``, (height, width, 3) uint8.
        render_mode: None; the environment draws nothing, see `drive`.
        simulator: further options of `EmbeddedSimulator`, such as ``friction``.

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
        """Put the car at rest on the lane of another road.

        Args:
            seed: of this episode's road and the next ones.
            options: ``road``, a `Road` for this episode in place of a drawn one.

        Raises:
            FreneticError: ``road`` is none.
        """
        road = _given_road(options)
        super().reset(seed=seed)
        self._cars.place(0, self._source.draw(self.np_random) if road is None else road)
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


class LaneKeepingVectorEnv(VectorEnv[Seen, Vector, npt.NDArray[Any]]):
    """Many cars, each on a road of its own: `LaneKeepingEnv`, stepped in one compiled call.

    With the same seed, its episodes equal, bit for bit, the episodes of
    `gymnasium.vector.SyncVectorEnv` over as many `LaneKeepingEnv`.

    Args:
        num_envs: number of cars.
        autoreset_mode: `gymnasium.vector.AutoresetMode` or its value: ``NextStep`` or ``SameStep``.
        roads, map_size, camera, render_mode, simulator: see `LaneKeepingEnv`.

    Raises:
        FreneticError: a file or folder of ``roads`` holds no road.
        ValueError: an option is out of range.
    """

    def __init__(
        self,
        *,
        num_envs: Count = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        roads: Sequence[Road | Path | str] | None = None,
        map_size: float = MAP_SIZE,
        camera: Camera | None = None,
        render_mode: None = None,
        **simulator: Any,
    ) -> None:
        check({"num_envs": num_envs}, LaneKeepingVectorEnv.__init__)
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        if self.autoreset_mode is AutoresetMode.DISABLED:
            raise ValueError("autoreset_mode is Disabled: NextStep or SameStep is needed")
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self._source = RoadSource(roads, map_size)
        self._cars = Cars(num_envs, EmbeddedSimulator(**simulator), camera)
        self.single_observation_space = self._cars.observation_space
        self.single_action_space = self._cars.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator | None] = [None] * num_envs
        self._has_ended = np.ones(num_envs, np.bool_)  # no episode has begun

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Seen, dict[str, Any]]:
        """Put the cars at rest on other roads.

        Args:
            seed: of the first car, the next one for each other; or one for each car.
            options: ``road``, a `Road` for this episode of each of them in place of drawn ones.

        Raises:
            FreneticError: ``road`` is none.
            ValueError: the seeds are not one for each car.
        """
        road = _given_road(options)
        super().reset(seed=seed if isinstance(seed, int) else None)
        for k, own_seed in enumerate(self._seeds(seed)):
            if own_seed is not None:
                self._generators[k], _ = seeding.np_random(own_seed)
        self._start(np.ones(self.num_envs, np.bool_), road)
        return self._cars.observations(), {}

    def step(
        self, actions: Vector
    ) -> tuple[Seen, npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any], dict[str, Any]]:
        """Drives on for a control period; cars whose episode has ended are reset as the mode says.

        Raises:
            ResetNeeded: no episode has begun.
            ValueError: the actions are not (num_envs, 2) finite numbers.
        """
        checked = checked_actions(actions, self.num_envs)
        resets = self._has_ended
        if self._cars.road(0) is None:
            raise gymnasium.error.ResetNeeded("no episode has begun: call reset() first")
        self._place(resets)
        cars = self._cars
        cars.step(np.where(resets, START, STEP), checked)
        truncated = cars.timed_out
        self._has_ended = cars.ends != RUNNING
        terminated = self._has_ended & ~truncated
        rewards = cars.rewards.copy()
        infos: dict[str, Any] = {}
        ended = _numbers(self._has_ended)
        is_same_step = self.autoreset_mode is AutoresetMode.SAME_STEP
        for k in ended:
            info = cars.info(k)
            if is_same_step:
                info = {"final_obs": cars.observation(k), "final_info": info}
            infos = self._add_info(infos, info, k)
        if is_same_step and ended:
            self._start(self._has_ended)
        return cars.observations(), rewards, terminated, truncated, infos

    def road(self, k: int) -> Road | None:
        """Return the road of car ``k``; None before the first one."""
        return self._cars.road(k)

    def drive(self, k: int) -> Drive:
        """Return the episode of car ``k`` so far as a `Drive`."""
        return self._cars.drive(k)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> Sequence[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"{len(seed)} seeds are given: one for each of {self.num_envs} cars")
        return seed

    def _start(self, mask: Flags, road: Road | None = None) -> None:
        """Put some cars at rest on other roads, or all on a given one."""
        self._place(mask, road)
        self._cars.step(np.where(mask, START, WAIT), np.zeros((self.num_envs, 2)))
        self._has_ended = self._has_ended & ~mask

    def _place(self, mask: Flags, road: Road | None = None) -> None:
        """Draw roads for some cars, or place them on a given one."""
        for k in _numbers(mask):
            if road is not None:
                self._cars.place(k, road)
                continue
            generator = self._generators[k]
            if generator is None:
                generator = self._generators[k] = seeding.np_random()[0]
            self._cars.place(k, self._source.draw(generator))


def _given_road(options: Mapping[str, Any] | None) -> Road | None:
    """Return the road among the options of a reset; None without one."""
    road = (options or {}).get("road")
    if road is not None and not isinstance(road, Road):
        raise FreneticError(f"options['road'] is {road!r}: a frenetic.Road is needed")
    return road


def _numbers(mask: Flags) -> list[int]:
    """Return the cars that a mask (n,) names."""
    numbers: list[int] = mask.nonzero()[0].tolist()
    return numbers


# Roads


class RoadSource:
    """Gives a road for every drive.

    Args:
        given: roads to draw from, each of them a `Road`, a road file, a folder of road files, or a
            campaign's folder, which stands for the roads that failed there. None: random roads, as
            the strategy `random` proposes them, fitted into the map and valid.
        map_size: m, side of the map of random roads.

    Raises:
        FreneticError: a file or folder holds no road, or the list is empty.
        ValueError: `map_size` is out of range.
    """

    def __init__(
        self, roads: Sequence[Road | Path | str] | None, map_size: float = MAP_SIZE
    ) -> None:
        self._roads = None if roads is None else roads_of(roads)
        # Refused roads are drawn again here, where they are placed anyway.
        self._random = RandomRoads(map_size=map_size, max_redraws=0)

    def draw(self, rng: np.random.Generator) -> Road:
        """A road.

        Raises:
            ValueError: no road fits the map.
        """
        if self._roads is not None:
            return self._roads[int(rng.integers(len(self._roads)))]
        return next(self._random.valid(rng))


def roads_of(sources: Sequence[Road | Path | str]) -> list[Road]:
    """Return the roads of a list, see `RoadSource`, in its order.

    Raises:
        FreneticError: a file or folder holds no road, or the list is empty.
    """
    roads: list[Road] = []
    for source in require_list("roads", sources, "roads"):
        if isinstance(source, Road):
            roads.append(source)
        elif (Path(source) / DATABASE).exists():
            roads += _failed(Path(source))
        else:
            roads += find_roads([Path(source)]).roads.values()
    if not roads:
        raise FreneticError("roads is an empty list: at least one road is needed, or None")
    return roads


def _failed(folder: Path) -> list[Road]:
    """Return the roads that failed in a campaign."""
    with CampaignStore.open(folder) as store:
        roads = [test.road for test in store.tests(Outcome.FAIL)]
    if not roads:
        raise FreneticError(f"no road failed in the campaign {folder}")
    return roads
