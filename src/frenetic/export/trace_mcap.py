"""A trace as an MCAP file, for Foxglove, PlotJuggler and others.

All messages are JSON, with JSON schemas; their times are the simulated time.

| topic | schema | message |
| --- | --- | --- |
| ``/drive`` | ``frenetic.Drive`` | each record: the columns of the trace, without missing values |
| ``/events`` | ``foxglove.Log`` | each event |
| ``/scene`` | ``foxglove.SceneUpdate`` | once: the lane's edges, the path, and the car's box |
| ``/tf`` | ``foxglove.FrameTransform`` | each record: where the frame ``car`` is on the ``map`` |
| ``/plan`` | ``foxglove.SceneUpdate`` | each plan that the driver shows, if it shows any |

The box belongs to the frame ``car``, so it moves with it. The metadata ``frenetic`` holds outcome
and reason of the drive, its conditions, the car's box and the units.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import IO, Any, Final

import numpy as np
from mcap.writer import Writer
from msgspec.json import encode

from frenetic._support.arrays import FloatArray
from frenetic.export.column import TableColumn
from frenetic.export.trace_columns import field_name, number_text
from frenetic.export.traces import DriveTrace, TraceEvent

MAP, CAR = "map", "car"
"""Frames: the map, with the trace's x and y, and the car's centre of mass."""
DRIVE, EVENTS, SCENE, TRANSFORMS, PLAN = "/drive", "/events", "/scene", "/tf", "/plan"
"""Topics."""
_CAR_HEIGHT: Final = 1.5  # [m] of the car's box (our choice)
_INFO, _WARNING, _ERROR = 2, 3, 4
"""Levels of messages in Foxglove's log."""
_LINE_WIDTH: Final = 0.15  # [m] of the lane's edges (our choice)
_WHITE, _BLUE, _ORANGE = (
    {"r": r, "g": g, "b": b, "a": 1.0}
    for r, g, b in ((1.0, 1.0, 1.0), (0.2, 0.5, 1.0), (1.0, 0.55, 0.1))
)

# Schemas

_Schema = dict[str, Any]
_NUMBER: Final[_Schema] = {"type": "number"}
_INTEGER: Final[_Schema] = {"type": "integer"}
_TEXT: Final[_Schema] = {"type": "string"}
_TRUTH: Final[_Schema] = {"type": "boolean"}


def _object(title: str = "", **properties: _Schema) -> _Schema:
    """Return the schema of an object."""
    return {"type": "object", "properties": properties, **({"title": title} if title else {})}


def _list(items: _Schema) -> _Schema:
    """Return the schema of a list."""
    return {"type": "array", "items": items}


_TIME: Final = _object(sec=_INTEGER, nsec=_INTEGER)
_VECTOR: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE: Final = _object(position=_VECTOR, orientation=_QUATERNION)
_COLOUR: Final = _object(r=_NUMBER, g=_NUMBER, b=_NUMBER, a=_NUMBER)
_LINE: Final = _object(
    type=_INTEGER,
    pose=_POSE,
    thickness=_NUMBER,
    scale_invariant=_TRUTH,
    points=_list(_VECTOR),
    color=_COLOUR,
)
_ENTITY: Final = _object(
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_TIME,
    frame_locked=_TRUTH,
    cubes=_list(_object(pose=_POSE, size=_VECTOR, color=_COLOUR)),
    lines=_list(_LINE),
)
_FOXGLOVE: Final[Mapping[str, _Schema]] = MappingProxyType(
    {
        EVENTS: _object("foxglove.Log", timestamp=_TIME, level=_INTEGER, message=_TEXT, name=_TEXT),
        SCENE: _object(
            "foxglove.SceneUpdate",
            deletions=_list(_object(timestamp=_TIME, type=_INTEGER, id=_TEXT)),
            entities=_list(_ENTITY),
        ),
        TRANSFORMS: _object(
            "foxglove.FrameTransform",
            timestamp=_TIME,
            parent_frame_id=_TEXT,
            child_frame_id=_TEXT,
            translation=_VECTOR,
            rotation=_QUATERNION,
        ),
    }
)
"""Topic -> schema, as Foxglove names and defines it; fields that we leave empty are left out."""


def _drive_schema(columns: Sequence[TableColumn]) -> _Schema:
    """Return the schema of the messages of ``/drive``: a number for each column."""
    properties = {
        field_name(column): {
            **_NUMBER,
            "description": f"{column.about}{f', in {column.unit}' if column.unit else ''}",
        }
        for column in columns
    }
    return _object("frenetic.Drive", **properties)


# Messages


def write_messages(trace: DriveTrace, file: IO[bytes]) -> None:
    """Write a trace into an open file.

    Args:
        trace: the trace.
        file: the file, which stays open.

    Raises:
        OSError: the file cannot be written.
    """
    writer = Writer(file)
    writer.start()
    channels = {
        topic: _register(writer, topic, schema)
        for topic, schema in ((DRIVE, _drive_schema(trace.columns)), *_FOXGLOVE.items())
    }
    if trace.plans:
        channels[PLAN] = _register(writer, PLAN, _FOXGLOVE[SCENE])
    writer.add_metadata("frenetic", _metadata(trace))
    for time, topic, message in _messages(trace):
        nanoseconds = _nanoseconds(time)
        writer.add_message(channels[topic], nanoseconds, encode(message), nanoseconds)
    writer.finish()  # type: ignore[no-untyped-call]


