"""MetaDrive's engine with one road and one car: the only module that makes MetaDrive environments.

In MetaDrive the road starts at the origin, since Bullet calculates in single precision: positions
there are relative to the road's first point.
"""

from __future__ import annotations

import logging
import math
from typing import Any, Final

import numpy as np
from metadrive.component.map.scenario_map import ScenarioMap
from metadrive.component.sensors.rgb_camera import RGBCamera
from metadrive.constants import DEFAULT_AGENT
from metadrive.engine.base_engine import BaseEngine
from metadrive.engine.engine_utils import close_engine, engine_initialized
from metadrive.envs.base_env import BaseEnv
from metadrive.manager.base_manager import BaseManager
from metadrive.obs.observation_base import DummyObservation
from metadrive.type import MetaDriveType
from panda3d.core import Vec3

from frenetic.drivers.camera import Camera, Image
from frenetic.errors import FreneticError
from frenetic.plugins.metadrive.car import (
    BRAKE_IMPULSE,
    ENGINE_FORCE,
    PHYSICS_STEP,
    VEHICLE,
)
from frenetic.plugins.metadrive.navigation import EGO_LANE, RoadNavigation
from frenetic.road import Road
from frenetic.simulators.stepped import Motion

SEED: Final = 0
"""Seed of MetaDrive on every road, so that the car is the same in all drives."""
POINT_SPACING: Final = 1.25
"""Distance between the points of the map's lines, in m; our choice. MetaDrive merges points that
are less than 1 m apart, and on the inner lane of the sharpest valid curve they are closer by a
seventh."""
SETTLING_STEPS: Final = 60
"""Number of physics steps for which the car stands before a drive, since MetaDrive drops it onto
its wheels; our choice."""
CAMERA: Final = "frenetic_camera"
"""Name of the camera among MetaDrive's sensors."""
_CAMERA_NEAR: Final = 0.1
"""Distance of the nearest that a camera sees, in m; our choice."""
_CAR_TOLERANCE: Final = 1e-6
"""Relative difference up to which a number of MetaDrive's car is the known one."""


class _PhysicsEngine(BaseEngine):  # type: ignore[misc]
    """Engine that does not download MetaDrive's assets, which only drawing needs."""

    @staticmethod
    def try_pull_asset() -> None:
        """Download nothing."""


class _RoadManager(BaseManager):  # type: ignore[misc]
    """Manager that makes MetaDrive's map of a road."""

    PRIORITY = (
        0  # managers are reset in this order: the map first, since the car looks for its lane
    )

    def __init__(self) -> None:
        super().__init__()
        self.road: Road | None = None
        """Road of the next reset; None for no road."""
        self.current_map: Any = None

    def before_reset(self) -> None:
        """Remove the last map."""
        if self.current_map is not None:
            self.current_map.detach_from_world()
            self.current_map.destroy()
            self.current_map = None

    def reset(self) -> None:
        """Build the map of the road."""
        if self.road is None:
            return
        self.current_map = ScenarioMap(map_index=0, map_data=map_data(self.road))
        self.current_map.attach_to_world()

    def destroy(self) -> None:
        """Remove the map and the manager."""
        self.before_reset()
        super().destroy()


class _RoadEnv(BaseEnv):  # type: ignore[misc]
    """A MetaDrive environment with nothing but a road and a car."""

    @classmethod
    def default_config(cls) -> Any:
        """Return MetaDrive's defaults with the entries that its navigation and policies read."""
        config = super().default_config()
        config.update(
            {"start_seed": SEED, "map_config": {}, "enable_idm_lane_change": False},
            allow_add_new_key=True,
        )
        return config

    def lazy_init(self) -> None:
        """Start the engine, without downloading the assets as MetaDrive's own method does."""
        if not engine_initialized():
            _PhysicsEngine(self.config)
            self.setup_engine()

    def setup_engine(self) -> None:
        """Register MetaDrive's managers and the one of the road."""
        super().setup_engine()
        self.engine.register_manager("map_manager", _RoadManager())

    def get_single_observation(self) -> Any:
        """Return an observation without content: this environment's observations are not used."""
        return DummyObservation()

    def reward_function(self, object_id: str) -> tuple[float, dict[str, Any]]:  # noqa: ARG002
        """Return no reward."""
        return 0.0, {}

    def cost_function(self, object_id: str) -> tuple[float, dict[str, Any]]:  # noqa: ARG002
        """Return no cost."""
        return 0.0, {}

    def done_function(self, object_id: str) -> tuple[bool, dict[str, Any]]:  # noqa: ARG002
        """Return False: the rules end a drive, not MetaDrive."""
        return False, {}


