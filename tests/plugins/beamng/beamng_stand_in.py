"""A stand-in for BeamNG.tech: it speaks BeamNGpy's protocol and moves the car by our own physics.

It listens on the loopback only. It knows the messages that BeamNGpy 1.36 sends, and answers other
messages with an error, as BeamNG.tech does. Like BeamNG.tech it

- has a clock of its own, which goes on through all scenarios,
- holds the car for 1.5 s of simulated time after a scenario has started,
- gives the car's position by a node that is not the middle of its box,
- counts steering to the right as positive,
- lets its own driver move only on roads with a drivability and to waypoints that exist.

As a program (``python beamng_stand_in.py -tport PORT``) it serves one client until it is told to
quit, so that it can be launched in place of BeamNG.tech.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import socketserver
import struct
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import msgpack
import numpy as np

from frenetic.simulators import Vehicle
from frenetic.simulators.embedded.rollout import STEP
from frenetic.simulators.embedded.single_track import (
    HEADING,
    LATERAL_SPEED,
    SPEED,
    STATE_SIZE,
    STEERING,
    YAW_RATE,
    X,
    Y,
    advance,
)

Message = dict[str, Any]

PROTOCOL: Final = "v1.27"
FREEZE: Final = 1.5
"""Time after a scenario's start in which the car is held, in s."""
NODE_AHEAD, NODE_LEFT = 0.35, -0.12
"""Distances by which the car's position lies ahead and left of the middle of its box, in m."""
LEVELS: Final = ("gridmap_v2", "smallgrid", "tech_ground")
VEHICLES: Final = ("etk800", "pickup")
DROP, HANG = "drop", "hang"
"""Faults: the connection ends, or no answer comes any more."""

Fault = Callable[[str, int], str | None]
"""Function of a message's type and its number among the messages of this type, from 1. It returns
DROP, HANG, the text of an error to answer with, or None."""


def no_fault(_type: str, _number: int) -> str | None:
    return None


@dataclass
class Car:
    """The vehicle in a scenario."""

    vid: str
    model: str
    state: np.ndarray[Any, np.dtype[np.float64]]
    port: int = 0
    steering: float = 0.0  # -1..1, positive to the right
    throttle: float = 0.0
    brake: float = 0.0
    parking: float = 0.0
    ai_speed: float = 0.0
    ai_in_lane: bool = False
    ai_target: str | None = None


@dataclass
class Scenario:
    """A scenario that a client had built."""

    level: str
    roads: list[Message]
    waypoints: set[str]
    car: Car
    spawned: str
    started_at: float | None = None


