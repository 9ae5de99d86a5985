"""Trains a driver, lets a search break it, trains on what broke it, and says what that brought.

    python3 -m venv train && train/bin/pip install -r training/requirements.txt
    train/bin/python training/lane_keeping.py [--seeds 1 2 3] [--out policies]

For each seed, PPO of Stable-Baselines3 trains a policy on random roads in
`frenetic/LaneKeeping-v0`. It is exported as a driver in an ONNX file, and the strategy `frenetic`
searches for its failing roads. Then training goes on twice from there, for as many steps:

more       on random roads only: what more training alone brings
retrained  half of the cars on the roads that failed, the others on random roads

All three drive the same fresh random roads, and fresh searches, on seeds of their own, look for
failures of each. The columns:

fails      failures per 100 fresh random roads
distinct   distinct failures that a fresh search finds, mean of the searches
failures   all failures that it finds, likewise
km/h       mean speed on the fresh random roads, the start included

The last column tells a driver that is better from one that is only slower. The same seeds give the
same figures on the same machine with the same versions.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from frenetic import Budget, Campaign, EmbeddedSimulator, Frenetic, Road
from frenetic.analysis import measure_campaign
from frenetic.plugins.gym import LaneKeepingVectorEnv
from frenetic.plugins.gym.environment import roads_of
from frenetic.plugins.vision.neural import METADATA, Network
from frenetic.plugins.vision.policy import VECTOR_SIZE

CARS: Final = 64
ROLLOUT: Final = 256
"""Steps of each car between two updates of the policy."""
HIDDEN: Final = 64
"""Neurons in each of the two hidden layers."""
RATE: Final = 1e-3
"""Learning rate at the start."""
REWARD_SCALE: Final = 0.05
"""Rewards are multiplied by it, so that the values to be learnt are about 1."""
SEARCHES: Final = 2
"""Campaigns that search for roads to train on, and as many fresh ones that count."""
FRESH: Final = 1_000_000
"""Times the seed: the seed of fresh roads and searches, which training never saw."""


class Figures(NamedTuple):
    """What is measured of a policy; the columns of the table."""

    fails: float
    distinct: float
    failures: float
    speed: float
    """km/h."""


class Cars(VecEnv):
    """Environments of Gymnasium that step together, as Stable-Baselines3 takes them."""

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
        """The first observations."""
        seen = [group.reset(seed=self._seed + 1000 * i) for i, group in enumerate(self._groups)]
        return np.concatenate([vectors for vectors, _ in seen])

    def step_async(self, actions: npt.NDArray[np.float32]) -> None:
        """Takes the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Observations, rewards, whether episodes have ended, and how."""
        vectors, rewards, dones, infos = [], [], [], []
        for group, actions in zip(self._groups, np.split(self._actions, self._ends), strict=True):
            seen, reward, terminated, truncated, info = group.step(actions)
            done = terminated | truncated
            own: list[dict[str, Any]] = [{} for _ in done]
            for k in done.nonzero()[0]:
                own[k]["terminal_observation"] = info["final_obs"][k]
                own[k]["TimeLimit.truncated"] = bool(truncated[k])
            vectors.append(seen)
            rewards.append(REWARD_SCALE * reward)
            dones.append(done)
            infos += own
        return np.concatenate(vectors), np.concatenate(rewards), np.concatenate(dones), infos

    def close(self) -> None:
        """Ends nothing."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ARG002
        """The same attribute for all."""
        return [getattr(self._groups[0], attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, *_: Any, **__: Any) -> None:
        """Nothing can be set."""
        raise NotImplementedError(attr_name)

    def env_method(self, method_name: str, *_: Any, **__: Any) -> Any:
        """Nothing can be called."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, *_: Any, **__: Any) -> list[bool]:
        """None is."""
        return [False] * self.num_envs


def cars(seed: int, roads: Sequence[Road] | None = None) -> Cars:
    """Cars on random roads, half of them on the given ones if there are any."""
    shares = [(CARS, None)] if roads is None else [(CARS // 2, None), (CARS // 2, roads)]
    groups = [
        LaneKeepingVectorEnv(num_envs=count, autoreset_mode="SameStep", roads=own)
        for count, own in shares
    ]
    return Cars(groups, seed)


def new_model(seed: int) -> PPO:
    """An untrained model."""
    return PPO(
        "MlpPolicy",
        cars(seed),
        seed=seed,
        device="cpu",
        n_steps=ROLLOUT,
        batch_size=2048,
        n_epochs=5,
        gamma=0.98,
        gae_lambda=0.95,
        policy_kwargs={"net_arch": [HIDDEN, HIDDEN], "log_std_init": -1.0},
    )


def train(model: PPO, on: Cars, steps: int, rate: float) -> None:
    """Trains for some steps; the learning rate falls to a tenth."""
    model.lr_schedule = lambda left: rate * (0.1 + 0.9 * left)
    model.set_env(on)
    model.learn(steps)


def save(model: PPO, path: Path) -> None:
    """Writes the policy's mean action as a driver in an ONNX file."""
    policy = model.policy
    layers = [*policy.mlp_extractor.policy_net, policy.action_net]
    nodes, tensors, value = [], [], "vector"
    for i, layer in enumerate(layers):
        name = "action" if i == len(layers) - 1 else f"x{i}"
        inputs = [value]
        for kind, values in layer.state_dict().items():
            inputs.append(f"{kind}{i}")
            tensors.append(numpy_helper.from_array(values.numpy(), inputs[-1]))
        if isinstance(layer, nn.Linear):
            nodes.append(helper.make_node("Gemm", inputs, [name], transB=1))
        else:
            nodes.append(helper.make_node("Tanh", inputs, [name]))
        value = name
    graph = helper.make_graph(
        nodes,
        "lane_keeping",
        [helper.make_tensor_value_info("vector", TensorProto.FLOAT, [1, VECTOR_SIZE])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, [1, 2])],
        tensors,
    )
    exported = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    convention = {"inputs": "vector", "outputs": "steering-throttle", "steering": "action"}
    helper.set_model_props(exported, {METADATA: json.dumps(convention)})
    onnx.checker.check_model(exported)
    path.write_bytes(exported.SerializeToString(deterministic=True))


