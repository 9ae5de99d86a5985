"""MetaDrive as a simulator: the contract, start and end, errors.

No part of MetaDrive is replaced; engines run in this process, one after the other.
"""

from __future__ import annotations

import math
from importlib.util import spec_from_file_location
from pathlib import Path

import numpy as np
import pytest
from metadrive.component.sensors.base_sensor import BaseSensor
from metadrive.component.vehicle.vehicle_type import StaticDefaultVehicle
from metadrive.engine.engine_utils import engine_initialized, get_engine
from metadrive_drives import STRAIGHT, WINDING, Fixed, digest, run
from panda3d.core import LPoint3, NodePath, PerspectiveLens, Point2, Vec3

from frenetic.drivers import Camera, Controls, Observation, Stanley
from frenetic.drivers.loading import load_driver
from frenetic.errors import DriverError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.plugins.metadrive import MetaDriveIdm, MetaDriveSimulator, drawing, world
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.road import Road
from frenetic.simulators import Rules, Simulator
from frenetic.testing import SimulatorContract

pytestmark = pytest.mark.heavy


class TestMetaDrive(SimulatorContract):
    def make(self, rules: Rules) -> Simulator:
        return MetaDriveSimulator(rules=rules)


def test_friction_limits_the_lateral_acceleration() -> None:
    driver = Fixed(Controls(0.4), 5.0, Controls(0.0, throttle=1.0))
    grips = []
    for friction in (1.0, 0.5):
        with MetaDriveSimulator(friction=friction) as simulator:
            t = simulator.drive(STRAIGHT, driver).trajectory
        grips.append(np.abs(t.yaw_rate * t.speed)[102:110].max())
    assert grips[0] == pytest.approx(0.9 * 9.81, rel=0.1)
    assert grips[1] == pytest.approx(0.45 * 9.81, rel=0.15)


def test_options_out_of_range_are_refused() -> None:
    for make, name, value in (
        (MetaDriveSimulator, "friction", 0.0),
        (MetaDriveSimulator, "friction", math.nan),
        (MetaDriveSimulator, "wall_limit", -1.0),
        (MetaDriveSimulator, "start_offset", 3.0),
        (MetaDriveIdm, "target_speed", math.inf),
        (MetaDriveIdm, "target_speed", True),
    ):
        with pytest.raises(ValueError, match=rf"{name} is {value}: (a number|-2 to 2 m)"):
            make(**{name: value})  # type: ignore[arg-type]


def test_a_car_of_another_length_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(StaticDefaultVehicle, "DEFAULT_LENGTH", 5.0)
        with pytest.raises(FreneticError, match=r"another length, 5 instead of 4\.515: install"):
            MetaDriveSimulator().__enter__()
    with MetaDriveSimulator() as simulator:
        assert judge(WINDING, simulator.drive(WINDING, Stanley())).outcome is Outcome.PASS


def test_the_engine_ends_with_the_simulator_also_after_an_exception() -> None:
    simulator = MetaDriveSimulator()

    def interrupted() -> None:
        with simulator:
            simulator.drive(STRAIGHT, Stanley())
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert not engine_initialized()
    with pytest.raises(FreneticError, match="MetaDrive is not running"):
        simulator.drive(STRAIGHT, Stanley())


def test_a_second_engine_in_a_process_is_refused() -> None:
    with MetaDriveSimulator() as simulator:
        with pytest.raises(FreneticError, match="a MetaDrive engine is running in this process"):
            MetaDriveSimulator().__enter__()
        assert judge(WINDING, simulator.drive(WINDING, Stanley())).outcome is Outcome.PASS


def test_broken_physics_is_the_simulators_fault() -> None:
    class Saboteur(Fixed):
        def act(self, observation: Observation) -> Controls:
            if observation.time >= 1.0:
                car = get_engine().agent_manager.active_agents["default_agent"]
                car.body.setLinearVelocity(Vec3(1e38))
            return self.controls

    with (
        MetaDriveSimulator() as simulator,
        pytest.raises(ArithmeticError, match="physics broke"),
    ):
        simulator.drive(STRAIGHT, Saboteur(Controls(0.0, throttle=1.0)))
    with MetaDriveSimulator() as simulator:
        assert judge(STRAIGHT, simulator.drive(STRAIGHT, Stanley())).outcome is Outcome.PASS


def test_an_error_names_the_missing_package_in_one_line() -> None:
    code = (
        "import sys\n"
        "sys.modules['metadrive'] = None\n"
        "from frenetic.errors import FreneticError\n"
        "from frenetic.parts.registry import SIMULATORS\n"
        "try:\n"
        "    SIMULATORS.make('metadrive').__enter__()\n"
        "except FreneticError as error:\n"
        "    print(error)\n"
    )
    assert run(code).splitlines() == [
        'the simulator metadrive needs the package metadrive: pip install ".[metadrive]" in the'
        " clone of Frenetic"
    ]


def test_metadrive_is_imported_only_when_needed() -> None:
    code = (
        "import sys, frenetic, frenetic.plugins.metadrive\n"
        "from frenetic.parts.registry import DRIVERS, SIMULATORS\n"
        "SIMULATORS.make('metadrive'), DRIVERS.make('metadrive-idm')\n"
        "print('metadrive' in sys.modules)\n"
    )
    assert run(code).split() == ["False"]


