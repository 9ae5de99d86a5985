"""MetaDrive's engine with one road and one car: the only module that knows its environments.

Coordinates belong to the road moved to start at the origin, since Bullet calculates in single
precision.
"""

from __future__ import annotations

import logging
import math
from typing import Any, Final, NamedTuple

import numpy as np
from metadrive.component.map.scenario_map import ScenarioMap
from metadrive.component.navigation_module.base_navigation import BaseNavigation
from metadrive.component.pg_space import BlockParameterSpace, Parameter
from metadrive.component.sensors.rgb_camera import RGBCamera
from metadrive.constants import DEFAULT_AGENT
from metadrive.engine.base_engine import BaseEngine
from metadrive.engine.engine_utils import close_engine, engine_initialized, get_engine
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
from frenetic.plugins.metadrive.expert import PIECE_LENGTH, STRAIGHT_RADIUS
from frenetic.road import Road
from frenetic.simulators.stepped import Motion

SEED: Final = 0
"""Seed of every road, so that the car is the same on each."""
POINT_SPACING: Final = 1.25
"""Distance between the points of the map's lines, in m. MetaDrive merges points less than 1 m
apart, and on the inner lane of the sharpest valid curve they are a seventh closer."""
SETTLING_STEPS: Final = 60
"""Steps of the physics that the car stands before a drive: MetaDrive drops it onto its wheels."""
EGO_LANE: Final = "ego"
"""The name of the ego lane in MetaDrive's map."""
CAMERA: Final = "frenetic_camera"
_NEAREST: Final = 0.1  # m, of what a camera sees


class _PhysicsEngine(BaseEngine):  # type: ignore[misc]
    """The engine without pictures, which needs none of the assets that MetaDrive downloads."""

    @staticmethod
    def try_pull_asset() -> None:
        """Leave the assets where they are."""


class _RoadManager(BaseManager):  # type: ignore[misc]
    """Turns the next road into MetaDrive's map."""

    PRIORITY = 0  # before the car, which looks for its lane

    def __init__(self) -> None:
        super().__init__()
        self.road: Road | None = None
        self.current_map: Any = None

    def before_reset(self) -> None:
        """Take the last road away."""
        if self.current_map is not None:
            self.current_map.detach_from_world()
            self.current_map.destroy()
            self.current_map = None

    def reset(self) -> None:
        """Build the road."""
        if self.road is None:
            return
        self.current_map = ScenarioMap(map_index=0, map_data=map_data(self.road))
        self.current_map.attach_to_world()

    def destroy(self) -> None:
        """Take the road away for good."""
        self.before_reset()
        super().destroy()


class _RoadEnv(BaseEnv):  # type: ignore[misc]
    """A MetaDrive environment with nothing but a road and a car."""

    @classmethod
    def default_config(cls) -> Any:
        """MetaDrive's defaults and what its navigation asks for."""
        config = super().default_config()
        config.update(
            {"start_seed": SEED, "map_config": {}, "enable_idm_lane_change": False},
            allow_add_new_key=True,
        )
        return config

    def lazy_init(self) -> None:
        """Start the engine; MetaDrive's own way would download the assets first."""
        if not engine_initialized():
            _PhysicsEngine(self.config)
            self.setup_engine()

    def setup_engine(self) -> None:
        """Register the managers."""
        super().setup_engine()
        self.engine.register_manager("map_manager", _RoadManager())

    def get_single_observation(self) -> Any:
        """Add nothing."""
        return DummyObservation()

    def reward_function(self, object_id: str) -> tuple[float, dict[str, Any]]:  # noqa: ARG002
        """Add nothing."""
        return 0.0, {}

    def cost_function(self, object_id: str) -> tuple[float, dict[str, Any]]:  # noqa: ARG002
        """Add nothing."""
        return 0.0, {}

    def done_function(self, object_id: str) -> tuple[bool, dict[str, Any]]:  # noqa: ARG002
        """Return the rules end a drive, not MetaDrive."""
        return False, {}


