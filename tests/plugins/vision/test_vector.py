"""The vectorised environment behaves as single environments do."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from frenetic import Road, Rules
from frenetic.drivers import Camera
from frenetic.errors import FreneticError
from frenetic.plugins.gym import LaneKeepingEnv, LaneKeepingVectorEnv

CARS = 3
QUICK = Rules(stuck_distance=0.05, stuck_time=0.4, timeout_base=0.7, timeout_speed=1e3)
"""Rules that end episodes early, and at different steps: slow cars get stuck, others time out."""
CAMERA = Camera(width=6, height=4)


def pair(
    mode: AutoresetMode, camera: Camera | None
) -> tuple[LaneKeepingVectorEnv, SyncVectorEnv[Any, Any]]:
    """Return a vectorised environment and Gymnasium's vector of single environments."""
    vectorised = LaneKeepingVectorEnv(
        num_envs=CARS, autoreset_mode=mode, rules=QUICK, camera=camera
    )
    singles: SyncVectorEnv[Any, Any] = SyncVectorEnv(
        [lambda: LaneKeepingEnv(rules=QUICK, camera=camera)] * CARS, autoreset_mode=mode
    )
    return vectorised, singles


def alike(first: Any, second: Any) -> bool:
    """Return whether two results are equal, types included."""
    if isinstance(first, dict):
        assert isinstance(second, dict)
        return first.keys() == second.keys() and all(
            alike(first[key], second[key]) for key in first
        )
    if isinstance(first, np.ndarray) and first.dtype == object:
        return all(alike(a, b) for a, b in zip(first, second, strict=True))
    return bool(np.array_equal(first, second)) and getattr(first, "dtype", 0) == getattr(
        second, "dtype", 0
    )


@pytest.mark.parametrize(
    ("mode", "camera"),
    [(AutoresetMode.NEXT_STEP, None), (AutoresetMode.SAME_STEP, CAMERA)],
)
def test_cars_of_a_vector_drive_as_in_single_environments(
    mode: AutoresetMode, camera: Camera | None
) -> None:
    vectorised, singles = pair(mode, camera)
    assert vectorised.metadata["autoreset_mode"] is mode
    assert vectorised.observation_space == singles.observation_space
    assert vectorised.action_space == singles.action_space
    for first, second in zip(vectorised.reset(seed=5), singles.reset(seed=5), strict=True):
        assert alike(first, second)
    vectorised.action_space.seed(1)
    ends = np.zeros(2)  # terminated, truncated
    for _ in range(120):
        actions = vectorised.action_space.sample()
        results = vectorised.step(actions), singles.step(actions)
        for first, second in zip(*results, strict=True):
            assert alike(first, second), (first, second)
        ends += results[0][2].sum(), results[0][3].sum()
    assert ends.min() >= CARS


def test_the_option_road_sets_every_cars_road_for_one_episode() -> None:
    road = Road([0.0, 0.02, 0.03, 0.0, -0.02, 0.0])
    vectorised, singles = pair(AutoresetMode.SAME_STEP, None)

    def both(name: str, *args: Any, **options: Any) -> Any:
        results = (
            getattr(vectorised, name)(*args, **options),
            getattr(singles, name)(*args, **options),
        )
        for first, second in zip(*results, strict=True):
            assert alike(first, second), (first, second)
        return results[0]

    both("reset", seed=3)
    both("reset", seed=5, options={"road": road, "unknown": 1})
    assert [vectorised.road(k) for k in range(CARS)] == [road] * CARS
    for _ in range(40):
        actions = np.full((CARS, 2), 0.1, np.float32)
        if both("step", actions)[2].any():
            break
    assert vectorised.road(0) is not road
    with pytest.raises(FreneticError, match=r"options\['road'\] is 3: a frenetic.Road is needed"):
        vectorised.reset(options={"road": 3})


def test_gymnasium_makes_the_vectorised_environment() -> None:
    envs = gymnasium.make_vec("frenetic/LaneKeeping-v0", num_envs=2, rules=QUICK)
    assert isinstance(envs, LaneKeepingVectorEnv)
    envs = gymnasium.wrappers.vector.RecordEpisodeStatistics(envs)
    envs.reset(seed=1)
    still = np.zeros((2, 2), np.float32)
    for _ in range(7):
        assert not envs.step(still)[4]
    *_, terminated, truncated, infos = envs.step(still)
    assert terminated.all()
    assert not truncated.any()
    assert list(infos["episode"]["l"]) == [8, 8]
    assert envs.step(still)[1].tolist() == [0.0, 0.0]  # this step resets


def test_a_long_drive_and_a_long_road_equal_those_of_single_environments() -> None:
    """Buffers grow with a longer road and a longer drive."""
    short, long = Road([0.0] * 3), Road([0.0] * 60)
    rules = Rules(speed_limit=30.0, stuck_time=60.0)
    envs = LaneKeepingVectorEnv(num_envs=2, roads=[short, long], rules=rules)
    single = LaneKeepingEnv(rules=rules)
    envs.reset(seed=[1, 2])
    while envs.road(0) is envs.road(1) or envs.road(0) is long:
        envs.reset()
    gas = np.array([[0.0, 0.02], [0.0, 0.1]], np.float32)
    for _ in range(300):
        _, _, terminated, truncated, _ = envs.step(gas)
        assert not (terminated | truncated).any()
    for k in range(2):
        single.reset(options={"road": envs.road(k)})
        for _ in range(300):
            single.step(gas[k])
        trajectory, expected = envs.drive(k).trajectory, single.drive().trajectory
        assert len(trajectory) == 301
        assert np.array_equal(trajectory.to_rows(), expected.to_rows())


def test_each_car_has_its_own_seed() -> None:
    first, second = (LaneKeepingVectorEnv(num_envs=2) for _ in range(2))
    first.reset(seed=7)
    second.reset(seed=[7, 8])
    for k in range(2):
        road, expected = first.road(k), second.road(k)
        assert road is not None
        assert expected is not None
        assert np.array_equal(road.curvatures, expected.curvatures)


def test_invalid_options_and_actions_are_refused() -> None:
    for options in (
        {"num_envs": 0},
        *({"autoreset_mode": "never"}, {"autoreset_mode": "Disabled"}),
    ):
        with pytest.raises(ValueError):
            LaneKeepingVectorEnv(**options)
    envs = LaneKeepingVectorEnv(num_envs=2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(np.zeros((2, 2), np.float32))
    with pytest.raises(ValueError, match="2 cars"):
        envs.reset(seed=[1])
    envs.reset(seed=1)
    with pytest.raises(ValueError, match="shape"):
        envs.step(np.zeros((3, 2), np.float32))
