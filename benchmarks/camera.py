"""Cost of a camera's picture, and of each condition that changes the picture.

    python benchmarks/camera.py

The figures are processor time in ms, the least of several rounds, because other programs disturb
it. For comparison, the default driver drives along the same road without a camera.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from frenetic import EmbeddedSimulator, Observation, Planner, Road
from frenetic.drivers.camera import Scene
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.plugins.vision.rendering import CameraRenderer

ROAD = Road([0.0, 0.0, 0.03, 0.04, 0.0, -0.04, -0.05, -0.03, 0.0, 0.03, 0.05, 0.05, 0.0, 0.0])
PICTURES = 40
"""Number of pictures along the road."""
ROUNDS = 8
AMOUNTS = {"fog": 50.0, "rain": 10.0, "blur": 0.03, "light": 0.6, "grain": 10.0}
"""Condition -> its amount, in the unit of `frenetic run --with`."""


def least(work: Callable[[], object], times: int) -> float:
    """Return the processor time of a call in ms, in the fastest round."""
    work()  # compiles
    seconds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        for _ in range(times):
            work()
        seconds.append((time.process_time() - start) / times)
    return 1e3 * min(seconds)


def main() -> None:
    """Measure, and print the costs."""
    driver = MarkingFollower()
    poses = [ROAD.pose_at(s) for s in np.linspace(0.0, ROAD.length - 10.0, PICTURES)]

    def drawing(renderer: CameraRenderer) -> Callable[[], object]:
        return lambda: [renderer.draw(*pose) for pose in poses]

    with EmbeddedSimulator() as simulator:
        drive = least(lambda: simulator.drive(ROAD, Planner()), 5)
    print(f"a drive of {ROAD.length:.0f} m without a camera  {drive:.3f} ms")
    camera = driver.camera
    print(f"\na picture of {camera.width} x {camera.height} pixels")
    for name, scene in (("usual", Scene()), ("worn", Scene(seed=3, wear=0.5))):
        cost = least(drawing(CameraRenderer(ROAD, camera, scene)), 1) / PICTURES
        print(f"  {name:<12} {cost:.3f} ms")
    table = least(lambda: CameraRenderer(ROAD, camera), 5)
    print(f"\nthe table of the road's geometry for a drive  {table:.3f} ms")
    print("\na condition that changes the picture")
    image = CameraRenderer(ROAD, camera).draw(*poses[5])
    no_points = np.empty((0, 2))
    moment = Observation(1.0, 15.0, 0.3, 0.0, 0.0, 0.0, no_points, np.empty(0), 0.0, image)
    for name, amount in AMOUNTS.items():
        wrapper = appearance.ALL[name](driver, amount)
        cost = least(lambda wrapper=wrapper: wrapper.alter(image, moment), 10)  # type: ignore[misc]
        print(f"  {name:<12} {cost:.3f} ms")
    with EmbeddedSimulator() as simulator:
        steps = len(simulator.drive(ROAD, driver).trajectory)
        cost = least(lambda: simulator.drive(ROAD, driver), 1)
    print(f"\na step of marking-follower with its picture  {cost / steps:.3f} ms")


if __name__ == "__main__":
    main()
