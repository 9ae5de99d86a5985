"""The embedded simulator's camera, against an independent projection of known points."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from frenetic.drivers import Camera, Controls, Driver, DriveSetup, Noisy, Observation, Planner
from frenetic.drivers.driver import CameraDriver
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator

BENDS = Road([0.0, 0.0, 0.03, 0.04, 0.0, -0.04, -0.05, -0.03, 0.0, 0.03, 0.05, 0.05, 0.0, 0.0])


@dataclass
class Watching:
    """Drives as the planner does and keeps what it sees."""

    camera: Camera
    driver: Driver = field(default_factory=Planner)
    images: list[np.ndarray | None] = field(default_factory=list)

    def reset(self, setup: DriveSetup) -> None:
        self.images.clear()
        self.driver.reset(setup)

    def act(self, observation: Observation) -> Controls:
        self.images.append(observation.image)
        return self.driver.act(observation)


def test_a_driver_with_a_camera_sees_the_same_pictures_in_every_drive() -> None:
    driver = Watching(Camera(width=64, height=32))
    assert isinstance(driver, CameraDriver)
    with EmbeddedSimulator() as simulator:
        simulator.drive(BENDS, driver)
        first = list(driver.images)
        simulator.drive(BENDS, Noisy(driver, offset=0.0, heading=0.0))
        second = list(driver.images)
    assert len(first) > 50
    for one, other in zip(first, second, strict=True):
        assert one is not None
        assert other is not None
        assert one.shape == (32, 64, 3)
        assert one.dtype == np.uint8
        np.testing.assert_array_equal(one, other)
    assert not np.array_equal(first[0], first[-1])  # type: ignore[arg-type]


def test_a_driver_without_a_camera_gets_no_picture_and_drives_as_with_one() -> None:
    class Blind:
        def __init__(self) -> None:
            self.driver = Planner()
            self.images: list[Any] = []

        def reset(self, setup: DriveSetup) -> None:
            self.driver.reset(setup)

        def act(self, observation: Observation) -> Controls:
            self.images.append(observation.image)
            return self.driver.act(observation)

    blind = Blind()
    with EmbeddedSimulator() as simulator:
        one = simulator.drive(BENDS, blind)
        other = simulator.drive(BENDS, Watching(Camera(width=8, height=8)))
    assert set(map(type, blind.images)) == {type(None)}
    np.testing.assert_array_equal(one.trajectory.to_rows(), other.trajectory.to_rows())
