"""The connection to BeamNG.tech: all that is said to BeamNGpy is said here.

Every trouble becomes a `BeamngError`. BeamNGpy is imported when BeamNG.tech is asked for, as that
takes seconds.
"""

from __future__ import annotations

import importlib
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic.arrays import FloatArray
from frenetic.errors import describe_error
from frenetic.simulators.beamng.car import CarState
from frenetic.simulators.beamng.errors import BeamngError
from frenetic.simulators.beamng.scene import MARKING_WIDTH, Scene
from frenetic.simulators.wall_limit import WallLimitExceeded, wall_limit

DEFAULT_PORT: Final = 25252
"""On which BeamNG.tech listens unless it is told otherwise."""
LOOPBACK: Final = "127.0.0.1"
HOME_VARIABLE: Final = "BNG_HOME"
"""Environment variable that says where BeamNG.tech is installed."""
EXTRA: Final = 'pip install "frenetic-roads[beamng]"'
START_LIMIT: Final = 180.0
"""s that BeamNG.tech may take to start."""
LOAD_LIMIT: Final = 300.0
"""s that BeamNG.tech may take to load a level."""

ROAD: Final = "frenetic_road"
GOAL: Final = "frenetic_goal"
EGO: Final = "ego"
# Drawn with a centre line; known in every level.
_SURFACE: Final = "track_editor_C_center"
_LINE: Final = "m_line_white"
_ALL_WAYS: Final = (0.0, 0.0, 0.0, 1.0)
_POLL: Final = 0.5  # s between two looks whether BeamNG.tech has started
_QUIT_LIMIT: Final = 10.0  # s to end when asked, and as much again when told
# In the order of `frenetic.simulators.beamng.car.measured_box`.
_CORNERS: Final = tuple(
    f"{end}_{height}_{side}"
    for end in ("front", "rear")
    for height in ("bottom", "top")
    for side in ("left", "right")
)

logger = logging.getLogger(__name__)
_silence = logging.NullHandler()
_scenarios = count(1)


@dataclass(frozen=True)
class Place:
    """Where BeamNG.tech is: to be started, or running."""

    home: Path | None
    """Folder of its installation; None to connect to one that runs."""
    user: Path | None
    """Folder for what it writes; None for its own choice."""
    host: str
    port: int | None
    """None for a free one, if it is to be started."""
    headless: bool
    no_gpu: bool

    @classmethod
    def of(
        cls,
        home: str | None,
        user: str | None,
        host: str | None,
        port: int | None,
        headless: bool,
        no_gpu: bool,
    ) -> Place:
        """What options say: a home starts one, a host or port alone connects.

        Raises:
            BeamngError: nothing says where it is, or the options contradict each other.
        """
        if home is None and host is None and port is None:
            home = os.environ.get(HOME_VARIABLE) or None
        if home is not None and host is not None:
            raise BeamngError(
                f"home {home!r} and host {host!r} exclude each other: a home starts BeamNG.tech on"
                " this machine, a host connects to one that runs"
            )
        if home is None and host is None and port is None:
            raise BeamngError(
                "nothing says where BeamNG.tech is: give --beamng-home its folder, set"
                f" {HOME_VARIABLE}, or give --beamng-port (and --beamng-host) of one that runs"
            )
        if home is None and (user or headless or no_gpu):
            raise BeamngError(
                "user, headless and no_gpu are for a BeamNG.tech that is started: give"
                " --beamng-home, too"
            )
        if user is not None and " " in user:
            raise BeamngError(
                f"user {user!r}: BeamNG.tech takes no folder with a space in its name"
            )
        return cls(
            None if home is None else Path(home).expanduser(),
            None if user is None else Path(user).expanduser(),
            host or LOOPBACK,
            port if port is not None or home is not None else DEFAULT_PORT,
            headless,
            no_gpu,
        )


def beamngpy() -> Any:
    """The package BeamNGpy.

    Raises:
        BeamngError: it is not installed.
    """
    # It says much, and prints its warnings where nobody listens; those that matter become errors.
    theirs = logging.getLogger("beamngpy")
    theirs.addHandler(_silence)
    theirs.propagate = logger.isEnabledFor(logging.DEBUG)
    try:
        return importlib.import_module("beamngpy")
    except ModuleNotFoundError as error:
        if error.name != "beamngpy":
            raise
        raise BeamngError(f"BeamNG.tech needs the package beamngpy: {EXTRA}") from None


def executable(home: Path) -> Path:
    """The program that is started.

    Raises:
        BeamngError: there is none.
    """
    if not home.is_dir():
        raise BeamngError(f"there is no folder {home}: give --beamng-home that of BeamNG.tech")
    beamngpy()
    filesystem: Any = importlib.import_module("beamngpy.beamng.filesystem")
    with _asking("looking for its program"):
        found: Path = filesystem.determine_binary(home)
    return found


