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
"""Cars that begin slowly are stuck, others take too long: episodes end early, not all at once."""


CAMERA = Camera(width=6, height=4)


def pair(
    mode: AutoresetMode, camera: Camera | None
) -> tuple[LaneKeepingVectorEnv, SyncVectorEnv[Any, Any]]:
    ours = LaneKeepingVectorEnv(num_envs=CARS, autoreset_mode=mode, rules=QUICK, camera=camera)
    singles: SyncVectorEnv[Any, Any] = SyncVectorEnv(
        [lambda: LaneKeepingEnv(rules=QUICK, camera=camera)] * CARS, autoreset_mode=mode
    )
    return ours, singles


def alike(first: Any, second: Any) -> bool:
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
def test_many_cars_drive_as_one_by_one(mode: AutoresetMode, camera: Camera | None) -> None:
    ours, singles = pair(mode, camera)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == singles.observation_space
    assert ours.action_space == singles.action_space
    for first, second in zip(ours.reset(seed=5), singles.reset(seed=5), strict=True):
        assert alike(first, second)
    ours.action_space.seed(1)
    ends = np.zeros(2)  # terminated, truncated
    for _ in range(120):
        actions = ours.action_space.sample()
        results = ours.step(actions), singles.step(actions)
        for first, second in zip(*results, strict=True):
            assert alike(first, second), (first, second)
        ends += results[0][2].sum(), results[0][3].sum()
    assert ends.min() >= CARS


def test_a_given_road_is_that_of_every_car_for_one_episode() -> None:
    road = Road([0.0, 0.02, 0.03, 0.0, -0.02, 0.0])
    ours, singles = pair(AutoresetMode.SAME_STEP, None)

    def both(name: str, *args: Any, **options: Any) -> Any:
        results = getattr(ours, name)(*args, **options), getattr(singles, name)(*args, **options)
        for first, second in zip(*results, strict=True):
            assert alike(first, second), (first, second)
        return results[0]

    both("reset", seed=3)
    both("reset", seed=5, options={"road": road, "unknown": 1})
    assert [ours.road(k) for k in range(CARS)] == [road] * CARS
    for _ in range(40):
        actions = np.full((CARS, 2), 0.1, np.float32)
        if both("step", actions)[2].any():
            break
    assert ours.road(0) is not road
    with pytest.raises(FreneticError, match=r"options\['road'\] is 3: a frenetic.Road is needed"):
        ours.reset(options={"road": 3})


def test_gymnasium_makes_it() -> None:
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
    assert envs.step(still)[1].tolist() == [0.0, 0.0]  # the step that resets


def test_a_drive_of_a_car_and_a_longer_road() -> None:
    """Roads and drives grow beyond the room that there was for them."""
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
        ours, expected = envs.drive(k).trajectory, single.drive().trajectory
        assert len(ours) == 301
        assert np.array_equal(ours.to_rows(), expected.to_rows())


def test_seeds_for_each_car() -> None:
    first, second = (LaneKeepingVectorEnv(num_envs=2) for _ in range(2))
    first.reset(seed=7)
    second.reset(seed=[7, 8])
    for k in range(2):
        ours, expected = first.road(k), second.road(k)
        assert ours is not None
        assert expected is not None
        assert np.array_equal(ours.curvatures, expected.curvatures)


def test_what_it_refuses() -> None:
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