@dataclass
class World:
    """The simulation."""

    vehicle: Vehicle = field(default_factory=Vehicle)
    sign_shown: float = 1.0
    """Sign of `steering_input` in the electrics for a positive input; 0 if they lack it."""
    draws: bool = True
    """Whether a camera gives pictures."""
    camera: Message = field(default_factory=dict)
    """The message that opened it."""
    clock_error: float = 0.0
    """Share by which the clock is too fast, 0.1 for 10 %."""
    scenarios: dict[str, Scenario] = field(default_factory=dict)
    loaded: Scenario | None = None
    frames: int = 0
    fps: int = 0
    ticks: int = 0
    was_reversing: bool = False
    """Whether the brake was pressed at rest, upon which the gearbox reverses."""
    _time: float = 1000.0

    @property
    def time(self) -> float:
        return self._time + (1.0 + self.clock_error) * (self.frames / self.fps if self.fps else 0)

    def set_rate(self, fps: int) -> None:
        self._time, self.frames, self.ticks, self.fps = self.time, 0, 0, fps

    def create(self, level: str, name: str, prefab: str) -> str:
        objects = [
            json.loads(re.sub(r",(\s*[\]}])", r"\1", line)) for line in prefab.split("\n") if line
        ]
        of = {
            kind: [o for o in objects if o["class"] == kind]
            for kind in {o["class"] for o in objects}
        }
        (vehicle,) = of["BeamNGVehicle"]
        m = vehicle["rotationMatrix"]
        heading = math.atan2(-m[4], -m[3])  # its nose points to -y in its own frame
        x, y, _ = vehicle["position"]
        state = np.zeros(STATE_SIZE)
        c, s = math.cos(heading), math.sin(heading)
        state[X] = x - NODE_AHEAD * c + NODE_LEFT * s
        state[Y] = y - NODE_AHEAD * s - NODE_LEFT * c
        state[HEADING] = heading
        path = f"/levels/{level}/scenarios/{name}/{name}.json"
        self.scenarios[path] = Scenario(
            level,
            of["DecalRoad"],
            {o["name"] for o in of.get("BeamNGWaypoint", [])},
            Car(vehicle["name"], vehicle["jBeam"], state),
            vehicle["spawnAutoplace"],
        )
        return path

    @property
    def car(self) -> Car:
        assert self.loaded is not None
        return self.loaded.car

    def step(self, count: int) -> None:
        for _ in range(count):
            self.frames += 1
            due = self.frames * round(1.0 / STEP) // self.fps
            while self.ticks < due:
                self._tick()
                self.ticks += 1

    def _tick(self) -> None:
        if self.loaded is None or self.loaded.started_at is None:
            return
        if self.time - self.loaded.started_at < FREEZE:
            return
        car, parameters = self.car, self.vehicle.to_array()
        if self.ticks % 5 == 0 and car.ai_target is not None:
            self._let_ai_decide(car)
        brake = max(car.brake, car.parking)
        at_rest = abs(car.state[SPEED]) < 0.05
        if at_rest and car.brake > 0.1 and car.parking == 0.0 and car.throttle == 0.0:
            self.was_reversing = True
        angle = -car.steering * self.vehicle.steering_limit
        inputs = np.array([[angle, car.throttle, brake]])
        only_car = np.zeros(1, np.int64)
        advance(car.state[np.newaxis], inputs, parameters[np.newaxis], only_car, STEP, 1)

    def _let_ai_decide(self, car: Car) -> None:
        """Steer for a point of the lane, at least 6 m ahead, at 10 m/s or the limit."""
        assert self.loaded is not None
        (road,) = (road for road in self.loaded.roads if road["drivability"] > 0)
        nodes = np.array(road["nodes"])
        along = np.gradient(nodes[:, :2], axis=0)
        along /= np.linalg.norm(along, axis=1)[:, None]
        lane = nodes[:, :2] + 0.25 * nodes[0, 3] * along[:, ::-1] * [1.0, -1.0]
        x, y, heading, speed = car.state[: SPEED + 1]
        away = np.hypot(*(lane - (x, y)).T)
        nearest = int(away.argmin())
        i = next((k for k in range(nearest, len(lane)) if away[k] > 6.0), len(lane) - 1)
        turn = math.atan2(lane[i, 1] - y, lane[i, 0] - x) - heading
        angle = math.atan(2.0 * self.vehicle.wheelbase * math.sin(turn) / away[i])
        car.steering = -angle / self.vehicle.steering_limit
        missing = min(car.ai_speed, 10.0) - speed
        car.throttle, car.brake = min(max(missing, 0.0), 1.0), min(max(-missing, 0.0), 1.0)

    def start(self) -> None:
        assert self.loaded is not None
        self.loaded.started_at = self.time

    # What the client reads

    def vehicle_state(self) -> Message:
        state = self.car.state
        c, s = math.cos(state[HEADING]), math.sin(state[HEADING])
        vx = c * state[SPEED] - s * state[LATERAL_SPEED]
        vy = s * state[SPEED] + c * state[LATERAL_SPEED]
        away = (NODE_AHEAD * c - NODE_LEFT * s, NODE_AHEAD * s + NODE_LEFT * c)
        return {
            "time": self.time,
            "pos": [float(state[X] + away[0]), float(state[Y] + away[1]), 0.3],
            "dir": [c, s, 0.0],
            "up": [0.0, 0.0, 1.0],
            "vel": [
                float(vx - state[YAW_RATE] * away[1]),
                float(vy + state[YAW_RATE] * away[0]),
                0.0,
            ],
            "front": [0.0, 0.0, 0.0],
            "rotation": [0.0, 0.0, 0.0, 1.0],
        }

    def electrics(self) -> Message:
        car = self.car
        angle = float(car.state[STEERING])
        return {
            "steering": -math.degrees(angle) * 16.0,
            "steering_input": -self.sign_shown * angle / self.vehicle.steering_limit,
            "throttle_input": car.throttle,
            "brake_input": car.brake,
            "wheelspeed": float(car.state[SPEED]),
        }

    def box(self) -> list[list[float]]:
        """Return the corners of the car's box: front right, front left, rear right, rear left."""
        state, body = self.car.state, self.vehicle.body()
        c, s = math.cos(state[HEADING]), math.sin(state[HEADING])

        def corner(ahead: float, left: float, up: float) -> list[float]:
            a, b = 0.5 * body.length * ahead, 0.5 * body.width * left
            return [float(state[X] + a * c - b * s), float(state[Y] + a * s + b * c), up]

        places = [(-1, 0.2), (-1, 1.6), (1, 1.6), (1, 0.2)]
        return [corner(end, side, up) for end in (1, -1) for side, up in places]


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = os.name == "posix"
    daemon_threads = True
    block_on_close = False