class Link:
    """A connection to BeamNG.tech, and the process if it was started for it.

    Args:
        place: where BeamNG.tech is.
        reply_limit: s that it may take for an answer.

    Raises:
        BeamngError: it does not start or answer, or is of another version than BeamNGpy.
    """

    def __init__(self, place: Place, *, reply_limit: float) -> None:
        self._package = beamngpy()
        self._reply_limit = reply_limit
        self._process: subprocess.Popen[bytes] | None = None
        self._scenario: Any = None
        self._ego: Any = None
        if place.home is not None:
            executable(place.home)
        port = place.port if place.port is not None else _free_port()
        where = f"{place.host}:{port}"
        self._bng: Any = self._package.BeamNGpy(
            place.host,
            port,
            home=None if place.home is None else str(place.home.resolve()),
            user=None if place.user is None else str(place.user.resolve()),
            headless=place.headless,
            nogpu=place.no_gpu,
            quit_on_close=False,
            socket_timeout=reply_limit,
        )
        try:
            if place.home is None:
                self._open(where)
            else:
                self._start(where, port)
        except BaseException:
            self.close()
            raise
        logger.info("connected to BeamNG.tech %s at %s", self.version, where)

    # Its life

    def _start(self, where: str, port: int) -> None:
        if _is_taken(port):
            raise BeamngError(
                f"port {port} is taken, maybe by a BeamNG.tech that still runs: end it, choose"
                " another --beamng-port, or leave out --beamng-home to use it"
            )
        with _asking("starting it"), _child_deaf_to_interrupt():
            self._bng._start_beamng(None, "-tcom-listen-ip", LOOPBACK)
        self._process = self._bng.process
        deadline = time.monotonic() + START_LIMIT
        while True:
            code = self._bng.process.poll()
            if code is not None:
                raise BeamngError(
                    f"BeamNG.tech ended while it started, with exit code {code}: start it by hand"
                    f" to see why ({self._bng.last_command_line})"
                )
            try:
                return self._open(where)
            except _UnreachableError:
                if time.monotonic() > deadline:
                    raise BeamngError(
                        f"BeamNG.tech did not listen on port {port} within {START_LIMIT:g} s:"
                        " start it by hand to see why"
                    ) from None
            time.sleep(_POLL)

    def _open(self, where: str) -> None:
        from beamngpy.logging import BNGDisconnectedError

        try:
            self._bng.open(launch=False)
        except BNGDisconnectedError as error:
            # BeamNGpy's own words say no more.
            raise _UnreachableError(
                f"nothing answers at {where}: is BeamNG.tech running there, started with -tcom"
                " -tport PORT?"
            ) from error
        except Exception as error:
            with _asking(f"connecting to {where}"):
                raise error
        _never_reconnect(self._bng.connection)

    @property
    def version(self) -> str:
        """BeamNG.tech's, as far as the name of its user folder says it."""
        return Path(str(self._bng.user_with_version or "").replace("\\", "/")).name or "unknown"

    @property
    def user_folder(self) -> str:
        """Where it writes, on its machine; also where its licence lies."""
        return str(self._bng.user_with_version or "")

    @property
    def is_licensed(self) -> bool:
        """Whether it found its licence, so that it is BeamNG.tech."""
        return bool(self._bng.tech_enabled())

    def levels(self) -> tuple[str, ...]:
        """The names of its levels."""
        with _asking("listing its levels"):
            return tuple(self._bng.scenario.get_levels())

    def vehicles(self) -> tuple[str, ...]:
        """The names of its vehicles."""
        with _asking("listing its vehicles"):
            return tuple(self._bng.vehicles.get_available())

    def close(self) -> None:
        """Disconnects; ends BeamNG.tech if it was started for this connection."""
        process, self._process = self._process, None
        self._scenario = self._ego = None
        try:
            if process is not None and process.poll() is None:
                self._limit(_QUIT_LIMIT)
                with suppress(Exception):
                    self._bng.control.quit_beamng()
            with suppress(Exception):  # what is broken need not be left well
                self._bng.disconnect()
        finally:
            if process is not None:
                _end(process)

    def _limit(self, seconds: float) -> None:
        """Lets an answer take so long, of BeamNG.tech and its vehicle."""
        for holder in (self._bng, self._ego):
            connection = getattr(holder, "connection", None)
            if connection is not None and connection.skt is not None:
                connection.skt.skt.settimeout(seconds)

    # A scenario

    def load(self, level: str, scene: Scene, vehicle: str, steps_per_second: int) -> None:
        """Builds a scene and puts the car into it, time standing still."""
        self.unload()
        package = self._package
        scenario = package.Scenario(level, f"frenetic_{os.getpid()}_{next(_scenarios)}")
        # What is added first is drawn on top; what has a drivability is a road to BeamNG.AI.
        for name, line in zip(("left", "right"), scene.edges, strict=True):
            marking = package.Road(
                _LINE, rid=f"frenetic_{name}", drivability=-1, default_width=MARKING_WIDTH
            )
            marking.add_nodes(*scene.nodes(line))
            scenario.add_road(marking)
        road = package.Road(_SURFACE, rid=ROAD, default_width=scene.width)
        road.add_nodes(*scene.nodes(scene.centre))
        scenario.add_road(road)
        goal = scene.nodes(scene.centre[-1:])[0]
        scenario.add_object(
            package.ScenarioObject(GOAL, GOAL, "BeamNGWaypoint", goal, (4.0,) * 3, _ALL_WAYS)
        )
        ego = package.Vehicle(EGO, model=vehicle)
        ego.sensors.attach("electrics", importlib.import_module("beamngpy.sensors").Electrics())
        scenario.add_vehicle(ego, pos=scene.position, rot_quat=scene.rotation, safe_spawn=False)
        self._limit(LOAD_LIMIT)
        what = f"loading the road and {vehicle} in level {level}"
        # BeamNGpy would wait for a vehicle's first word for ever.
        with _asking(what), _patience(LOAD_LIMIT, what):
            scenario.make(self._bng)
            self._scenario = scenario
            self._bng.settings.set_deterministic(steps_per_second)
            self._bng.scenario.load(scenario)
            _never_reconnect(ego.connection)
            self._ego = ego
            self._bng.control.pause()
            self._bng.scenario.start()
            self._bng.control.pause()
        self._limit(self._reply_limit)

    def unload(self) -> None:
        """Takes the scene away again, if there is one."""
        scenario, self._scenario, self._ego = self._scenario, None, None
        if scenario is not None:
            with _asking("leaving the road"):
                self._bng.scenario.stop()
                scenario.delete(self._bng)

    def step(self, steps: int) -> None:
        """Lets time go on and stand still again."""
        with _asking("driving"):
            self._bng.control.step(steps)

    # The car

    def state(self) -> CarState:
        """The car's at this moment."""
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
        """(8, 3) m, corners of the car's box, in the order of `measured_box`."""
        with _asking("asking for the car's box"):
            corners = self._ego.get_bbox()
            return np.array([corners[name] for name in _CORNERS], dtype=float)

    def control(self, steering: float, throttle: float, brake: float, parking: float = 0.0) -> None:
        """Steers, -1..1, and moves the pedals and the parking brake, 0..1."""
        with _asking("steering the car"):
            self._ego.control(
                steering=float(steering),
                throttle=float(throttle),
                brake=float(brake),
                parkingbrake=float(parking),
            )

    def let_ai_drive(self, speed: float, aggression: float) -> None:
        """Lets BeamNG.AI drive to the road's end, at most at so many m/s, in its lane."""
        ai = self._ego.ai
        with _asking("calling BeamNG.AI"):
            self.control(0.0, 0.0, 0.0)
            ai.set_speed(float(speed), mode="limit")
            ai.set_aggression(float(aggression))
            ai.drive_in_lane(True)  # before the waypoint, at which the route is planned
            ai.set_waypoint(GOAL)