def _register(writer: Writer, topic: str, schema: _Schema) -> int:
    """Register a topic with its schema; return the number of its channel."""
    schema_id = writer.register_schema(schema["title"], "jsonschema", encode(schema))
    return writer.register_channel(topic, "json", schema_id)


def _metadata(trace: DriveTrace) -> dict[str, str]:
    """Return what holds for the whole trace, as texts."""
    units = {field_name(column): column.unit for column in trace.columns if column.unit}
    return {
        "outcome": str(trace.result.outcome),
        "reason": trace.result.reason,
        "conditions": json.dumps(dict(trace.conditions)),
        "car": json.dumps(asdict(trace.car)),
        "units": json.dumps(units, ensure_ascii=False),
    }


def _messages(trace: DriveTrace) -> Iterator[tuple[float, str, dict[str, Any]]]:
    """Yield time, topic and content of the messages, in the order of time."""
    names = [field_name(column) for column in trace.columns]
    times = trace.column("time").tolist()
    poses = zip(
        *(trace.column(name).tolist() for name in ("x", "y", "heading")),
        trace.heights.tolist(),
        strict=True,
    )
    yield times[0], SCENE, _scene(trace, times[0])
    events, plans = list(trace.events), list(trace.plans)
    for time, row, (x, y, heading, height) in zip(
        times, trace.values.T.tolist(), poses, strict=True
    ):
        while events and events[0].time < time:
            yield events[0].time, EVENTS, _log(events.pop(0))
        while plans and plans[0][0] <= time:
            yield plans[0][0], PLAN, _plan(*plans.pop(0))
        fields = zip(names, row, strict=True)
        yield time, DRIVE, {name: float(number_text(v)) for name, v in fields if v == v}
        yield (
            time,
            TRANSFORMS,
            {
                "timestamp": _stamp(time),
                "parent_frame_id": MAP,
                "child_frame_id": CAR,
                "translation": {"x": x, "y": y, "z": height},
                "rotation": _turned(heading),
            },
        )
    for event in events:
        yield event.time, EVENTS, _log(event)


def _nanoseconds(time: float) -> int:
    """Return a time in ns; a file holds no times before 0."""
    return max(round(time * 1e9), 0)


def _stamp(time: float) -> dict[str, int]:
    """Return a time as Foxglove's messages hold it."""
    seconds, nanoseconds = divmod(_nanoseconds(time), 10**9)
    return {"sec": seconds, "nsec": nanoseconds}


def _turned(heading: float) -> dict[str, float]:
    """Return a heading in rad as a quaternion."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * heading), "w": math.cos(0.5 * heading)}


def _log(event: TraceEvent) -> dict[str, Any]:
    """Return an event as a message of the log."""
    level = {"end": _INFO, "mistake": _WARNING}.get(event.name, _ERROR)
    message = event.text if event.distance is None else f"{event.text} [{event.distance:.1f} m]"
    return {
        "timestamp": _stamp(event.time),
        "level": level,
        "message": message,
        "name": event.name,
    }


def _scene(trace: DriveTrace, time: float) -> dict[str, Any]:
    """Return the message with the lane's edges, the path and the car's box."""
    path = zip(trace.column("x"), trace.column("y"), trace.heights, strict=True)
    box = {
        "pose": {
            "position": {"x": trace.car.centre_ahead, "y": 0.0, "z": 0.5 * _CAR_HEIGHT},
            "orientation": _turned(0.0),
        },
        "size": {"x": trace.car.length, "y": trace.car.width, "z": _CAR_HEIGHT},
        "color": _ORANGE,
    }
    return {
        "deletions": [],
        "entities": [
            _entity("lane", time, lines=[_line(trace.lane.left), _line(trace.lane.right)]),
            _entity("path", time, lines=[_line(path, _BLUE)]),
            _entity("car", time, frame=CAR, cubes=[box]),
        ],
    }


def _plan(time: float, points: FloatArray) -> dict[str, Any]:
    """Return the message with a driver's plan, which replaces the plan before."""
    line = _line(np.column_stack([points, np.zeros(len(points))]), _ORANGE)
    return {"deletions": [], "entities": [_entity("plan", time, frame=CAR, lines=[line])]}


def _entity(
    name: str,
    time: float,
    *,
    frame: str = MAP,
    lines: Sequence[Mapping[str, Any]] = (),
    cubes: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Return a thing of the scene, which stays to the end."""
    return {
        "timestamp": _stamp(time),
        "frame_id": frame,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": True,
        "cubes": list(cubes),
        "lines": list(lines),
    }


def _line(points: Any, colour: Mapping[str, float] = _WHITE) -> dict[str, Any]:
    """Return a line through points, each x, y and z in m."""
    return {
        "type": 0,
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": _turned(0.0)},
        "thickness": _LINE_WIDTH,
        "scale_invariant": False,
        "points": [{"x": float(x), "y": float(y), "z": float(z)} for x, y, z in points],
        "color": colour,
    }
