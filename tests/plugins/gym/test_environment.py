"""The Gymnasium environment."""

from __future__ import annotations

import importlib
import itertools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from gymnasium.utils.env_checker import check_env

from frenetic import Budget, Campaign, EmbeddedSimulator, Planner, RandomSearch, Road, Rules, judge
from frenetic.drivers import Camera, LimitedView
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import assess
from frenetic.plugins.gym import FAILURE, LaneKeepingEnv
from frenetic.plugins.vision.policy import STEERING_RANGE, PolicyDriver

Vector = npt.NDArray[np.float32]

ROADS = [
    Road([0.0, 0.02, 0.05, 0.05, 0.0, -0.04, -0.06, -0.02, 0.0]),
    Road([0.0, -0.03, 0.01, 0.04, -0.05, 0.0, 0.0, 0.02], lane_width=3.5),
    Road([0.0, 0.05, 0.07, 0.07, 0.07, -0.07, -0.07, 0.0]),
    Road(
        [0.0, -0.03, 0.01, 0.02, -0.02, 0.0],
        grade=[(0, -0.1), (50, 0.1)],
        superelevation=0.05,
        widening=[(9, 0), (30, 1)],
    ),
]
CAMERA = Camera(width=12, height=6)


def always(action: Any) -> Callable[[Any], Any]:
    """Return a policy that gives this action for each vector."""
    return lambda _: action


def keeps_lane(speed: float) -> Callable[[Vector], Vector]:
    """Return a policy that keeps its lane by curvature, offset and heading, at a speed in m/s."""

    def policy(vector: Vector) -> Vector:
        angle = 2.6 * 0.1 * vector[6:9].mean() - 0.4 * vector[4] - 0.4 * vector[5]
        return np.array([angle / STEERING_RANGE, 0.5 * (speed - 40.0 * vector[0])], np.float32)

    return policy


def episode(env: gymnasium.Env[Any, Any], policy: Callable[[Vector], Any]) -> tuple[Any, ...]:
    """Run an episode; return its rewards and the last step's values."""
    vector, _ = env.reset()
    rewards: list[float] = []
    while True:
        last = env.step(policy(vector))
        vector, reward, terminated, truncated, _ = last
        rewards.append(float(reward))
        if terminated or truncated:
            return rewards, *last


@pytest.mark.heavy
def test_gymnasiums_checker_accepts_the_environment() -> None:
    check_env(gymnasium.make("frenetic/LaneKeeping-v0", camera=CAMERA).unwrapped)


@pytest.mark.parametrize(
    ("speed", "options"),
    [
        (8.0, {}),
        (14.0, {"friction": 0.8}),
        (11.0, {"start_offset": 0.5, "vehicle": "metadrive"}),
        (12.0, {"start_speed": 30.0}),
    ],
)
def test_an_episode_equals_the_drive_of_the_same_policy(
    speed: float, options: dict[str, Any]
) -> None:
    for road in ROADS:
        env = LaneKeepingEnv(roads=[road], **options)
        _, _, _, terminated, truncated, info = episode(env, keeps_lane(speed))
        drive = EmbeddedSimulator(**options).drive(road, PolicyDriver(keeps_lane(speed)))
        assert np.array_equal(env.drive().trajectory.to_rows(), drive.trajectory.to_rows())
        result = judge(road, drive)
        assert (terminated, truncated) == (True, False)
        assert info["outcome"] == str(result.outcome)
        assert info["moobd"] == result.moobd