class _UnreachableError(BeamngError):
    """Nothing listens."""


@contextmanager
def _asking(what: str) -> Iterator[None]:
    """Makes every trouble with BeamNG.tech an error that says at what it was."""
    from beamngpy.logging import BNGDisconnectedError, BNGError, BNGValueError

    try:
        yield
    except BeamngError:
        raise
    except TimeoutError as error:
        raise BeamngError(f"BeamNG.tech did not answer in time, {what}") from error
    except (BNGDisconnectedError, OSError) as error:
        raise BeamngError(
            f"the connection to BeamNG.tech was lost, {what}: {describe_error(error)}"
        ) from error
    except (BNGError, BNGValueError) as error:
        text = " ".join(str(error).split())
        if "protocol versions" in text:
            text += "; install the version of beamngpy that belongs to this BeamNG.tech"
        raise BeamngError(f"BeamNG.tech reported an error, {what}: {text}") from error
    except (AssertionError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise BeamngError(
            f"BeamNG.tech answered something unexpected, {what}: {describe_error(error)}"
        ) from error


@contextmanager
def _patience(seconds: float, what: str) -> Iterator[None]:
    try:
        with wall_limit(seconds):
            yield
    except WallLimitExceeded:
        raise BeamngError(f"BeamNG.tech did not finish in time, {what}") from None


def _never_reconnect(connection: Any) -> None:
    """Lets a connection that is lost or silent be an error at once.

    BeamNGpy would connect again and wait for an answer to what it never said there.
    """

    def refuse() -> None:
        raise sys.exception() or ConnectionError("it is lost")

    connection.skt.reconnect = refuse


@contextmanager
def _child_deaf_to_interrupt() -> Iterator[None]:
    """A process started within does not end at our Ctrl-C, after which the drive is finished."""
    is_main = threading.current_thread() is threading.main_thread()
    if sys.platform == "win32" or not is_main:
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _end(process: subprocess.Popen[bytes]) -> None:
    """Ends a process that we started, whatever it does."""
    if process.stdin is not None:
        with suppress(OSError):
            process.stdin.close()
    for tell in (None, process.terminate, process.kill):
        if tell is not None:
            tell()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_QUIT_LIMIT)
            return


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


def _is_taken(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return True
    return False
