"""The embedded simulator's camera, against an independent projection of known points."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pytest

from frenetic.drivers import (
    Camera,
    Controls,
    Driver,
    DriveSetup,
    Noisy,
    Observation,
    Planner,
)
from frenetic.drivers.camera import Scene
from frenetic.drivers.loading import load_driver
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.rendering import CameraRenderer
from frenetic.road import Pose, Road
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.conditions import in_conditions
from frenetic.spec.part_record import describe

SHORT = Road([0.0, 0.0, 0.03, 0.03])
BENDS = Road([0.0, 0.0, 0.03, 0.04, 0.0, -0.04, -0.05, -0.03, 0.0, 0.03, 0.05, 0.05, 0.0, 0.0])


@dataclass
class Watching:
    """Drives like the planner and stores the images that it sees."""

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
    with EmbeddedSimulator() as simulator:
        simulator.drive(BENDS, driver)
        first = list(driver.images)
        simulator.drive(BENDS, Noisy(driver, offset=0.0, heading=0.0))
        second = list(driver.images)
    assert len(first) > 50
    for image, repeated in zip(first, second, strict=True):
        assert image is not None
        assert repeated is not None
        assert image.shape == (32, 64, 3)
        assert image.dtype == np.uint8
        np.testing.assert_array_equal(image, repeated)
    assert not np.array_equal(first[0], first[-1])  # type: ignore[arg-type]


# Against another projection of known points


def pixel_of(camera: Camera, place: Pose, point: tuple[float, float]) -> tuple[float, float]:
    """Return row and column at which a car's camera sees a point on the ground, by matrices."""
    c, s = np.cos(place.heading), np.sin(place.heading)
    world = np.array([point[0] - place.x, point[1] - place.y, 0.0])
    in_car = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ world
    from_lens = in_car - [camera.forward, camera.left, camera.up]
    a = np.radians(camera.pitch)
    right, down, deep = (
        np.array(
            [
                [0.0, -1.0, 0.0],
                [-np.sin(a), 0.0, -np.cos(a)],
                [np.cos(a), 0.0, -np.sin(a)],
            ]
        )
        @ from_lens
    )
    x, y = right / deep, down / deep
    bent = 1.0 + camera.distortion * (x * x + y * y)
    focal = camera.width / 2.0 / np.tan(np.radians(camera.field_of_view) / 2.0)
    return (
        camera.height / 2.0 + focal * y * bent - 0.5,
        camera.width / 2.0 + focal * x * bent - 0.5,
    )


CAMERAS = (
    Camera(width=640, height=400, field_of_view=70.0, left=0.3, up=1.1, pitch=4.0),
    Camera(width=640, height=320, field_of_view=80.0, distortion=0.15),
)


@pytest.mark.parametrize("camera", CAMERAS, ids=str)
def test_markings_are_drawn_where_another_projection_puts_them(camera: Camera) -> None:
    x, y = at(BENDS, 15.0, -2.0)
    place = Pose(x, y, BENDS.pose_at(15.0).heading)
    image = CameraRenderer(BENDS, camera).draw(*place).astype(float)
    visible = 0
    for left, beside in ((-3.8, -3.0), (3.8, 3.0), (0.0, 1.0)):
        for ahead in (6.0, 8.0, 11.0, 14.0):
            s = 15.0 + ahead
            if left == 0.0:  # the middle of a dash
                s = 12.0 * round(s / 12.0) + 2.0
            on, off = (pixel_of(camera, place, at(BENDS, s, d)) for d in (left, beside))
            if not all(
                1.0 <= row < camera.height - 2 and 1.0 <= column < camera.width - 2
                for row, column in (on, off)
            ):
                continue
            visible += 1
            assert image[round(on[0]), round(on[1])].min() > 140.0, (left, ahead)
            assert image[round(off[0]), round(off[1])].max() < 110.0, (left, ahead)
    assert visible >= 5


def at(road: Road, distance: float, left: float) -> tuple[float, float]:
    """Return a point beside the road's centre line, at a distance to the left in m."""
    pose = road.pose_at(distance)
    return pose.x - left * np.sin(pose.heading), pose.y + left * np.cos(pose.heading)


def test_the_edge_of_a_line_lies_within_a_tenth_of_a_pixel() -> None:
    """The centre of brightness along a row lies in the middle of the line."""
    camera = Camera(width=320, height=160, pitch=0.0)
    straight = Road([0.0] * 12)
    place = Pose(0.0, 0.0, straight.pose.heading)
    image = CameraRenderer(straight, camera).draw(*place).astype(float)[..., 0]
    bare = CameraRenderer(straight, camera, Scene(wear=1.0)).draw(*place).astype(float)[..., 0]
    for row in range(90, 121, 6):
        ahead = camera.up * camera.focal_length / (row + 0.5 - 80.0)
        _, expected = pixel_of(camera, place, at(straight, ahead + camera.forward, -3.8))
        paint = (image - bare)[row, 170:]
        centre = float((paint * np.arange(170, 320)).sum() / paint.sum())
        assert centre == pytest.approx(expected, abs=0.1)


