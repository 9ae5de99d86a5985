"""Train a driver, search for its failing roads, train on them, and print what that improves.

    python3 -m venv train && train/bin/pip install -r training/requirements.txt
    train/bin/python training/lane_keeping.py [--seeds 1 2 3] [--out policies]

For each seed, PPO of Stable-Baselines3 trains a policy on random roads in
`frenetic/LaneKeeping-v0`. This policy, `first`, is exported as a driver in an ONNX file, and the
strategy `frenetic` searches for its failing roads. From `first`, training continues in two ways,
with the same number of steps:

more       on random roads only, to show what more training alone improves
retrained  half of the cars on the failing roads, the others on random roads

All three policies drive the same fresh random roads, and fresh searches with other seeds look for
failures of each. A table has a row for each policy; its columns are

fails      failures per 100 fresh random roads
distinct   distinct failures that a fresh search finds, mean of the searches
failures   all failures that a fresh search finds, mean of the searches
km/h       mean speed on the fresh random roads, the start included

The speed shows whether a driver is better or only slower. The same seeds give the same figures on
the same machine with the same versions.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from onnx_export import Value, write_network
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from frenetic import Budget, Campaign, EmbeddedSimulator, Frenetic, Road
from frenetic.analysis import measure_campaign
from frenetic.plugins.gym import LaneKeepingVectorEnv
from frenetic.plugins.gym.environment import roads_of
from frenetic.plugins.vision.neural import Network
from frenetic.plugins.vision.policy import ACTION_SIZE, VECTOR_SIZE
from frenetic.simulators.embedded.rollout import PERIOD

# All numbers are our choice.
CARS: Final = 64
"""Number of cars that train at once."""
ROLLOUT_STEPS: Final = 256
"""Number of steps of each car between two updates of the policy."""
HIDDEN_SIZE: Final = 64
"""Number of neurons in each of the two hidden layers."""
LEARNING_RATE: Final = 1e-3
"""Learning rate at the start of the first training."""
FURTHER_RATE: Final = LEARNING_RATE / 2.0
"""Learning rate at the start of each further training."""
REWARD_SCALE: Final = 0.05
"""Factor of the rewards, so that the values to learn are about 1."""
SEARCHES: Final = 2
"""Number of searches for roads to train on, and of fresh searches for the figures."""
GROUP_SEED_DISTANCE: Final = 1000
"""Difference of the seeds of two groups of cars."""
FURTHER_SEED_DISTANCE: Final = 500
"""Difference of the seeds of a further training and of the first one."""
SEARCH_SEED_FACTOR: Final = 100
"""Factor that turns a seed into the seed of the first search for roads to train on."""
EXAM_SEED_FACTOR: Final = 1_000_000
"""Factor that turns a seed into the seed of fresh roads and searches, unknown to the training."""


class Figures(NamedTuple):
    """Figures of a policy, the columns of the table."""

    fails: float
    """Number of failures per 100 fresh random roads."""
    distinct: float
    """Number of distinct failures that a fresh search finds, mean of the searches."""
    failures: float
    """Number of failures that a fresh search finds, mean of the searches."""
    speed: float
    """Mean speed on the fresh random roads, in km/h."""


class Cars(VecEnv):
    """Groups of Gymnasium environments as one vectorised environment of Stable-Baselines3.

    Args:
        groups: the groups, each with roads of its own.
        seed: seed of the first group's roads.
    """

    def __init__(self, groups: Sequence[LaneKeepingVectorEnv], seed: int) -> None:
        self._groups, self._seed = groups, seed
        self._ends = np.cumsum([group.num_envs for group in groups])[:-1]
        first = groups[0]
        super().__init__(
            sum(group.num_envs for group in groups),
            first.single_observation_space,
            first.single_action_space,
        )

    def reset(self) -> npt.NDArray[np.float32]:
        """Return the first observations."""
        starts = [
            group.reset(seed=self._seed + GROUP_SEED_DISTANCE * i)
            for i, group in enumerate(self._groups)
        ]
        return np.concatenate([vectors for vectors, _ in starts])

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Return observations, rewards, whether episodes have ended, and details of their ends."""
        vectors, rewards, dones, infos = [], [], [], []
        for group, actions in zip(self._groups, np.split(self._actions, self._ends), strict=True):
            observations, reward, terminated, truncated, info = group.step(actions)
            done = terminated | truncated
            group_infos: list[dict[str, Any]] = [{} for _ in done]
            for k in done.nonzero()[0]:
                group_infos[k]["terminal_observation"] = info["final_obs"][k]
                group_infos[k]["TimeLimit.truncated"] = bool(truncated[k])
            vectors.append(observations)
            rewards.append(REWARD_SCALE * reward)
            dones.append(done)
            infos += group_infos
        return np.concatenate(vectors), np.concatenate(rewards), np.concatenate(dones), infos

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ARG002
        """Return the attribute of the first group, repeated for each car."""
        return [getattr(self._groups[0], attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, *_: Any, **__: Any) -> None:
        """Raise a `NotImplementedError`: no attribute can be set."""
        raise NotImplementedError(attr_name)

    def env_method(self, method_name: str, *_: Any, **__: Any) -> Any:
        """Raise a `NotImplementedError`: no method can be called."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, *_: Any, **__: Any) -> list[bool]:
        """Return False for each car: no car has a wrapper."""
        return [False] * self.num_envs


def cars(seed: int, roads: Sequence[Road] | None = None) -> Cars:
    """Return cars on random roads; with `roads`, half of the cars drive on these."""
    counts_and_roads = [(CARS, None)] if roads is None else [(CARS // 2, None), (CARS // 2, roads)]
    groups = [
        LaneKeepingVectorEnv(num_envs=count, autoreset_mode="SameStep", roads=group_roads)
        for count, group_roads in counts_and_roads
    ]
    return Cars(groups, seed)


def new_model(seed: int) -> PPO:
    """Return an untrained model."""
    return PPO(
        "MlpPolicy",
        cars(seed),
        seed=seed,
        device="cpu",
        n_steps=ROLLOUT_STEPS,
        batch_size=2048,
        n_epochs=5,
        gamma=0.98,
        gae_lambda=0.95,
        policy_kwargs={"net_arch": [HIDDEN_SIZE, HIDDEN_SIZE], "log_std_init": -1.0},
    )


def train(model: PPO, training_cars: Cars, steps: int, rate: float) -> None:
    """Train a model for some steps; the learning rate falls from `rate` to a tenth of it."""
    model.lr_schedule = lambda remaining: rate * (0.1 + 0.9 * remaining)
    model.set_env(training_cars)
    model.learn(steps)


def save(model: PPO, path: Path) -> None:
    """Write the policy's mean action as a driver in an ONNX file."""
    policy = model.policy
    write_network(
        [*policy.mlp_extractor.policy_net, policy.action_net],
        path,
        name="lane_keeping",
        takes=Value("vector", [1, VECTOR_SIZE]),
        gives=Value("action", [1, ACTION_SIZE]),
        entries={"inputs": "vector", "outputs": "steering-throttle", "steering": "action"},
    )


def drive_fresh_roads(model: PPO, seed: int, count: int) -> tuple[float, float]:
    """Return failures per 100 random roads and the mean speed in km/h of a policy.

    Args:
        model: model of the policy.
        seed: seed of the roads.
        count: number of roads; each has a car of its own.
    """
    envs = LaneKeepingVectorEnv(num_envs=count)
    vectors, _ = envs.reset(seed=seed)
    is_driving = np.ones(count, bool)
    failures = distance = steps = 0.0
    while is_driving.any():
        actions, _ = model.predict(vectors, deterministic=True)
        vectors, _, terminated, truncated, infos = envs.step(actions)
        ended = is_driving & (terminated | truncated)
        steps += is_driving.sum()
        is_driving &= ~ended
        for k in ended.nonzero()[0]:
            failures += infos["outcome"][k] == "FAIL"
            distance += infos["distance"][k]
    return 100.0 * failures / count, 3.6 * distance / (PERIOD * steps)


def search(driver: Network, seed: int, simulations: int, folder: Path) -> Path:
    """Search for failing roads of a driver; return the campaign's folder."""
    Campaign(
        strategy=Frenetic(seed=seed),
        simulator=EmbeddedSimulator(),
        driver=driver,
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()
    return folder


def measure(model: PPO, path: Path, seed: int, road_count: int, simulations: int) -> Figures:
    """Return the figures of a policy on fresh roads and in fresh searches.

    Args:
        model: model of the policy.
        path: the policy's file, see `save`.
        seed: seed of the policy's training.
        road_count: number of fresh roads.
        simulations: number of drives of each search.
    """
    fails, speed = drive_fresh_roads(model, EXAM_SEED_FACTOR * seed, road_count)
    measures = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(SEARCHES):
            exam_seed = EXAM_SEED_FACTOR * seed + i
            campaign = search(Network(str(path)), exam_seed, simulations, Path(folder) / str(i))
            measures.append(measure_campaign(campaign))
    return Figures(
        fails,
        float(np.mean([measures_of_search.distinct_failures for measures_of_search in measures])),
        float(np.mean([measures_of_search.failures_after[-1] for measures_of_search in measures])),
        speed,
    )


def parsed_arguments() -> argparse.Namespace:
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--out", type=Path, default=Path("policies"), help="Folder for the ONNX files."
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--steps", type=int, default=1_500_000, help="Steps of the first training.")
    parser.add_argument("--more", type=int, default=750_000, help="Steps of each further training.")
    parser.add_argument("--simulations", type=int, default=300, help="Drives of each search.")
    parser.add_argument("--roads", type=int, default=2000, help="Fresh random roads.")
    return parser.parse_args()


def failing_roads_of(path: Path, seed: int, simulations: int) -> Sequence[Road]:
    """Search for failing roads of a policy and return them.

    Args:
        path: the policy's file.
        seed: seed of the policy's training.
        simulations: number of drives of each search.
    """
    with tempfile.TemporaryDirectory() as folder:
        campaigns = [
            search(
                Network(str(path)),
                SEARCH_SEED_FACTOR * seed + i,
                simulations,
                Path(folder) / str(i),
            )
            for i in range(SEARCHES)
        ]
        return roads_of(campaigns)


def main() -> None:
    """Train and measure as the arguments say."""
    options = parsed_arguments()
    torch.set_num_threads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"{'seed':>4}  {'policy':<10}{'fails':>7}{'distinct':>10}{'failures':>10}{'km/h':>7}")
    table: dict[str, list[Figures]] = {}  # policy -> its figures for each seed

    def save_and_measure(seed: int, name: str, model: PPO) -> Path:
        """Write the policy's file, add a row to the table and return the file."""
        path: Path = options.out / f"{name}-{seed}.onnx"
        save(model, path)
        figures = measure(model, path, seed, options.roads, options.simulations)
        table.setdefault(name, []).append(figures)
        print_row(str(seed), name, figures)
        return path

    start = time.process_time()
    for seed in options.seeds:
        model = new_model(seed)
        train(model, cars(seed), options.steps, LEARNING_RATE)
        path = save_and_measure(seed, "first", model)
        failing_roads = failing_roads_of(path, seed, options.simulations)
        print(f"      {len(failing_roads)} failing roads to train on")
        weights = {name: value.clone() for name, value in model.policy.state_dict().items()}
        for name, roads in (("more", None), ("retrained", failing_roads)):
            further = new_model(seed)
            further.policy.load_state_dict(weights)
            further_cars = cars(seed + FURTHER_SEED_DISTANCE, roads)
            train(further, further_cars, options.more, FURTHER_RATE)
            save_and_measure(seed, name, further)
    for name, figures in table.items():
        medians = Figures(*(median(column) for column in zip(*figures, strict=True)))
        print_row("all", name, medians)
    print(f"{time.process_time() - start:.0f} s of CPU time")


def print_row(seed: str, name: str, figures: Figures) -> None:
    """Print a row of the table."""
    fails, distinct, failures, speed = figures
    print(
        f"{seed:>4}  {name:<10}{fails:>7.2f}{distinct:>10.1f}{failures:>10.1f}{speed:>7.1f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
