"""The connection to BeamNG.tech: the only module that calls BeamNGpy.

Every error becomes a `BeamngError`.
"""

from __future__ import annotations

import logging
import math
import os
import subprocess
import time
from collections.abc import Mapping
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers.camera import Camera, Image
from frenetic.plugins.beamng.car_state import CarState
from frenetic.plugins.beamng.package import (
    BeamngError,
    beamngpy,
    beamngpy_module,
    new_connection,
    translated_errors,
)
from frenetic.plugins.beamng.process import (
    LOOPBACK,
    QUIT_LIMIT,
    child_deaf_to_interrupt,
    end_process,
    free_port,
)
from frenetic.road import Pose, Road

START_LIMIT: Final = 180.0
"""Time that BeamNG.tech may take to start, in s; our choice."""
LOAD_LIMIT: Final = 300.0
"""Time that BeamNG.tech may take for each answer while it loads a level, in s; our choice."""
MARKING_WIDTH: Final = 0.15
"""Width of the lines along the road's edges, in m; our choice."""
REPLY_LIMIT: Final = 60.0
"""Time that BeamNG.tech may take for any other answer, in s; our choice."""
STEPS_PER_SECOND: Final = 60
"""Number of frames of a simulated second; our choice."""
DROP: Final = 0.2
"""Distance above the ground at which the car is put, in m; it settles before the drive begins; our
choice."""

# Names of objects in the scenario
ROAD: Final = "frenetic_road"
GOAL: Final = "frenetic_goal"
EGO: Final = "ego"
CAMERA: Final = "frenetic_camera"
_SURFACE: Final = "track_editor_C_center"
"""Material of the road, known in every level: it shows a centre line."""
_LINE: Final = "m_line_white"
"""Material of the lines along the road's edges, known in every level."""
_NOT_TURNED: Final = (0.0, 0.0, 0.0, 1.0)
"""Quaternion (x, y, z, w) of an object that is not turned."""
_GOAL_SIZE: Final = 4.0
"""Size of the waypoint at the road's end, in m; our choice."""
_NOT_FOR_AI: Final = -1
"""Drivability of a road that BeamNG.AI does not drive on."""
_WHEEL_FILTER: Final = 2
"""BeamNG.tech's number of the filter for steering wheels, without smoothing; a gamepad's is 1."""
_PICTURE_PERIOD: Final = 0.05
"""Time between two pictures of the camera, in s."""
_CAMERA_RANGE: Final = (0.05, 2000.0)
"""Distances of the nearest and the farthest that a camera sees, in m; our choice."""
_START_POLL_INTERVAL: Final = 0.5
"""Time between two attempts to connect to a BeamNG.tech that starts, in s; our choice."""
_MAX_LISTED_NAMES: Final = 20
"""Largest number of names that an error lists."""
# Front, then rear; each bottom left, bottom right, top left, top right.
_CORNERS: Final = tuple(
    f"{end}_{height}_{side}"
    for end in ("front", "rear")
    for height in ("bottom", "top")
    for side in ("left", "right")
)

logger = logging.getLogger(__name__)
_scenario_numbers = count(1)