def test_a_road_that_comes_back_is_drawn_twice() -> None:
    """Both legs of a hairpin are in the picture."""
    hairpin = Road([0.0] * 5 + [0.05, 0.0628, 0.0628, 0.0628, 0.05] + [0.0] * 5)
    camera = Camera(width=320, height=160)
    heading = hairpin.pose.heading + 0.6
    image = CameraRenderer(hairpin, camera).draw(*at(hairpin, 20.0, 0.0), heading)
    place = Pose(*at(hairpin, 20.0, 0.0), heading)
    x, y = at(hairpin, 20.0, 0.0)
    back = min(
        hairpin.distances(0.25)[300:],
        key=lambda s: abs(np.hypot(*np.subtract(at(hairpin, s, 0.0), (x, y))) - 36.0),
    )
    row, column = pixel_of(camera, place, at(hairpin, back, 1.5))
    assert 0 <= row < 160
    assert 0 <= column < 320
    r, g, b = image[round(row), round(column)].astype(int)
    assert max(r, g, b) - min(r, g, b) < 15  # grey asphalt, no grass


def test_a_long_road_and_a_wide_lane_can_be_drawn() -> None:
    road = Road([0.0, 0.0005] * 500, lane_width=30.0)
    image = CameraRenderer(road, Camera(width=16, height=8)).draw(*at(road, 5000.0, -15.0), 1.0)
    assert image.shape == (8, 16, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width": 0}, "the camera's width is 0: a whole number >= 2 is needed"),
        ({"up": float("nan")}, "up is nan"),
        ({"width": 2000, "height": 2000}, "2000 x 2000 pixels: at most"),
        ({"distortion": -0.5}, "distortion is -0.5: with this field of view its corners"),
    ],
)
def test_invalid_options_of_a_camera_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Camera(**options)


def test_a_driver_whose_camera_is_no_camera_is_at_fault() -> None:
    driver: Any = Watching("a webcam")  # type: ignore[arg-type]
    with EmbeddedSimulator() as simulator:
        drive = simulator.drive(BENDS, driver)
    assert drive.trouble is not None
    assert drive.trouble.reason == "the driver's camera is 'a webcam': a frenetic.Camera is needed"


# Wrappers


def test_each_wrapper_changes_the_picture_and_repeats() -> None:
    def pictures(**amounts: float) -> list[Any]:
        driver = Watching(Camera(width=64, height=32))
        wrapped: Driver = driver
        for name, amount in amounts.items():
            wrapped = appearance.ALL[name].over(wrapped, amount)
        with EmbeddedSimulator() as simulator:
            simulator.drive(SHORT, wrapped)
        return list(driver.images)

    plain = np.array(pictures())
    amounts = {"scene": 3, "wear": 0.7, "fog": 30, "rain": 20, "blur": 0.1, "light": 0.5}
    amounts["grain"] = 10
    for name, amount in amounts.items():
        changed = np.array(pictures(**{name: amount}))
        assert changed.dtype == np.uint8
        np.testing.assert_array_equal(changed, np.array(pictures(**{name: amount})))
        assert not np.array_equal(changed, plain), name
    assert np.array(pictures(light=0.5)).mean() < 0.8 * plain.mean()
    assert np.array(pictures(fog=10.0))[:, :8, :, 0].std() < 1.0  # the sky is gone
    np.testing.assert_array_equal(np.array(pictures(light=1.0, blur=0.0, grain=0.0)), plain)


def test_a_wrapper_for_a_camera_is_refused_over_a_driver_without_one() -> None:
    with pytest.raises(FreneticError, match=r"light changes what a camera sees, and the driver"):
        load_driver("planner", light=0.5)
    with pytest.raises(FreneticError, match=r"fog is 1: 2 to 100000 m is needed"):
        load_driver("marking-follower", fog=1.0)


def test_conditions_are_applied_in_the_order_of_one_picture() -> None:
    driver = load_driver("marking-follower", grain=3.0, fog=50.0, noise=0.1)
    with (
        EmbeddedSimulator() as simulator,
        in_conditions({"light": 0.5, "fog": 70.0}, simulator, driver) as wrapped,
    ):
        described = describe(wrapped)
    wrappers = []
    while "driver" in described:
        wrappers.append((str(described["class"]).rpartition(":")[2], described["options"]))
        described = described["driver"]  # type: ignore[assignment]
    assert [name for name, _ in wrappers] == ["Noisy", "Foggy", "Lit", "Grainy"]
    assert wrappers[1][1] == {"visibility": 70.0}
    assert described["camera"] == asdict(Camera())


def test_the_marking_follower_keeps_its_lane_by_the_picture_alone() -> None:
    driver = load_driver("marking-follower")
    blind = load_driver("marking-follower", wear=1.0)
    with EmbeddedSimulator() as simulator:
        seeing = judge(BENDS, simulator.drive(BENDS, driver))
        night = judge(BENDS, simulator.drive(BENDS, blind))
    assert seeing.outcome is Outcome.PASS, seeing.reason
    assert night.outcome is Outcome.FAIL