class World:
    """MetaDrive's engine with a car, and a road once one is loaded.

    Args:
        camera: camera on the car; None for none, then nothing is drawn.
        region: side of the square around the road's start that is drawn, in m, see `drawn_region`;
            not used without a camera.

    Raises:
        FreneticError: this process already has a MetaDrive engine, or MetaDrive's car is not the
            known one.
    """

    def __init__(self, camera: Camera | None = None, region: int = 0) -> None:
        self.camera = camera
        self.region = region
        if engine_initialized():
            raise FreneticError(
                "a MetaDrive engine is running in this process, which can have only one: close"
                " it first, or drive in other processes, with 2 or more workers"
            )
        self._env = _RoadEnv(
            {
                "physics_world_step_size": PHYSICS_STEP,
                "agent_configs": {
                    DEFAULT_AGENT: {
                        "vehicle_model": "static_default",
                        "spawn_position_heading": ((0.0, 0.0), 0.0),
                        "spawn_velocity": (0.0, 0.0),
                    }
                },
                "vehicle_config": {
                    "navigation_module": RoadNavigation,
                    "show_navi_mark": False,
                    # The lidar with which the expert was trained
                    "lidar": {"num_lasers": 240, "distance": 50, "num_others": 4},
                },
                # Make a new car for each drive: a used one moves differently in the last bits.
                "force_destroy": True,
                "log_level": logging.ERROR,
                **({} if camera is None else _drawing(camera, region)),
            }
        )
        self._origin = (0.0, 0.0)  # position of MetaDrive's origin on the map, in m
        self._height = 0.0  # height of the car's origin above the ground at rest, in m
        self.vehicle: Any = None
        """MetaDrive's car."""
        try:
            self._reset()
            self._check_car()
            if camera is not None:
                lens = self.engine.get_sensor(CAMERA).lens
                lens.setFov(camera.field_of_view, camera.vertical_field_of_view)
                lens.setNear(_CAMERA_NEAR)
        except BaseException:
            self.close()
            raise

    @property
    def engine(self) -> Any:
        """MetaDrive's engine."""
        return self._env.engine

    def close(self) -> None:
        """End the engine."""
        try:
            close_engine()
        finally:
            BaseEngine.singleton = None  # also after an error, so that another engine can start

    def _reset(self) -> None:
        """Build the map of the road and a new car."""
        self._env.reset(seed=SEED)
        self.vehicle = self._env.agent

    def _check_car(self) -> None:
        """Check that MetaDrive's car is the one that drivers are told of.

        Raises:
            FreneticError: a number differs, as in another version of MetaDrive.
        """
        car = self.vehicle
        for name, actual, known in (
            ("length", car.LENGTH, VEHICLE.length),
            ("width", car.WIDTH, VEHICLE.width),
            ("mass", car.MASS, VEHICLE.mass),
            ("front axle", car.FRONT_WHEELBASE, VEHICLE.front_axle),
            ("rear axle", car.REAR_WHEELBASE, VEHICLE.rear_axle),
            ("steering limit", math.radians(car.max_steering), VEHICLE.steering_limit),
            ("engine force", car.config["max_engine_force"], ENGINE_FORCE),
            ("brake impulse", car.config["max_brake_force"], BRAKE_IMPULSE),
            ("tyre friction", car.config["wheel_friction"], VEHICLE.tyre_peak),
        ):
            if not math.isclose(actual, known, rel_tol=_CAR_TOLERANCE):
                raise FreneticError(
                    f"the car of this MetaDrive has another {name}, {actual:g} instead of"
                    f" {known:g}: install the version that is known, metadrive-simulator 0.4.3"
                )

    def load(self, road: Road, *, friction: float, left: float, turned: float) -> None:
        """Replace the road and put a car at its start, at rest.

        Args:
            road: road of the next drive.
            friction: friction of the road, where 1 is MetaDrive's.
            left: distance of the car to the left of the ego lane's centre, in m.
            turned: angle of the car to the left of the road's direction, in rad.
        """
        x, y, heading = road.pose
        self._origin = (x, y)
        offset = left - 0.5 * road.lane_width
        start = (-offset * math.sin(heading), offset * math.cos(heading))
        self.engine.map_manager.road = road
        car = self.engine.global_config["agent_configs"][DEFAULT_AGENT]
        car["spawn_position_heading"] = (start, heading + turned)
        self._reset()
        vehicle = self.vehicle
        # `vehicle.wheels` cannot be used: it was filled while the car had fewer wheels, and its
        # entries point to where these were.
        for wheel in vehicle.system.getWheels():
            wheel.setFrictionSlip(vehicle.config["wheel_friction"] * friction)
        self.steer(0.0, 0.0)
        self.advance(SETTLING_STEPS)
        vehicle.body.setLinearVelocity(Vec3(0.0))
        vehicle.body.setAngularVelocity(Vec3(0.0))
        self._height = float(vehicle.origin.getZ())

    def picture(self) -> Image:
        """Return what the camera sees now, (height, width, 3)."""
        assert self.camera is not None
        sensor, camera = self.engine.get_sensor(CAMERA), self.camera
        # In the car's frame x points to the right and y ahead. Its origin is above the ground, from
        # which the camera's height is measured.
        colours = sensor.perceive(
            to_float=False,
            new_parent_node=self.vehicle.origin,
            position=(-camera.left, camera.forward, camera.up - self._height),
            hpr=(0.0, -camera.pitch, 0.0),
        )
        return np.array(colours[..., 2::-1], dtype=np.uint8)  # from blue, green, red

    def steer(self, steering: float, throttle_brake: float) -> None:
        """Set MetaDrive's action: steering, positive to the left, and throttle or brake, -1..1."""
        self.vehicle.before_step((steering, throttle_brake))

    def advance(self, steps: int) -> None:
        """Move the car by a number of physics steps.

        Raises:
            ArithmeticError: the physics broke, so that Panda3D raised an error.
        """
        try:
            for _ in range(steps):
                self.engine.step_physics_world()
        except AssertionError as error:
            raise ArithmeticError(f"MetaDrive's physics broke: {error}") from error

    def motion(self) -> Motion:
        """Return position and motion of the car now, without its steering."""
        vehicle = self.vehicle
        position = vehicle.origin.getPos()
        ahead = vehicle.origin.getQuat().getForward()
        velocity = vehicle.body.getLinearVelocity()
        heading = math.atan2(ahead[1], ahead[0])
        c, s = math.cos(heading), math.sin(heading)
        return Motion(
            x=position[0] + self._origin[0],
            y=position[1] + self._origin[1],
            heading=heading,
            speed=c * velocity[0] + s * velocity[1],
            lateral_speed=c * velocity[1] - s * velocity[0],
            yaw_rate=vehicle.body.getAngularVelocity()[2],
        )


