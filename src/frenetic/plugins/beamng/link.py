"""The connection to BeamNG.tech: the only module that calls BeamNGpy.

Every trouble becomes a `BeamngError`. BeamNGpy is imported on use, since that takes seconds.
"""

from __future__ import annotations

import importlib
import logging
import math
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import pip_install
from frenetic.drivers.camera import Camera, Image
from frenetic.errors import FreneticError, describe_error
from frenetic.plugins.beamng.car_state import CarState
from frenetic.plugins.beamng.process import (
    LOOPBACK,
    QUIT_LIMIT,
    child_deaf_to_interrupt,
    end_process,
    free_port,
)
from frenetic.road import Pose, Road

DEFAULT_PORT: Final = 25252
"""Port on which BeamNG.tech listens by default."""
HOME_VARIABLE: Final = "BNG_HOME"
"""Environment variable that says where BeamNG.tech is installed."""
EXTRA: Final = pip_install("beamng")
START_LIMIT: Final = 180.0
"""Time that BeamNG.tech may take to start, in s."""
LOAD_LIMIT: Final = 300.0
"""Time that BeamNG.tech may take for each answer while it loads a level, in s."""
MARKING_WIDTH: Final = 0.15
"""Width of the lines along the road's edges, in m."""
REPLY_LIMIT: Final = 60.0
"""Time that BeamNG.tech may take for any other answer, in s."""
STEPS_PER_SECOND: Final = 60
"""Frames into which a simulated second is cut."""
DROP: Final = 0.2
"""Distance above the ground at which the car is put, in m; it settles before the drive begins."""

ROAD: Final = "frenetic_road"
GOAL: Final = "frenetic_goal"
EGO: Final = "ego"
CAMERA: Final = "frenetic_camera"
# Drawn with a centre line; known in every level.
_SURFACE: Final = "track_editor_C_center"
_LINE: Final = "m_line_white"
_ALL_WAYS: Final = (0.0, 0.0, 0.0, 1.0)
_DIRECT: Final = 2  # BeamNG.tech's number of the filter for steering wheels; a gamepad's is 1
_PICTURE_PERIOD: Final = 0.05  # s between two pictures
_SEEN: Final = (0.05, 2000.0)  # m, the nearest and the farthest that a camera sees
_POLL: Final = 0.5  # s between two looks whether BeamNG.tech has started
_CONNECT_LIMIT: Final = 10.0  # s until a port that does not even refuse counts as unreachable
# Front, then rear; each bottom left, bottom right, top left, top right.
_CORNERS: Final = tuple(
    f"{end}_{height}_{side}"
    for end in ("front", "rear")
    for height in ("bottom", "top")
    for side in ("left", "right")
)

logger = logging.getLogger(__name__)
_silence = logging.NullHandler()
_scenarios = count(1)


class BeamngError(FreneticError):
    """BeamNG.tech cannot be started or reached, or it broke."""


def place_of(
    home: str | None,
    user: str | None,
    host: str | None,
    port: int | None,
    headless: bool,
    no_gpu: bool,
) -> dict[str, Any]:
    """BeamNGpy's arguments for a place: a home starts BeamNG.tech, a host or port connects to one.

    Raises:
        BeamngError: no option names a place, or the options contradict each other.
    """
    is_running = host is not None or port is not None
    if home is None and not is_running:
        home = os.environ.get(HOME_VARIABLE) or None
        if home is None:
            raise BeamngError(
                "nothing says where BeamNG.tech is: give its folder as home, set"
                f" {HOME_VARIABLE}, or give the port (and the host) of one that runs"
            )
    elif home is not None and is_running:
        raise BeamngError(
            "home excludes host and port: give a home to start BeamNG.tech on this machine, or a"
            " host or port to connect to one that runs"
        )
    if home is None:
        if user or headless or no_gpu:
            raise BeamngError(
                "user, headless and no_gpu are for a BeamNG.tech that is started: give home, too"
            )
        return {"host": host or LOOPBACK, "port": port or DEFAULT_PORT, "home": None}
    folders = {
        name: folder and str(Path(folder).expanduser().resolve())
        for name, folder in (("home", home), ("user", user))
    }
    if " " in (folders["user"] or ""):
        raise BeamngError(
            f"user {user!r}: BeamNG.tech takes no folder with a space in its path; give another"
        )
    return {"host": LOOPBACK, "port": None, **folders, "headless": headless, "nogpu": no_gpu}


