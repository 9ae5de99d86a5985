"""Steps per second of Gymnasium environments: ours beside MetaDrive's and HighwayEnv's.

    pip install -e ".[benchmarks,gym,metadrive]"
    python benchmarks/gymnasium_steps.py [--steps 20000] [--rounds 3] [--cars 16 256]

Each package has an environment for lane keeping without pictures or traffic:

frenetic     `frenetic/LaneKeeping-v0`: random roads of about 200 m, a vector of 26 numbers
metadrive    `MetaDriveEnv` without traffic and lidar: 100 generated maps, a vector
highway-env  `lane-keeping-v0`: a winding lane, state and reference as vectors, steering only

All environments get the same actions: a little random steering and some throttle. Episodes that end
are reset, and resets count. A step's simulated time differs, so the table gives both steps and
simulated seconds per second of CPU time. ``cars`` is the number of cars that step together: our
cars in one compiled call (`gymnasium.make_vec`), HighwayEnv's one by one in Gymnasium's
`SyncVectorEnv`. MetaDrive's engine can exist only once in a process, so several MetaDrive cars need
`AsyncVectorEnv`, with a process for each car: each costs at least the CPU time of a single car.

Each measurement runs in a process of its own, in turns. The table shows the best round. The last
column divides the steps of our environment, with as many cars, by the steps of the row.
"""

from __future__ import annotations

import argparse
import json
import logging
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, Final, NamedTuple

import gymnasium
import numpy as np


class Peer(NamedTuple):
    """An environment of a package."""

    package: str
    """Name of the package on PyPI."""
    step: float
    """Simulated time of a step, in s."""
    divisor: int
    """Divisor of the number of measured steps: slower environments take fewer steps."""
    make: Callable[[], gymnasium.Env[Any, Any]]
    """Return the environment with one car."""
    make_vec: Callable[[int], gymnasium.vector.VectorEnv[Any, Any, Any]] | None
    """Return the environment with several cars; None if there is none."""


def make_ours() -> gymnasium.Env[Any, Any]:
    from frenetic.simulators.embedded import compile_kernels

    compile_kernels()
    return gymnasium.make("frenetic.plugins.gym:frenetic/LaneKeeping-v0")


def make_ours_together(cars: int) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    return gymnasium.make_vec("frenetic.plugins.gym:frenetic/LaneKeeping-v0", num_envs=cars)


def make_metadrive() -> gymnasium.Env[Any, Any]:
    from metadrive import MetaDriveEnv  # here: the processes of the other packages do not need it
    from metadrive.engine.base_engine import BaseEngine

    # Without pictures MetaDrive does not need the assets that it would download.
    BaseEngine.try_pull_asset = staticmethod(lambda: None)
    env: gymnasium.Env[Any, Any] = MetaDriveEnv(
        {
            "use_render": False,
            "traffic_density": 0.0,
            "num_scenarios": 100,
            "log_level": logging.ERROR,
            "vehicle_config": {"lidar": {"num_lasers": 0, "distance": 0.0}},
        }
    )
    return env


def make_highway() -> gymnasium.Env[Any, Any]:
    import highway_env  # here: the processes of the other packages do not need it

    gymnasium.register_envs(highway_env)
    return gymnasium.make("lane-keeping-v0")


def make_highway_together(cars: int) -> gymnasium.vector.VectorEnv[Any, Any, Any]:
    return gymnasium.vector.SyncVectorEnv([make_highway] * cars)


PEERS: Final = {
    "frenetic": Peer("frenetic-roads", 0.05, 1, make_ours, make_ours_together),
    "metadrive": Peer("metadrive-simulator", 0.1, 20, make_metadrive, None),
    "highway-env": Peer("highway-env", 0.1, 10, make_highway, make_highway_together),
}


def actions_of(shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """Return actions for a thousand steps: a little steering, and throttle if there is a pedal."""
    rng = np.random.default_rng(1)
    actions = rng.normal(0.0, 0.05, (1000, *shape)).astype(np.float32)
    if shape[-1] == 2:
        actions[..., 1] = 0.3
    return actions


def measure(name: str, cars: int, steps: int) -> float:
    """Return the steps of all cars per s of CPU time."""
    peer = PEERS[name]
    if cars == 1:
        env = peer.make()
        actions = actions_of(env.action_space.shape or ())
        env.reset(seed=1)
        env.step(actions[0])  # loads
        env.reset()
        begin = time.process_time()
        for i in range(steps):
            _, _, terminated, truncated, _ = env.step(actions[i % len(actions)])
            if terminated or truncated:
                env.reset()
        return steps / (time.process_time() - begin)
    assert peer.make_vec is not None
    envs = peer.make_vec(cars)
    actions = actions_of(envs.action_space.shape or ())
    envs.reset(seed=1)
    envs.step(actions[0])
    rounds = max(steps // cars, 1)
    begin = time.process_time()
    for i in range(rounds):
        envs.step(actions[i % len(actions)])
    return rounds * cars / (time.process_time() - begin)


def measure_in_process(name: str, cars: int, steps: int) -> float:
    """Run `measure` in a process of its own."""
    command = [sys.executable, __file__, "--measure", name, str(cars), str(steps)]
    completed = subprocess.run(command, capture_output=True, text=True, check=False)
    if completed.returncode:
        raise SystemExit(f"{name} with {cars} cars: {completed.stderr[-2000:]}")
    return float(json.loads(completed.stdout.splitlines()[-1]))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--steps", type=int, default=20_000, help="of a measurement")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--cars", type=int, nargs="+", default=[16, 256], help="numbers of cars, beside 1"
    )
    parser.add_argument("--measure", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        name, cars, steps = options.measure
        print(json.dumps(measure(name, int(cars), int(steps))))
        return
    kinds = [
        (name, cars)
        for cars in (1, *options.cars)
        for name, peer in PEERS.items()
        if cars == 1 or peer.make_vec is not None
    ]
    best = dict.fromkeys(kinds, 0.0)
    for _ in range(options.rounds):
        for name, cars in kinds:
            steps = max(options.steps // PEERS[name].divisor, 100)
            best[name, cars] = max(best[name, cars], measure_in_process(name, cars, steps))
    print(f"{'environment':<22}{'cars':>5}{'steps/s':>10}{'simulated s/s':>15}{'ratio':>9}")
    for (name, cars), rate in best.items():
        label = f"{name} {version(PEERS[name].package)}"
        simulated = rate * PEERS[name].step
        ratio = "" if name == "frenetic" else f"{best['frenetic', cars] / rate:.1f} x"
        print(f"{label:<22}{cars:>5}{rate:>10,.0f}{simulated:>15,.0f}{ratio:>9}")


if __name__ == "__main__":
    main()