def _drawing(camera: Camera, region: int) -> dict[str, Any]:
    """Return the configuration of an engine that draws for a camera only, without a window."""
    return {
        "image_observation": True,
        "sensors": {CAMERA: (RGBCamera, camera.width, camera.height)},
        "multi_thread_render": False,  # with threads a picture would show the last one's moment
        "map_region_size": region,
        "show_fps": False,
        "show_interface": False,
        "preload_models": False,
    }


def map_data(road: Road) -> dict[str, dict[str, Any]]:
    """Return MetaDrive's map of a road: two lanes, solid edges, and a dashed centre line.

    Its coordinates are relative to the road's first point.
    """
    x, y, _ = road.pose

    def line(offset: float) -> Any:
        return road.sample(POINT_SPACING, offset) - (x, y)

    def lane(right: float, left: float, direction: int) -> dict[str, Any]:
        centre = line(0.5 * (left + right))[::direction]
        return {
            "type": MetaDriveType.LANE_SURFACE_STREET,
            "polyline": np.column_stack([centre, np.zeros(len(centre))]),
            "polygon": np.concatenate([line(left), line(right)[::-1]]),
            "width": road.lane_width,
            "entry_lanes": [],
            "exit_lanes": [],
            "left_neighbor": [],
            "right_neighbor": [],
        }

    width = road.lane_width
    return {
        EGO_LANE: lane(right=-width, left=0.0, direction=1),
        "other": lane(right=0.0, left=width, direction=-1),
        "right edge": {
            "type": MetaDriveType.LINE_SOLID_SINGLE_WHITE,
            "polyline": line(-width),
        },
        "centre line": {
            "type": MetaDriveType.LINE_BROKEN_SINGLE_YELLOW,
            "polyline": line(0.0),
        },
        "left edge": {
            "type": MetaDriveType.LINE_SOLID_SINGLE_WHITE,
            "polyline": line(width),
        },
    }
