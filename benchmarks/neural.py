"""Cost of a step of a drive with the driver `dave2`: physics, image and network.

    python benchmarks/neural.py [--roads 20] [--seed 1] [--max-speed KMH]

The benchmark drives random roads of the 200 m map, as the search `random` proposes them, on one
core. The cost of a step is the time from one call of the driver to the next, 0.05 s of simulated
time: the median over all steps of all drives. The cost of the image is the step's cost, less the
cost of the network and of a step of the same drive without a camera. Drives per second are per
second of processor time.
"""

from __future__ import annotations

import argparse
import time
from itertools import islice, pairwise
from statistics import median

import numpy as np

from frenetic import Controls, DriveSetup, EmbeddedSimulator, Observation
from frenetic.plugins.vision.neural import Dave2
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators.embedded import compile_kernels


class TimedDriver:
    """A driver around `Dave2` that records when it is called and when it answers."""

    def __init__(self, driver: Dave2) -> None:
        self.driver = driver
        self.camera = driver.camera
        self.calls: list[float] = []
        self.answers: list[float] = []
        self.controls: list[Controls] = []

    def reset(self, setup: DriveSetup) -> None:
        """Prepare for the next drive."""
        self.driver.reset(setup)
        self.calls, self.answers, self.controls = [], [], []

    def act(self, observation: Observation) -> Controls:
        """Return the controls of the driver inside."""
        self.calls.append(time.perf_counter())
        self.controls.append(self.driver.act(observation))
        self.answers.append(time.perf_counter())
        return self.controls[-1]


class RepeatingDriver:
    """A driver without a camera that repeats recorded controls, and records when it is called."""

    def __init__(self, controls: list[Controls]) -> None:
        self._controls = controls
        self.calls: list[float] = []

    def reset(self, _: DriveSetup) -> None:
        """Prepare for the next drive."""
        self.calls = []

    def act(self, _: Observation) -> Controls:
        """Return the next recorded controls."""
        self.calls.append(time.perf_counter())
        return self._controls[len(self.calls) - 1]


def gaps(calls: list[float]) -> list[float]:
    """Return the times from each call to the next, in ms."""
    return [1e3 * (later - call) for call, later in pairwise(calls)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--roads", type=int, default=20, help="number of roads")
    parser.add_argument("--seed", type=int, default=1, help="seed of the roads")
    parser.add_argument("--max-speed", type=float, metavar="KMH", help="option of the driver")
    options = parser.parse_args()
    network = Dave2() if options.max_speed is None else Dave2(max_speed=options.max_speed)
    timed, simulator = TimedDriver(network), EmbeddedSimulator()
    roads = list(islice(RandomRoads().valid(np.random.default_rng(options.seed)), options.roads))
    compile_kernels()
    simulator.drive(roads[0], timed)
    steps: list[float] = []
    inference: list[float] = []
    physics: list[float] = []
    seconds = 0.0
    for road in roads:
        start = time.process_time()
        drive = simulator.drive(road, timed)
        seconds += time.process_time() - start
        assert drive.trouble is None, drive.trouble
        steps += gaps(timed.calls)
        pairs = zip(timed.calls, timed.answers, strict=True)
        inference += [1e3 * (answer - call) for call, answer in pairs]
        repeating = RepeatingDriver(timed.controls)
        simulator.drive(road, repeating)
        physics += gaps(repeating.calls)
    whole, network_ms, physics_ms = median(steps), median(inference), median(physics)
    camera = network.camera
    print(f"image of {camera.width} x {camera.height} pixels, {len(steps)} steps, medians in ms")
    for name, value in (
        ("physics and observation", physics_ms),
        ("image", whole - network_ms - physics_ms),
        ("network", network_ms),
        ("whole step", whole),
    ):
        print(f"{name:24} {value:6.3f}")
    print(f"{len(roads) / seconds:.1f} drives per second")


if __name__ == "__main__":
    main()