def test_the_vector_holds_the_drivers_observation() -> None:
    vectors: list[Vector] = []

    class Watched(PolicyDriver):
        def act(self, observation):  # type: ignore[no-untyped-def]
            o = observation
            controls = super().act(o)
            vector = vectors[-1]
            assert vector[0] == np.float32(o.speed / 40.0)
            assert vector[1] == np.float32((70.0 / 3.6 - o.speed) / 40.0)
            assert vector[2] == np.float32(o.yaw_rate / 2.0)
            assert vector[3] == np.float32(o.steering / 0.5)
            assert vector[4] == np.float32(o.lateral_offset / 4.0)
            assert vector[5] == np.float32(o.heading_error / 0.5)
            curvatures = np.zeros(20)
            curvatures[: (len(o.curvature_ahead) + 1) // 2] = o.curvature_ahead[::2] / 0.1
            assert np.array_equal(vector[6:], curvatures.astype(np.float32))
            return controls

    def policy(vector: Vector) -> Vector:
        vectors.append(vector)
        return keeps_lane(8.0)(vector)

    for driver in (Watched(policy), LimitedView(Watched(policy), distance=21.0)):
        assert EmbeddedSimulator().drive(ROADS[0], driver).trouble is None
    assert all(abs(vector).max() <= 1.0 for vector in vectors)


def test_the_vector_stays_within_its_limits() -> None:
    env = LaneKeepingEnv(roads=[Road([0.3, -0.3, 0.3, 0.0])], rules=Rules(speed_limit=200.0))
    env.reset(seed=0)
    ended = False
    while not ended:
        vector, _, ended, _, _ = env.step(np.array([1.0, 1.0], np.float32))
        assert vector in env.observation_space


def test_the_image_equals_that_of_a_driver_with_the_same_camera() -> None:
    images: list[Any] = []

    class WithCamera(PolicyDriver):
        camera = CAMERA

        def act(self, observation):  # type: ignore[no-untyped-def]
            images.append(observation.image)
            return super().act(observation)

    EmbeddedSimulator().drive(ROADS[0], WithCamera(keeps_lane(8.0)))
    env = LaneKeepingEnv(roads=[ROADS[0]], camera=CAMERA)
    observation, _ = env.reset(seed=0)
    for image in images[:30]:
        assert isinstance(observation, dict)
        assert observation in env.observation_space
        assert np.array_equal(observation["image"], image)
        observation, *_ = env.step(keeps_lane(8.0)(observation["vector"]))


@pytest.mark.parametrize(("road", "speed"), [(ROADS[0], 8.0), (ROADS[2], 14.0)])
def test_the_reward_is_progress_minus_oob_share(road: Road, speed: float) -> None:
    env = LaneKeepingEnv(roads=[road])
    rewards, *_, info = episode(env, keeps_lane(speed))
    assert info["outcome"] == ("PASS" if speed == 8.0 else "FAIL")
    assessment = assess(road, env.drive())
    largest = assessment.oob_share.max()
    assert largest == 0.0 if speed == 8.0 else 0.95 < largest < 1.0
    expected = np.diff(assessment.distance) / (70.0 / 3.6 * 0.05) - assessment.oob_share[1:]
    expected[-1] -= FAILURE * (speed == 14.0)
    assert rewards == pytest.approx(expected.tolist(), abs=1e-12)
    assert info["distance"] == assessment.distance[-1]


def test_progress_beyond_the_speed_limit_earns_nothing() -> None:
    env = LaneKeepingEnv(roads=[Road([0.0] * 20)], rules=Rules(speed_limit=20.0))
    rewards, *_ = episode(env, lambda _: np.array([0.0, 1.0]))
    assert max(rewards) == 1.0
    assert env.drive().trajectory.speed.max() > 2.0 * 20.0 / 3.6


def test_a_stuck_car_terminates_and_a_slow_car_is_truncated() -> None:
    env = LaneKeepingEnv(roads=[ROADS[0]], rules=Rules(stuck_time=0.5))
    *_, terminated, truncated, info = episode(env, lambda _: np.zeros(2))
    assert (terminated, truncated, info["outcome"]) == (True, False, "FAIL")
    assert judge(ROADS[0], env.drive()).reason.startswith("Car moved less")

    env = LaneKeepingEnv(roads=[ROADS[0]], rules=Rules(timeout_base=1.0, timeout_speed=100.0))
    *_, terminated, truncated, info = episode(env, keeps_lane(8.0))
    assert (terminated, truncated, info["outcome"]) == (False, True, "FAIL")
    assert judge(ROADS[0], env.drive()).reason.startswith("Car took longer")


def test_the_seed_decides_about_random_roads() -> None:
    env = LaneKeepingEnv()
    roads = []
    for seed in (3, 3, 4, None, None):
        env.reset(seed=seed)
        assert env.road is not None
        assert env.road.check_validity()
        roads.append(env.road.curvatures)
    assert np.array_equal(roads[0], roads[1])
    for curvatures, following in itertools.pairwise(roads[1:]):
        assert not np.array_equal(curvatures, following)


def test_roads_are_drawn_from_a_list_and_chosen_by_an_option(tmp_path: Path) -> None:
    file = tmp_path / "roads" / "mine.json"
    file.parent.mkdir()
    file.write_text(json.dumps({"curvatures": [0.0, 0.01, 0.02, 0.0]}), encoding="utf-8")
    lists: list[list[Road | Path | str]] = [[ROADS[0], str(file)], [file.parent, ROADS[0]]]
    for roads in lists:
        env = LaneKeepingEnv(roads=roads)
        env.reset(seed=1)
        lengths = set()
        for _ in range(20):
            env.reset()
            assert env.road is not None
            lengths.add(env.road.length)
        assert lengths == {30.0, 80.0}
    env.reset(options={"road": ROADS[1]})
    assert env.road is ROADS[1]
    with pytest.raises(FreneticError, match=r"a frenetic\.Road is needed"):
        env.reset(options={"road": "mine.json"})


def test_a_campaigns_failing_roads_are_drawn(tmp_path: Path) -> None:
    def campaign(name: str, driver: Planner) -> Path:
        folder = tmp_path / name
        Campaign(
            strategy=RandomSearch(seed=1),
            simulator=EmbeddedSimulator(),
            driver=driver,
            budget=Budget(simulations=4),
            folder=folder,
        ).run()
        return folder

    env = LaneKeepingEnv(roads=[campaign("wild", Planner(aggression=4.0))])
    env.reset(seed=1)
    assert env.road is not None
    drive = EmbeddedSimulator().drive(env.road, Planner(aggression=4.0))
    assert str(judge(env.road, drive).outcome) == "FAIL"
    with pytest.raises(FreneticError, match="no road failed"):
        LaneKeepingEnv(roads=[campaign("tame", Planner(aggression=0.2))])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"roads": "mine.json"}, "a list of roads is needed"),
        ({"roads": ["nowhere.json"]}, "there is no file nowhere.json"),
        ({"camera": {"width": 20}}, "camera"),
    ],
)
def test_invalid_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises((FreneticError, ValueError), match=message):
        LaneKeepingEnv(**options)


def test_invalid_steps_are_refused() -> None:
    env = LaneKeepingEnv(roads=[ROADS[0]], rules=Rules(stuck_time=0.1))
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2, np.float32))
    env.reset(seed=0)
    with pytest.raises(ValueError, match="not finite"):
        env.step(np.array([0.0, np.nan], np.float32))
    with pytest.raises(ValueError, match="shape"):
        env.step(np.zeros(3, np.float32))
    unusable_actions: list[Any] = [[0.0, float("nan")], [0.0, [1.0, 2.0]], "left"]
    for action in unusable_actions:
        drive = EmbeddedSimulator().drive(ROADS[0], PolicyDriver(always(action)))
        assert "two finite numbers" in str(drive.trouble)
    while not env.step(np.zeros(2, np.float32))[2]:
        pass
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros(2, np.float32))


def test_an_error_names_the_missing_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gymnasium", None)
    monkeypatch.delitem(sys.modules, "frenetic.plugins.gym")
    with pytest.raises(FreneticError, match=r'pip install "\.\[gym\]"'):
        importlib.import_module("frenetic.plugins.gym")