class Screenless(BaseSensor):  # type: ignore[misc]
    """A camera like MetaDrive's that needs no screen: it shows points, projected by Panda3D."""

    points: tuple[tuple[float, float], ...] = ()
    """Points on the ground, in m from the road's start."""

    def __init__(self, width: int, height: int, engine: object) -> None:
        self.size = (height, width)
        self.lens = PerspectiveLens()

    def perceive(
        self,
        to_float: bool,
        new_parent_node: NodePath,
        position: tuple[float, float, float],
        hpr: tuple[float, float, float],
    ) -> np.ndarray:
        assert not to_float
        height, width = self.size
        eye = new_parent_node.attachNewNode("eye")
        eye.setPos(*position)
        eye.setHpr(*hpr)
        picture = np.zeros((height, width, 3), np.uint8)
        for x, y in self.points:
            projection = Point2()
            place = eye.getRelativePoint(get_engine().render, LPoint3(x, y, 0.0))
            if self.lens.project(place, projection):  # it is in view
                row = (1.0 - projection[1]) / 2.0 * height
                column = (1.0 + projection[0]) / 2.0 * width
                picture[int(row), int(column)] = (10, 20, 30)  # blue, green, red
        eye.removeNode()
        return picture


def test_a_driver_sees_through_a_camera_on_the_car(monkeypatch: pytest.MonkeyPatch) -> None:
    class Seeing(Stanley):
        camera = Camera(width=64, height=48, field_of_view=70.0, left=0.5, up=2.0, pitch=20.0)

        def act(self, observation: Observation) -> Controls:
            images.append(observation.image)
            return super().act(observation)

    def screenless(camera: Camera, region: int) -> dict[str, object]:
        assert region == 256
        return {"sensors": {world.CAMERA: (Screenless, camera.width, camera.height)}}

    images: list[np.ndarray | None] = []
    road, camera = WINDING, Seeing.camera
    direction = road.pose.heading
    ahead = np.array([math.cos(direction), math.sin(direction)])
    right = np.array([ahead[1], -ahead[0]])
    car = 0.5 * road.lane_width * right  # from the road's start
    # Rows and columns of pixels, and the points on the ground that they show.
    pixels = [(20, 10), (30, 50), (40, 32)]
    rays = camera.rays_through(*np.array(pixels).T)
    scale = -camera.up / rays[:, 2:]
    shift = rays[:, :2] * scale + (camera.forward, camera.left)
    Screenless.points = tuple(map(tuple, car + shift[:, :1] * ahead - shift[:, 1:] * right))
    monkeypatch.setattr(world, "_drawing", screenless)
    with MetaDriveSimulator() as simulator:
        blind = digest(simulator.drive(road, Stanley()))
        first = simulator.drive(road, Seeing())
        assert digest(simulator.drive(road, Stanley())) == blind
    assert digest(first) == blind
    image = images[0]
    assert image is not None
    assert image.shape == camera.shape
    assert not image.flags.writeable
    drawn = [(int(row), int(column)) for row, column in np.argwhere(image.any(axis=2))]
    assert drawn == pixels
    assert image[drawn[0]].tolist() == [30, 20, 10]
    assert len(images) > 100


def test_cameras_are_refused_where_metadrive_cannot_draw(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    simulator = MetaDriveSimulator()
    with pytest.raises(DriverError, match="MetaDrive draws its own world: leave out scene"):
        simulator.check_driver(load_driver("marking-follower", wear=0.5))
    bent = MarkingFollower()
    bent.camera = Camera(distortion=-0.05)
    with pytest.raises(DriverError, match=r"MetaDrive's camera has no distortion: .* -0\.05"):
        simulator.check_driver(bent)

    package = tmp_path / "metadrive"
    (package / "assets").mkdir(parents=True)
    (package / "__init__.py").touch()
    monkeypatch.setattr(
        drawing, "find_spec", lambda name: spec_from_file_location(name, package / "__init__.py")
    )
    with pytest.raises(DriverError, match=r"get them with python -m metadrive\.pull_asset"):
        simulator.check_driver(MarkingFollower())
    (package / "assets" / "version.txt").touch()
    drawing._opens_buffers.cache_clear()
    monkeypatch.setattr(drawing, "_TRIAL", "raise SystemExit(1)")
    with pytest.raises(DriverError, match=r"cannot draw here, and .* \(xvfb-run -a before"):
        simulator.check_driver(MarkingFollower())
    simulator.check_driver(Stanley())
    drawing._opens_buffers.cache_clear()
    monkeypatch.setattr(drawing, "_TRIAL", "")
    simulator.check_driver(MarkingFollower())
    drawing._opens_buffers.cache_clear()


def test_the_drawn_region_holds_the_road() -> None:
    regions = [drawing.drawn_region(Road([0.0] * n)) for n in (3, 12, 14, 50, 100)]
    assert regions == [256, 256, 512, 1024, 2048]
    with pytest.raises(FreneticError, match=r"the road reaches \d+ m from its start: MetaDrive"):
        drawing.drawn_region(Road([0.0] * 150))