def fresh_roads(model: PPO, seed: int, roads: int) -> tuple[float, float]:
    """(failures per 100, mean km/h) of the policy on random roads, one for each of many cars."""
    envs = LaneKeepingVectorEnv(num_envs=roads)
    vectors, _ = envs.reset(seed=seed)
    is_driving = np.ones(roads, bool)
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
    return 100.0 * failures / roads, 3.6 * distance / (0.05 * steps)


def search(driver: Network, seed: int, simulations: int, folder: Path) -> Path:
    """A campaign that searches for failing roads of a driver."""
    Campaign(
        strategy=Frenetic(seed=seed),
        simulator=EmbeddedSimulator(),
        driver=driver,
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()
    return folder


def measure(model: PPO, path: Path, seed: int, roads: int, simulations: int) -> Figures:
    """The figures of a policy on fresh roads and in fresh searches."""
    fails, speed = fresh_roads(model, FRESH * seed, roads)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(SEARCHES):
            place = Path(folder) / str(i)
            search(Network(str(path)), FRESH * seed + i, simulations, place)
            found.append(measure_campaign(place))
    return Figures(
        fails,
        float(np.mean([one.distinct_failures for one in found])),
        float(np.mean([one.failures_after[-1] for one in found])),
        speed,
    )


def main() -> None:
    """Trains as the arguments say."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("policies"), help="Folder of ONNX files.")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--steps", type=int, default=1_500_000, help="Steps of the first training.")
    parser.add_argument("--more", type=int, default=750_000, help="Steps of each one after it.")
    parser.add_argument("--simulations", type=int, default=300, help="Of each search.")
    parser.add_argument("--roads", type=int, default=2000, help="Fresh random roads.")
    given = parser.parse_args()
    torch.set_num_threads(1)
    given.out.mkdir(parents=True, exist_ok=True)
    print(f"{'seed':>4}  {'policy':<10}{'fails':>7}{'distinct':>10}{'failures':>10}{'km/h':>7}")
    table: dict[str, list[Figures]] = {}

    def report(seed: int, name: str, model: PPO) -> Path:
        path = given.out / f"{name}-{seed}.onnx"
        save(model, path)
        figures = measure(model, path, seed, given.roads, given.simulations)
        table.setdefault(name, []).append(figures)
        show(str(seed), name, figures)
        return path

    begin = time.process_time()
    for seed in given.seeds:
        model = new_model(seed)
        train(model, cars(seed), given.steps, RATE)
        path = report(seed, "first", model)
        with tempfile.TemporaryDirectory() as folder:
            broken = [
                search(Network(str(path)), 100 * seed + i, given.simulations, Path(folder) / str(i))
                for i in range(SEARCHES)
            ]
            failing = roads_of(broken)
        print(f"      {len(failing)} failing roads to train on")
        trained = {name: value.clone() for name, value in model.policy.state_dict().items()}
        for name, roads in (("more", None), ("retrained", failing)):
            again = new_model(seed)
            again.policy.load_state_dict(trained)
            train(again, cars(seed + 500, roads), given.more, RATE / 2.0)
            report(seed, name, again)
    for name, figures in table.items():
        show("all", name, Figures(*(median(column) for column in zip(*figures, strict=True))))
    print(f"{time.process_time() - begin:.0f} s of CPU time")


def show(seed: str, name: str, figures: Figures) -> None:
    """Prints a row of the table."""
    fails, distinct, failures, speed = figures
    print(
        f"{seed:>4}  {name:<10}{fails:>7.2f}{distinct:>10.1f}{failures:>10.1f}{speed:>7.1f}",
        flush=True,
    )


if __name__ == "__main__":
    main()