class Link:
    """A connection to BeamNG.tech, which starts BeamNG.tech if that is not running.

    Args:
        place: BeamNGpy's arguments that say where BeamNG.tech is, see
        `frenetic.plugins.beamng.location`.

    Raises:
        BeamngError: BeamNG.tech does not start or answer, or its version does not fit BeamNGpy's.
    """

    def __init__(self, place: Mapping[str, Any]) -> None:
        self._package = beamngpy()
        self._process: subprocess.Popen[bytes] | None = None
        self._scenario: Any = None
        self._ego: Any = None
        self._camera: Any = None
        self.user_folder = ""
        """Folder with files and licence of BeamNG.tech, on the machine that it runs on."""
        self.is_licensed = False
        """Whether BeamNG.tech has found its licence."""
        with translated_errors("preparing it"):
            port = place["port"] or free_port()
            self._bng: Any = self._package.BeamNGpy(**{**place, "port": port}, quit_on_close=False)
        where = f"{self._bng.host}:{self._bng.port}"
        try:
            if place["home"] is not None:
                self._start()
            elif not self._open(REPLY_LIMIT):
                raise BeamngError(
                    f"nothing answers at {where}: is BeamNG.tech running there, started with -tcom"
                    " -tport PORT?"
                )
        except BaseException:
            self.close()
            raise
        logger.info("connected to BeamNG.tech %s at %s", self.version, where)

    # Start and end

    def _start(self) -> None:
        """Start BeamNG.tech and connect to it.

        Raises:
            BeamngError: it ended, or did not listen within `START_LIMIT`.
        """
        bng = self._bng
        with translated_errors("starting it"), child_deaf_to_interrupt():
            bng._start_beamng(None, "-tcom-listen-ip", LOOPBACK)
            process: subprocess.Popen[bytes] = bng.process
        self._process = process
        deadline = time.monotonic() + START_LIMIT
        # The first answer may take as long as the start.
        while not self._open(max(START_LIMIT, REPLY_LIMIT)):
            code = process.poll()
            if code is not None or time.monotonic() > deadline:
                ended = f"did not listen within {START_LIMIT:g} s"
                if code is not None:
                    ended = f"ended while it started, with exit code {code}"
                by_hand = bng.get_launch_arguments()
                raise BeamngError(f"BeamNG.tech {ended}: start it by hand to see why ({by_hand})")
            time.sleep(_START_POLL_INTERVAL)

    def _open(self, limit: float) -> bool:
        """Connect to BeamNG.tech, and ask it for its licence and its user folder.

        Args:
            limit: time that the first answer may take, in s.

        Returns:
            Whether BeamNG.tech listens.
        """
        bng = self._bng
        with translated_errors(f"connecting to {bng.host}:{bng.port}"):
            # BeamNGpy's method ``open`` would wait for an answer twice.
            bng.connection = new_connection(bng.host, bng.port, limit)
            if not bng.connection.connect_to_beamng(tries=1, log_tries=False):
                return False
            self._set_answer_limit(REPLY_LIMIT)
            self.is_licensed = bool(bng.system.get_info()["tech"])
            self.user_folder = str(bng.system.get_environment_paths()["user"])
        return True

    @property
    def version(self) -> str:
        """Version of BeamNG.tech: the name of its user folder; ``unknown`` without that."""
        return Path(self.user_folder.replace("\\", "/")).name or "unknown"

    def require(self, level: str, vehicle: str) -> None:
        """Check that BeamNG.tech has a level and a vehicle.

        Raises:
            BeamngError: one is missing; the message lists others.
        """
        with translated_errors("listing levels and vehicles"):
            levels = self._bng.scenario.get_levels()
            vehicles = self._bng.vehicles.get_available()
        for kind, name, names in (("level", level, levels), ("vehicle", vehicle, vehicles)):
            if name not in names:
                listed = ", ".join(sorted(names)[:_MAX_LISTED_NAMES])
                raise BeamngError(f"there is no {kind} {name}: choose one of {listed}")

    def close(self) -> None:
        """Disconnect; end BeamNG.tech if it was started for this connection."""
        process, self._process = self._process, None
        self._scenario = self._ego = None
        try:
            # Errors do not matter: the connection may be lost, and the process is ended below.
            if process is not None and process.poll() is None:
                with suppress(Exception):
                    self._set_answer_limit(QUIT_LIMIT)
                    self._bng.control.quit_beamng()
            with suppress(Exception):
                self._bng.disconnect()
        finally:
            if process is not None:
                end_process(process)

    def _set_answer_limit(self, seconds: float) -> None:
        """Limit the time that an answer of BeamNG.tech and of the car may take, in s."""
        for holder in (self._bng, self._ego):
            connection = getattr(holder, "connection", None)
            if connection is not None and connection.skt is not None:
                connection.skt.skt.settimeout(seconds)

    # A scenario

    def load(self, level: str, ground: float, road: Road, start: Pose, vehicle: str) -> None:
        """Build a road of two lanes and put the car on it, while time stands still.

        Args:
            level: name of a flat level.
            ground: height of the level's ground, in m.
            road: road, which has the same coordinates on the map and in BeamNG.tech.
            start: pose of the car's reference node, which need not be in its middle.
            vehicle: name of the car's model.
        """
        self.unload()
        package = self._package
        self._set_answer_limit(LOAD_LIMIT)
        with translated_errors(f"loading the road and {vehicle} in level {level}"):
            scenario = package.Scenario(level, f"frenetic_{os.getpid()}_{next(_scenario_numbers)}")
            self._add_road(scenario, road, ground)
            ego = self._add_car(scenario, vehicle, start, ground)
            scenario.make(self._bng)
            self._scenario = scenario
            self._bng.settings.set_deterministic(STEPS_PER_SECOND)
            self._bng.scenario.load(
                scenario, connect_player_vehicle=False, connect_existing_vehicles=False
            )
            self._connect(ego)
            self._ego = ego
            self._bng.control.pause()
            self._bng.scenario.start()
            self._bng.control.pause()
        self._set_answer_limit(REPLY_LIMIT)

    def _add_road(self, scenario: Any, road: Road, ground: float) -> None:
        """Add a road, its edges and the goal at its end to a scenario, at a height in m."""

        def nodes(line: FloatArray) -> list[tuple[float, float, float]]:
            return [(float(x), float(y), ground) for x, y in line]

        package = self._package
        # A road that is added earlier is drawn on top: the edges come first.
        inset = road.lane_width - MARKING_WIDTH
        for name, offset in (("left", inset), ("right", -inset)):
            marking = package.Road(
                _LINE,
                rid=f"frenetic_{name}",
                drivability=_NOT_FOR_AI,
                default_width=MARKING_WIDTH,
            )
            marking.add_nodes(*nodes(road.sample(offset=offset)))
            scenario.add_road(marking)
        surface = package.Road(_SURFACE, rid=ROAD, default_width=2.0 * road.lane_width)
        surface.add_nodes(*nodes(road.road_points))
        scenario.add_road(surface)
        goal = nodes(road.road_points[-1:])[0]
        scenario.add_object(
            package.ScenarioObject(
                GOAL, GOAL, "BeamNGWaypoint", goal, (_GOAL_SIZE,) * 3, _NOT_TURNED
            )
        )

    def _add_car(self, scenario: Any, vehicle: str, start: Pose, ground: float) -> Any:
        """Add a car to a scenario, above the ground at a height in m; return the car."""
        ego = self._package.Vehicle(EGO, model=vehicle)
        ego.sensors.attach("electrics", beamngpy_module("sensors").Electrics())
        # A quaternion (x, y, z, w): a car that is not turned faces -y.
        half = 0.5 * math.atan2(-math.cos(start.heading), -math.sin(start.heading))
        scenario.add_vehicle(
            ego,
            pos=(start.x, start.y, ground + DROP),
            rot_quat=(0.0, 0.0, math.sin(half), math.cos(half)),
            safe_spawn=False,
        )
        return ego

    def _connect(self, ego: Any) -> None:
        """Connect to the car, with a limit for its first answer, which BeamNGpy does not set."""
        port = int(self._bng.vehicles.start_connection(ego, ego.extensions)["result"])
        ego.connection = new_connection(self._bng.host, port, LOAD_LIMIT)
        ego.connect(self._bng)

    def unload(self) -> None:
        """Remove the scenario with road and car, if one is loaded."""
        scenario, self._scenario, self._ego = self._scenario, None, None
        camera, self._camera = self._camera, None
        if scenario is not None:
            with translated_errors("leaving the road"):
                if camera is not None:
                    camera.remove()
                self._bng.scenario.stop()
                scenario.delete(self._bng)

    def step(self, seconds: float) -> None:
        """Advance the simulated time, in s."""
        with translated_errors("driving"):
            self._bng.control.step(round(seconds * STEPS_PER_SECOND))

    # The car

    def state(self) -> CarState:
        """Return the state of the car at this moment."""
        with translated_errors("asking for the car's state"):
            self._ego.sensors.poll("state", "electrics")
            state, electrics = self._ego.sensors["state"], self._ego.sensors["electrics"]
            return CarState(
                time=float(state["time"]),
                position=np.array(state["pos"], dtype=float),
                forward=np.array(state["dir"], dtype=float),
                up=np.array(state["up"], dtype=float),
                velocity=np.array(state["vel"], dtype=float),
                steering_input=float(electrics["steering_input"]),
                throttle_input=float(electrics["throttle_input"]),
                brake_input=float(electrics["brake_input"]),
            )

    def box(self) -> FloatArray:
        """Return the corners of the car's box, (8, 3) in m, in the order of `_CORNERS`."""
        with translated_errors("asking for the car's box"):
            corners = self._ego.get_bbox()
            return np.array([corners[name] for name in _CORNERS], dtype=float)

    def control(self, steering: float, throttle: float, brake: float, parking: float = 0.0) -> None:
        """Set the steering input, -1..1, and the pedals and the parking brake, 0..1.

        The steering input is a command of its own, because BeamNG.tech's Control message would
        smooth it as a gamepad's, the more the faster the car is.
        """
        with translated_errors("steering the car"):
            event = f"input.event('steering', {float(steering)!r}, {_WHEEL_FILTER})"
            self._ego.queue_lua_command(event)
            self._ego.control(
                throttle=float(throttle), brake=float(brake), parkingbrake=float(parking)
            )

    # The camera and BeamNG.AI

    def open_camera(self, camera: Camera, ahead: float, left: float, up: float) -> None:
        """Put a camera on the car.

        Args:
            camera: the camera; its lens has no distortion here.
            ahead, left, up: position of the camera relative to the car's reference node, in m.
        """
        pitch = math.radians(camera.pitch)
        c, s = math.cos(pitch), math.sin(pitch)
        with translated_errors("putting a camera on the car"):
            # In the car's frame -y points ahead, x to the left and z upwards.
            self._camera = beamngpy_module("sensors").Camera(
                CAMERA,
                self._bng,
                self._ego,
                requested_update_time=_PICTURE_PERIOD,
                pos=(float(left), -float(ahead), float(up)),
                dir=(0.0, -c, -s),
                up=(0.0, -s, c),
                resolution=(camera.width, camera.height),
                field_of_view_y=camera.vertical_field_of_view,
                near_far_planes=_CAMERA_RANGE,
                is_render_annotations=False,
                is_render_depth=False,
            )

    def picture(self) -> Image:
        """Return what the camera sees now, (height, width, 3)."""
        with translated_errors("asking for the camera's picture"):
            colours = self._camera.poll().get("colour")
        if colours is None:
            raise BeamngError(
                "the camera gives no picture: BeamNG.tech draws with a graphics card and its"
                " licence only, and not with low graphics settings"
            )
        return np.array(colours, dtype=np.uint8)[..., :3]

    def let_ai_drive(self, speed: float, aggression: float) -> None:
        """Let BeamNG.AI drive to the road's end in its lane, with a speed limit in m/s."""
        ai = self._ego.ai
        with translated_errors("calling BeamNG.AI"):
            self.control(steering=0.0, throttle=0.0, brake=0.0)
            self.limit_ai(speed)
            ai.set_aggression(float(aggression))
            ai.drive_in_lane(True)  # before the waypoint: setting that plans the route
            ai.set_waypoint(GOAL)

    def limit_ai(self, speed: float) -> None:
        """Set BeamNG.AI's speed limit in m/s."""
        with translated_errors("calling BeamNG.AI"):
            self._ego.ai.set_speed(float(speed), mode="limit")