class World:
    """MetaDrive's engine with a car, and a road once one is loaded.

    Args:
        camera: the camera on the car; None draws nothing.
        region: size of the square around the road's start that is drawn, in m; see
            `drawn_region`. Without a camera it is of no use.

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
                    # What the expert was trained with; its observation follows from it.
                    "lidar": {"num_lasers": 240, "distance": 50, "num_others": 4},
                },
                # A used car remembers its last drive in the last bits of its motion.
                "force_destroy": True,
                "log_level": logging.ERROR,
                **({} if camera is None else _drawing(camera, region)),
            }
        )
        self._origin = (0.0, 0.0)
        self._height = 0.0  # of the car's origin above the ground, at rest
        self.vehicle: Any = None  # MetaDrive's car
        try:
            self._reset()
            self._check_car()
            if camera is not None:
                lens = self.engine.get_sensor(CAMERA).lens
                lens.setFov(camera.field_of_view, camera.vertical_field_of_view)
                lens.setNear(_NEAREST)
        except BaseException:
            self.close()
            raise

    @property
    def engine(self) -> Any:
        """MetaDrive's."""
        return self._env.engine

    def close(self) -> None:
        """End the engine."""
        try:
            close_engine()
        finally:
            BaseEngine.singleton = None  # also if it broke on the way

    def _reset(self) -> None:
        self._env.reset(seed=SEED)
        self.vehicle = self._env.agent

    def _check_car(self) -> None:
        """Check that MetaDrive's car is the one of the drivers' setup."""
        car = self.vehicle
        for name, there, here in (
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
            if not math.isclose(there, here, rel_tol=1e-6):
                raise FreneticError(
                    f"the car of this MetaDrive has another {name}, {there:g} instead of {here:g}:"
                    " install the version that is known, metadrive-simulator 0.4.3"
                )

    def load(self, road: Road, *, friction: float, left: float, turned: float) -> None:
        """Replaces the road and puts the car at its start, at rest.

        Args:
            road: what will be driven.
            friction: of the road, 1 is MetaDrive's own.
            left: m left of the ego lane's centre.
            turned: rad left of the road's direction.
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
        # Not `vehicle.wheels`, which point to where the wheels were before there were four.
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
        # On the car x points to the right and y ahead; its position is above the ground.
        colours = sensor.perceive(
            to_float=False,
            new_parent_node=self.vehicle.origin,
            position=(-camera.left, camera.forward, camera.up - self._height),
            hpr=(0.0, -camera.pitch, 0.0),
        )
        return np.array(colours[..., 2::-1], dtype=np.uint8)

    def steer(self, steering: float, throttle_brake: float) -> None:
        """Set what MetaDrive calls an action, each in -1..1: steering left, throttle or brake."""
        self.vehicle.before_step((steering, throttle_brake))

    def advance(self, steps: int) -> None:
        """Move the car on by so many steps of the physics.

        Raises:
            ArithmeticError: the physics broke, and Panda3D noticed.
        """
        try:
            for _ in range(steps):
                self.engine.step_physics_world()
        except AssertionError as error:
            raise ArithmeticError(f"MetaDrive's physics broke: {error}") from error

    def motion(self) -> Motion:
        """Present place and motion of the car."""
        vehicle = self.vehicle
        place = vehicle.origin.getPos()
        ahead = vehicle.origin.getQuat().getForward()
        velocity = vehicle.body.getLinearVelocity()
        heading = math.atan2(ahead[1], ahead[0])
        c, s = math.cos(heading), math.sin(heading)
        return Motion(
            place[0] + self._origin[0],
            place[1] + self._origin[1],
            heading,
            c * velocity[0] + s * velocity[1],
            c * velocity[1] - s * velocity[0],
            vehicle.body.getAngularVelocity()[2],
        )


def _drawing(camera: Camera, region: int) -> dict[str, Any]:
    """Configuration of an engine that draws, for a camera alone and with no window."""
    return {
        "image_observation": True,
        "sensors": {CAMERA: (RGBCamera, camera.width, camera.height)},
        "multi_thread_render": False,  # it shows the world as it was a picture ago
        "map_region_size": region,
        "show_fps": False,
        "show_interface": False,
        "preload_models": False,
    }


def map_data(road: Road) -> dict[str, dict[str, Any]]:
    """Return the road in MetaDrive's terms: two lanes, solid edges, a dashed line in between."""
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
        EGO_LANE: lane(-width, 0.0, 1),
        "other": lane(0.0, width, -1),
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


# Navigation for MetaDrive's drivers. Its own follows maps of straight and circular lanes; this one
# cuts the ego lane of any road into pieces and describes each by the arc that turns as far.


class Piece(NamedTuple):
    """A piece of the ego lane, with the checkpoint at its end."""

    end: float
    """Distance along the ego lane, in m."""
    x: float
    """Coordinate of the checkpoint in m, seen from the road's start, as y."""
    y: float
    """m."""
    radius: float
    """Radius in m, 0 if it is straight."""
    turn: float
    """Turn to the left in rad, 0 if it is straight."""


def pieces_of(road: Road) -> list[Piece]:
    """Return the ego lane cut into pieces, equally long on the centre line."""
    count = max(1, round(road.length / PIECE_LENGTH))
    offset = -0.5 * road.lane_width
    pieces = []
    end = 0.0
    for i in range(count):
        before = road.pose_at(road.length * i / count)
        after = road.pose_at(road.length * (i + 1) / count)
        turn = after.heading - before.heading
        # A parallel on the right is longer where the road turns left.
        length = road.length / count - offset * turn
        end += length
        radius = length / abs(turn) if turn else math.inf
        is_straight = radius > STRAIGHT_RADIUS
        pieces.append(
            Piece(
                end,
                after.x - offset * math.sin(after.heading) - road.pose.x,
                after.y + offset * math.cos(after.heading) - road.pose.y,
                0.0 if is_straight else radius,
                0.0 if is_straight else turn,
            )
        )
    return pieces


class RoadNavigation:
    """A car's navigation module for its road; MetaDrive makes and updates it."""

    def __init__(self, **_options: Any) -> None:
        self.current_lane: Any = None
        self.current_ref_lanes: list[Any] | None = None
        self.next_ref_lanes = None
        self._pieces: list[Piece] = []
        self._width = 0.0
        self._info = np.zeros(self.get_navigation_info_dim(), dtype=np.float32)

    @property
    def map(self) -> Any:
        """MetaDrive's map of the road."""
        return get_engine().map_manager.current_map

    @classmethod
    def get_navigation_info_dim(cls) -> int:
        """Numbers in `get_navi_info`."""
        dimension: int = BaseNavigation.get_navigation_info_dim()
        return dimension

    def get_navi_info(self) -> Any:
        """Numbers 0..1, (10,): five for the checkpoint ahead and five for the one after it."""
        return self._info

    def get_current_lane_width(self) -> float:
        """Width of the ego lane, in m."""
        return self._width

    def get_current_lateral_range(self, position: Any, engine: Any) -> float:  # noqa: ARG002
        """Distance from the left edge of the ego lane to the right one, in m."""
        return self._width

    def reset(self, vehicle: Any) -> None:  # noqa: ARG002
        """Follow the loaded road."""
        road = get_engine().map_manager.road
        self._width = road.lane_width
        self._pieces = pieces_of(road)
        self.current_lane = self.map.road_network.get_lane(EGO_LANE)
        self.current_ref_lanes = [self.current_lane]

    def update_localization(self, vehicle: Any) -> None:
        """Looks for the car's place and the checkpoints ahead of it."""
        s, _ = self.current_lane.local_coordinates(vehicle.position)
        last = len(self._pieces) - 1
        i = next((i for i, piece in enumerate(self._pieces) if piece.end > s), last)
        self._info[:5] = self._describe(self._pieces[i], vehicle)
        self._info[5:] = self._describe(self._pieces[min(i + 1, last)], vehicle)

    def _describe(self, piece: Piece, vehicle: Any) -> list[float]:
        """Five numbers 0..1, as MetaDrive's own navigation scales them."""
        reach = BaseNavigation.NAVI_POINT_DIST
        away = np.array([piece.x, piece.y]) - np.asarray(vehicle.position)
        distance = math.hypot(*away)
        if distance > reach:
            away *= reach / distance
        ahead, right = vehicle.convert_to_local_coordinates(away, 0.0)
        curve = BlockParameterSpace.CURVE
        largest = curve[Parameter.radius].max + self._width
        direction = -math.copysign(1.0, piece.turn) if piece.turn else 0.0
        angle = math.degrees(abs(piece.turn)) / curve[Parameter.angle].max
        scaled = [
            (ahead / reach + 1.0) / 2.0,
            (right / reach + 1.0) / 2.0,
            piece.radius / largest,
            (direction + 1.0) / 2.0,
            (angle + 1.0) / 2.0,
        ]
        return [min(max(value, 0.0), 1.0) for value in scaled]

    def before_reset(self) -> None:
        """Forget the lane, which is about to be destroyed with its map."""
        self.current_lane = self.current_ref_lanes = None

    def detach_from_world(self) -> None:
        """Remove nothing: it has no part in the world."""

    def destroy(self) -> None:
        """Forget the lane."""
        self.before_reset()