def beamngpy() -> Any:
    """Return the package BeamNGpy.

    Raises:
        BeamngError: it is not installed.
    """
    # BeamNGpy logs a lot, and its warnings go unread; those that matter become errors.
    foreign_logger = logging.getLogger("beamngpy")
    foreign_logger.addHandler(_silence)
    foreign_logger.propagate = logger.isEnabledFor(logging.DEBUG)
    try:
        return importlib.import_module("beamngpy")
    except ModuleNotFoundError as error:
        if error.name != "beamngpy":
            raise
        raise BeamngError(f"BeamNG.tech needs the package beamngpy: {EXTRA}") from None


class Link:
    """A connection to BeamNG.tech, and the process if it was started for it.

    Args:
        place: where BeamNG.tech is, see `place_of`.

    Raises:
        BeamngError: it does not start or answer, or is of another version than BeamNGpy.
    """

    def __init__(self, place: Mapping[str, Any]) -> None:
        self._package = beamngpy()
        self._process: subprocess.Popen[bytes] | None = None
        self._scenario: Any = None
        self._ego: Any = None
        self._camera: Any = None
        self.user_folder = ""
        """Folder for its files and licence, on its machine."""
        self.is_licensed = False
        """Whether it found its licence, so that it is BeamNG.tech."""
        with _asking("preparing it"):
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

    # Its life

    def _start(self) -> None:
        bng = self._bng
        with _asking("starting it"), child_deaf_to_interrupt():
            bng._start_beamng(None, "-tcom-listen-ip", LOOPBACK)
            process: subprocess.Popen[bytes] = bng.process
        self._process = process
        deadline = time.monotonic() + START_LIMIT
        # During the start its first answer may also take long.
        while not self._open(max(START_LIMIT, REPLY_LIMIT)):
            code = process.poll()
            if code is not None or time.monotonic() > deadline:
                ended = f"did not listen within {START_LIMIT:g} s"
                if code is not None:
                    ended = f"ended while it started, with exit code {code}"
                by_hand = bng.get_launch_arguments()
                raise BeamngError(f"BeamNG.tech {ended}: start it by hand to see why ({by_hand})")
            time.sleep(_POLL)

    def _open(self, limit: float) -> bool:
        """Connect if somebody listens; the first answer may take as long as the limit in s."""
        bng = self._bng
        with _asking(f"connecting to {bng.host}:{bng.port}"):
            # BeamNGpy's own way of opening waits for an answer twice.
            bng.connection = _connection(bng.host, bng.port, limit)
            if not bng.connection.connect_to_beamng(tries=1, log_tries=False):
                return False
            self._limit(REPLY_LIMIT)
            self.is_licensed = bool(bng.system.get_info()["tech"])
            self.user_folder = str(bng.system.get_environment_paths()["user"])
        return True

    @property
    def version(self) -> str:
        """Version of BeamNG.tech, as far as the name of its user folder tells it."""
        return Path(self.user_folder.replace("\\", "/")).name or "unknown"

    def require(self, level: str, vehicle: str) -> None:
        """Check that there are a level and a vehicle.

        Raises:
            BeamngError: one is missing; the message lists others.
        """
        with _asking("listing levels and vehicles"):
            known = {
                f"level {level}": self._bng.scenario.get_levels(),
                f"vehicle {vehicle}": self._bng.vehicles.get_available(),
            }
        for wanted, names in known.items():
            if wanted.partition(" ")[2] not in names:
                listed = ", ".join(sorted(names)[:20])
                raise BeamngError(f"there is no {wanted}: choose one of {listed}")

    def close(self) -> None:
        """Disconnects; ends BeamNG.tech if it was started for this connection."""
        process, self._process = self._process, None
        self._scenario = self._ego = None
        try:
            # A lost connection need not be closed cleanly.
            if process is not None and process.poll() is None:
                with suppress(Exception):
                    self._limit(QUIT_LIMIT)
                    self._bng.control.quit_beamng()
            with suppress(Exception):
                self._bng.disconnect()
        finally:
            if process is not None:
                end_process(process)

    def _limit(self, seconds: float) -> None:
        """Limits the time of an answer of BeamNG.tech and its vehicle."""
        for holder in (self._bng, self._ego):
            connection = getattr(holder, "connection", None)
            if connection is not None and connection.skt is not None:
                connection.skt.skt.settimeout(seconds)

    # A scenario

    def load(self, level: str, ground: float, road: Road, start: Pose, vehicle: str) -> None:
        """Build a road of two lanes and put the car on it, while time stands still.

        Args:
            level: a flat one.
            ground: m, its height.
            road: has the same place on the map and in BeamNG.tech.
            start: place of the car's position, which need not be its middle, and its heading.
            vehicle: the car's model.
        """
        self.unload()

        def nodes(line: FloatArray) -> list[tuple[float, float, float]]:
            return [(float(x), float(y), ground) for x, y in line]

        package = self._package
        self._limit(LOAD_LIMIT)
        with _asking(f"loading the road and {vehicle} in level {level}"):
            scenario = package.Scenario(level, f"frenetic_{os.getpid()}_{next(_scenarios)}")
            # The first road added is drawn on top; one with a drivability is one to BeamNG.AI.
            inset = road.lane_width - MARKING_WIDTH
            for name, offset in (("left", inset), ("right", -inset)):
                marking = package.Road(
                    _LINE, rid=f"frenetic_{name}", drivability=-1, default_width=MARKING_WIDTH
                )
                marking.add_nodes(*nodes(road.sample(offset=offset)))
                scenario.add_road(marking)
            surface = package.Road(_SURFACE, rid=ROAD, default_width=2.0 * road.lane_width)
            surface.add_nodes(*nodes(road.road_points))
            scenario.add_road(surface)
            goal = nodes(road.road_points[-1:])[0]
            scenario.add_object(
                package.ScenarioObject(GOAL, GOAL, "BeamNGWaypoint", goal, (4.0,) * 3, _ALL_WAYS)
            )
            ego = package.Vehicle(EGO, model=vehicle)
            ego.sensors.attach("electrics", _module("sensors").Electrics())
            # A quaternion (x, y, z, w) of a car that faces -y unless it is turned.
            half = 0.5 * math.atan2(-math.cos(start.heading), -math.sin(start.heading))
            scenario.add_vehicle(
                ego,
                pos=(start.x, start.y, ground + DROP),
                rot_quat=(0.0, 0.0, math.sin(half), math.cos(half)),
                safe_spawn=False,
            )
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
        self._limit(REPLY_LIMIT)

    def _connect(self, ego: Any) -> None:
        """Connect to the car; BeamNGpy alone would wait for its first answer for ever."""
        port = int(self._bng.vehicles.start_connection(ego, ego.extensions)["result"])
        ego.connection = _connection(self._bng.host, port, LOAD_LIMIT)
        ego.connect(self._bng)

    def unload(self) -> None:
        """Remove the scene, if there is one."""
        scenario, self._scenario, self._ego = self._scenario, None, None
        camera, self._camera = self._camera, None
        if scenario is not None:
            with _asking("leaving the road"):
                if camera is not None:
                    camera.remove()
                self._bng.scenario.stop()
                scenario.delete(self._bng)

    def step(self, seconds: float) -> None:
        """Advances time."""
        with _asking("driving"):
            self._bng.control.step(round(seconds * STEPS_PER_SECOND))

    # The car

    def state(self) -> CarState:
        """State of the car at this moment."""
        with _asking("asking for the car's state"):
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
        """Corners of the car's box, (8, 3) in m: front, then rear; left and right in turn."""
        with _asking("asking for the car's box"):
            corners = self._ego.get_bbox()
            return np.array([corners[name] for name in _CORNERS], dtype=float)

    def control(self, steering: float, throttle: float, brake: float, parking: float = 0.0) -> None:
        """Steer, -1..1, and moves the pedals and the parking brake, 0..1.

        Steering passes by the filter of BeamNG.tech's Control message, which smooths as for a
        gamepad, the more the faster the car is.
        """
        with _asking("steering the car"):
            event = f"input.event('steering', {float(steering)!r}, {_DIRECT})"
            self._ego.queue_lua_command(event)
            self._ego.control(
                throttle=float(throttle), brake=float(brake), parkingbrake=float(parking)
            )

    # Its camera

    def open_camera(self, camera: Camera, ahead: float, left: float, up: float) -> None:
        """Put a camera on the car.

        Args:
            camera: the camera; its lens has no distortion here.
            ahead, left, up: m from the car's position.
        """
        pitch = math.radians(camera.pitch)
        c, s = math.cos(pitch), math.sin(pitch)
        with _asking("putting a camera on the car"):
            # In the car's own frame its nose points to -y and x to the left.
            self._camera = _module("sensors").Camera(
                CAMERA,
                self._bng,
                self._ego,
                requested_update_time=_PICTURE_PERIOD,
                pos=(float(left), -float(ahead), float(up)),
                dir=(0.0, -c, -s),
                up=(0.0, -s, c),
                resolution=(camera.width, camera.height),
                field_of_view_y=camera.vertical_field_of_view,
                near_far_planes=_SEEN,
                is_render_annotations=False,
                is_render_depth=False,
            )

    def picture(self) -> Image:
        """Return what the camera sees now, (height, width, 3)."""
        with _asking("asking for the camera's picture"):
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
        with _asking("calling BeamNG.AI"):
            self.control(0.0, 0.0, 0.0)
            self.limit_ai(speed)
            ai.set_aggression(float(aggression))
            ai.drive_in_lane(True)  # before the waypoint, at which the route is planned
            ai.set_waypoint(GOAL)

    def limit_ai(self, speed: float) -> None:
        """Set BeamNG.AI's speed limit in m/s."""
        with _asking("calling BeamNG.AI"):
            self._ego.ai.set_speed(float(speed), mode="limit")