class StandIn:
    """Server at a port of the loopback, with the messages that it received, in order."""

    def __init__(
        self,
        *,
        port: int = 0,
        protocol: str = PROTOCOL,
        is_licensed: bool = True,
        fault: Fault = no_fault,
        world: World | None = None,
    ) -> None:
        self.world = world or World()
        self.protocol = protocol
        self.is_licensed = is_licensed
        self.fault = fault
        self.received: list[tuple[str, Message]] = []
        self.has_quit = threading.Event()
        self._counts: Counter[str] = Counter()
        self._lock = threading.RLock()
        stand_in = self

        class Handler(socketserver.StreamRequestHandler):
            disable_nagle_algorithm = True

            def handle(self) -> None:
                with suppress(OSError, struct.error):
                    while stand_in._talk(self.rfile, self.wfile):
                        pass

        self._server = _Server(("127.0.0.1", port), Handler)
        self.port = int(self._server.server_address[1])
        threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self.has_quit.set()
        self._server.shutdown()
        self._server.server_close()

    def types(self) -> list[str]:
        return [kind for kind, _ in self.received]

    def _talk(self, incoming: Any, outgoing: Any) -> bool:
        """Answer a message; return whether the connection goes on."""
        (length,) = struct.unpack("!I", incoming.read(4))
        request = msgpack.unpackb(incoming.read(length), raw=False)
        number, kind = request.pop("_id"), request["type"]
        with self._lock:
            self.received.append((kind, request))
            self._counts[kind] += 1
            fault = self.fault(kind, self._counts[kind])
        if fault == HANG:
            self.has_quit.wait()
        if fault in (DROP, HANG) or self.has_quit.is_set():
            return False
        with self._lock:
            answer = self._answer(request) if fault is None else {"bngError": fault}
        data = msgpack.packb({"_id": number, "type": kind} | answer, use_bin_type=True)
        outgoing.write(struct.pack("!I", len(data)) + data)
        if kind == "Quit":
            self.has_quit.set()
        return not self.has_quit.is_set()

    def _answer(self, request: Message) -> Message:
        world = self.world
        match request["type"]:
            case "Hello":
                return {"protocolVersion": self.protocol}
            case "GetSystemInfo":
                return {"os": {"type": "linux"}, "tech": self.is_licensed}
            case "GetEnvironmentPaths":
                return {"home": "/opt/stand-in/", "user": "/home/stand-in/0.39/"}
            case "GetLevels":
                return {"result": [{"levelName": name, "title": name} for name in LEVELS]}
            case "GetAvailableVehicles":
                vehicles = {name: {"name": name} for name in VEHICLES}
                return {"type": "AvailableVehicles", "vehicles": vehicles}
            case "CreateScenario":
                path = world.create(request["level"], request["name"], request["prefab"])
                return {"result": path}
            case "DeleteScenario":
                del world.scenarios[request["path"]]
                return {}
            case "LoadScenario":
                world.loaded = world.scenarios[request["path"]]
                return {"type": "MapLoaded"}
            case "GetCurrentVehicles":
                car = world.car
                return {"result": {car.vid: {"id": 1, "name": car.vid, "model": car.model}}}
            case "GetPlayerVehicleID":
                return {"type": "getPlayerVehicleID", "id": 1, "vid": world.car.vid}
            case "StartVehicleConnection":
                return {"vid": request["vid"], "result": self.port}
            case "FPSLimit":
                world.set_rate(request["fps"])
                return {"type": "SetFPSLimit"}
            case "Pause":
                return {"type": "Paused"}
            case "StartScenario":
                world.start()
                return {"type": "ScenarioStarted"}
            case "StopScenario":
                world.loaded = None
                return {"type": "ScenarioStopped"}
            case "Step":
                world.step(request["count"])
                return {"type": "Stepped"}
            case "OpenCamera":
                world.camera = request
                return {"type": "OpenedCamera"}
            case "PollCamera":
                width, height = world.camera["size"]
                picture = bytes(range(4)) * (width * height)
                return {"data": {"colour": picture} if world.draws else {}}
            case "CloseCamera":
                return {"type": "ClosedCamera"}
            case "GetBBoxCorners":
                return {"type": "BBoxCorners", "points": world.box()}
            case "SetPhysicsDeterministic" | "Quit":
                return {}
            case "SensorRequest":
                return {"type": "SensorData", "data": self._sensors(request["sensors"])}
            case "Control":
                car = world.car
                for attribute, entry in _CONTROLS.items():
                    if entry in request:
                        setattr(car, attribute, float(request[entry]))
                return {"type": "Controlled"}
            case "QueueLuaCommandVE":
                event = re.fullmatch(r"input\.event\('steering', (\S+), 2\)", request["chunk"])
                assert event is not None, request
                world.car.steering = float(event[1])
                return {"type": "ExecutedLuaChunkVE"}
            case "SetAiSpeed":
                world.car.ai_speed = request["speed"]
                return {"type": "AiSpeedSet"}
            case "SetAiAggression":
                return {"type": "AiAggressionSet"}
            case "SetDriveInLane":
                world.car.ai_in_lane = request["lane"] == "on"
                return {"type": "AiDriveInLaneSet"}
            case "SetAiMode":
                return {"type": "AiModeSet"}
            case "SetAiWaypoint":
                # In BeamNG.tech, too, an unknown target is no error: the car stands still.
                assert world.loaded is not None
                known = request["target"] in world.loaded.waypoints
                world.car.ai_target = request["target"] if known and world.car.ai_in_lane else None
                return {"type": "AiWaypointSet"}
            case kind:
                return {"bngError": f"No such message: {kind}"}

    def _sensors(self, sensors: dict[str, Message]) -> Message:
        data: Message = {}
        for name, sensor in sensors.items():
            if sensor["type"] == "State":
                data[name] = {"type": "VehicleUpdate", "state": self.world.vehicle_state()}
            elif sensor["type"] == "Electrics":
                data[name] = {"type": "Electrics", "values": self.world.electrics()}
        return data


_CONTROLS: Final = {
    "throttle": "throttle",
    "brake": "brake",
    "parking": "parkingbrake",
}


def program(home: Path) -> Path:
    """Make a folder look like an installation whose program is the stand-in; return the program.

    Linux only. The program runs without compiled code, which takes longer to load than to drive.
    """
    path = home / "BinLinux" / "BeamNG.tech.x64"
    path.parent.mkdir(parents=True)
    serve = f'exec "{sys.executable}" "{Path(__file__).resolve()}" "$@"'
    path.write_text(f"#!/bin/sh\nNUMBA_DISABLE_JIT=1 {serve}\n")
    path.chmod(0o755)
    return path


def main(arguments: list[str]) -> None:
    port = int(arguments[arguments.index("-tport") + 1])
    with StandIn(port=port) as server:
        signal.signal(signal.SIGTERM, lambda *_: server.has_quit.set())
        server.has_quit.wait()
        time.sleep(0.05)  # for the answer to be read


if __name__ == "__main__":
    main(sys.argv[1:])