@contextmanager
def _asking(subject: str) -> Iterator[None]:
    """Turn every trouble with BeamNG.tech into an error that names the activity."""
    from beamngpy.logging import BNGDisconnectedError, BNGError, BNGValueError  # an extra

    try:
        yield
    except BeamngError:
        raise
    except TimeoutError as error:
        raise BeamngError(f"BeamNG.tech did not answer in time, {subject}") from error
    except (BNGDisconnectedError, OSError) as error:
        raise BeamngError(
            f"the connection to BeamNG.tech was lost, {subject}: {describe_error(error)}"
        ) from error
    except (BNGError, BNGValueError) as error:
        text = " ".join(str(error).split())
        if "protocol versions" in text:
            text += (
                "; install the version of beamngpy that belongs to this BeamNG.tech: 1.36 to 0.39,"
                " a newer one to a newer one"
            )
        raise BeamngError(f"BeamNG.tech reported an error, {subject}: {text}") from error
    except (AssertionError, AttributeError, ImportError, LookupError, TypeError, ValueError) as odd:
        raise BeamngError(
            f"BeamNG.tech or beamngpy {version('beamngpy')} is not as Frenetic knows it, {subject}:"
            f" {describe_error(odd)}; Frenetic is tested with beamngpy 1.36, which belongs to"
            " BeamNG.tech 0.39"
        ) from odd


def _module(name: str) -> Any:
    return importlib.import_module(f"beamngpy.{name}")


def _connection(host: str, port: int, limit: float) -> Any:
    """An unopened connection, whose answers may take as long as the limit in s.

    A lost or silent connection is an error at once. BeamNGpy would connect again and wait for the
    answer to a message that it never sent there.
    """
    connection = _module("connection").Connection(host, port, timeout=_CONNECT_LIMIT)
    greet = connection.hello

    def refuse() -> None:
        raise sys.exception() or ConnectionError("it is lost")

    def hello() -> None:
        connection.skt.skt.settimeout(limit)
        connection.skt.reconnect = refuse
        greet()

    connection.hello = hello
    return connection
