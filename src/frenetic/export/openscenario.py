"""A drive along a road as an OpenSCENARIO 1.0 file, for simulators that play such scenarios.

The ego car starts at rest at the start of the ego lane, keeps to the speed limits and has a route
to the lane's end. The scenario ends when the car arrives or takes too long. The simulator chooses
the driver. The same road always gives the same bytes: the date that the format demands is fixed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

from frenetic._support.arrays import FloatArray
from frenetic.road import Road
from frenetic.road.profile import LIMITS, piece_of
from frenetic.simulators import Rules
from frenetic.simulators.embedded import Vehicle
from frenetic.simulators.observer import in_metres_per_second

EGO: Final = "hero"
"""Name of the ego car: the one that CARLA's tools look for."""
MODEL: Final = "vehicle.tesla.model3"
"""Name of a car's model that CARLA has; other simulators draw the car from its box and axles."""
START: Final = 2.5
"""Distance of the car from the road's start, in m; our choice: all wheels stand on the road."""
END: Final = 0.01
"""Distance of the route's goal from the road's end, in m; our choice: no lane is beyond the end."""
ACCELERATION: Final = 3.0
"""Acceleration and deceleration between speed limits, in m/s^2; our choice."""
DATE: Final = "2000-01-01T00:00:00"
"""Date in the file, which the format demands."""

_CAR_HEIGHT: Final = 1.5  # [m] height of the car's box; our choice
_WHEEL_DIAMETER: Final = 0.65  # [m]; our choice
_TRACK_MARGIN: Final = 0.2  # [m] by which the track is narrower than the car; our choice
_TOP_SPEED: Final = 70.0  # [m/s] top speed of the car; our choice


def to_openscenario(
    road: Road, road_file: str, *, name: str = "road", rules: Rules | None = None
) -> str:
    """Return the text of an OpenSCENARIO 1.0 file with a drive along a road.

    Args:
        road: the road, which `to_opendrive` writes into the OpenDRIVE file.
        road_file: path of the OpenDRIVE file, relative to the scenario's folder.
        name: name of the scenario; characters that XML cannot hold are replaced.
        rules: rules that give the speed limits, the distance from the goal at which the drive ends
            and the time limit of the drive.
    """
    rules = rules or Rules()
    # On a very short road the car starts and ends within the outer quarters.
    start, goal = min(START, 0.25 * road.length), max(road.length - END, 0.75 * road.length)
    at_once = _later_than(0.0)
    # esmini ends with the storyboard, CARLA's runner with the act.
    stop = _trigger(
        "Stop",
        {
            "at the goal": _arrived(goal, rules.goal_distance),
            "out of time": _later_than(rules.timeout(road.length)),
        },
    )
    speeds = _speeds(rules.speed_limits_on(road), start, goal)
    # The route is not in Init, where CARLA's runner takes the last position for the car's start.
    events = [
        _event("take the route", "parallel", _route(start, goal), at_once),
        *_speed_events(speeds, start),
    ]
    root = ElementTree.fromstring(  # noqa: S314  # written here
        f'''<OpenSCENARIO><FileHeader revMajor="1" revMinor="0" date="{DATE}"
        description={quoteattr(_printable(name) or "road")} author="Frenetic"/>
        <CatalogLocations/><RoadNetwork><LogicFile filepath={quoteattr(_printable(road_file))}/>
        </RoadNetwork><Entities>{_car()}</Entities><Storyboard><Init><Actions>
        <Private entityRef="{EGO}"><PrivateAction><TeleportAction>{_position(start)}
        </TeleportAction></PrivateAction><PrivateAction>{_speed(0.0, "step", 0.0)}</PrivateAction>
        </Private></Actions></Init><Story name="drive"><Act name="drive">
        <ManeuverGroup name="ego" maximumExecutionCount="1">
        <Actors selectTriggeringEntities="false"><EntityRef entityRef="{EGO}"/></Actors>
        <Maneuver name="drive">{"".join(events)}</Maneuver></ManeuverGroup>
        {_trigger("Start", {"at once": at_once})}{stop}</Act></Story>{stop}</Storyboard>
        </OpenSCENARIO>'''
    )
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _speed_events(speeds: Sequence[tuple[float, float]], start: float) -> Iterator[str]:
    """Yield an event for each change of speed; the car brakes before a lower speed begins.

    Args:
        speeds: speeds along the road, as `_speeds` returns them.
        start: where the car starts, in m along the road.
    """
    (_, speed), *changes = speeds
    speed_up = _speed(speed, "linear", speed / ACCELERATION)
    yield _event("speed up", "parallel", speed_up, _later_than(0.0))
    for distance, next_speed in changes:
        braking_distance = max(speed**2 - next_speed**2, 0.0) / (2.0 * ACCELERATION)
        change = _speed(next_speed, "linear", abs(next_speed - speed) / ACCELERATION)
        name = f"speed limit from {_number(distance)} m on"
        condition = _driven_farther_than(distance - braking_distance - start)
        yield _event(name, "overwrite", change, condition)
        speed = next_speed


def _event(name: str, priority: str, action: str, condition: str) -> str:
    """Return an event with one action, which begins when a condition holds.

    Args:
        name: name of the event.
        priority: what happens to other events: ``parallel`` or ``overwrite``.
        action: XML of the action.
        condition: XML of the condition.
    """
    return (
        f'<Event name="{name}" priority="{priority}"><Action name="{name}"><PrivateAction>{action}'
        f"</PrivateAction></Action>{_trigger('Start', {name: condition})}</Event>"
    )


def _route(start: float, goal: float) -> str:
    """Return the action that assigns the route from ``start`` to ``goal``, in m along the road."""
    waypoints = (
        f'<Waypoint routeStrategy="shortest">{_position(distance)}</Waypoint>'
        for distance in (start, goal)
    )
    return (
        '<RoutingAction><AssignRouteAction><Route name="to the goal" closed="false">'
        f"{''.join(waypoints)}</Route></AssignRouteAction></RoutingAction>"
    )


def _arrived(goal: float, tolerance: float) -> str:
    """Return the condition that the car is at most ``tolerance`` m from the goal.

    Args:
        goal: place of the goal, in m along the road.
        tolerance: largest distance, in m.
    """
    return (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{EGO}"/></TriggeringEntities><EntityCondition>'
        f'<ReachPositionCondition tolerance="{_number(tolerance)}">{_position(goal)}'
        "</ReachPositionCondition></EntityCondition></ByEntityCondition>"
    )


def _speeds(limits: FloatArray, start: float, goal: float) -> list[tuple[float, float]]:
    """Return where the car changes its speed to keep the limits: (m along the road, speed in m/s).

    On a short stretch the car is only as fast as lets it brake for the lower limit after it.

    Args:
        limits: speed limits, (k, 2) in m and km/h.
        start: first place, in m along the road.
        goal: last place, in m along the road.
    """
    steps = in_metres_per_second(piece_of(LIMITS, limits, start, goal)).tolist()
    speeds: list[tuple[float, float]] = []
    for distance, limit in reversed([(start + offset, limit) for offset, limit in steps]):
        speed = limit
        if speeds:
            next_distance, next_speed = speeds[0]
            stretch = next_distance - distance
            speed = min(limit, math.sqrt(next_speed**2 + 2.0 * ACCELERATION * stretch))
        speeds.insert(0, (distance, speed))
    return speeds


def _printable(text: str) -> str:
    """Return a text with ``?`` in place of characters that XML cannot hold."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _number(value: float) -> str:
    """Return a number with six decimals at most, as text."""
    return repr(round(value, 6) + 0.0)  # the sum turns -0.0 into 0.0


def _car() -> str:
    """Return the embedded simulator's car, measured from its rear axle as the format demands."""
    car = Vehicle()
    box_centre = car.rear_axle + car.body().centre_ahead  # [m] ahead of the rear axle
    axles = "".join(
        f'<{tag} maxSteering="{_number(steering)}" wheelDiameter="{_WHEEL_DIAMETER}"'
        f' trackWidth="{_number(car.width - _TRACK_MARGIN)}" positionX="{_number(axle_ahead)}"'
        f' positionZ="{_number(0.5 * _WHEEL_DIAMETER)}"/>'
        for tag, steering, axle_ahead in (
            ("FrontAxle", car.steering_limit, car.wheelbase),
            ("RearAxle", 0.0, 0.0),
        )
    )
    return f'''<ScenarioObject name="{EGO}"><Vehicle name="{MODEL}" vehicleCategory="car">
        <BoundingBox><Center x="{_number(box_centre)}" y="0.0" z="{_number(0.5 * _CAR_HEIGHT)}"/>
        <Dimensions width="{_number(car.width)}" length="{_number(car.length)}"
        height="{_CAR_HEIGHT}"/></BoundingBox><Performance maxSpeed="{_TOP_SPEED}"
        maxAcceleration="{_number(car.engine_acceleration)}"
        maxDeceleration="{_number(car.brake_deceleration)}"/><Axles>{axles}</Axles>
        <Properties><Property name="type" value="ego_vehicle"/></Properties></Vehicle>
        </ScenarioObject>'''  # the property is for CARLA's runner


def _position(distance: float) -> str:
    """Return the position on the ego lane's centre at a distance along the road, in m."""
    lane_position = f'<LanePosition roadId="1" laneId="-1" s="{_number(distance)}" offset="0.0"/>'
    return f"<Position>{lane_position}</Position>"


def _speed(speed: float, shape: str, seconds: float) -> str:
    """Return the action that changes the speed to ``speed`` m/s within ``seconds``.

    Args:
        speed: speed after the change, in m/s.
        shape: course of the change: ``step`` or ``linear``.
        seconds: duration of the change, in s.
    """
    return (
        f'<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="{shape}"'
        f' dynamicsDimension="time" value="{_number(seconds)}"/><SpeedActionTarget>'
        f'<AbsoluteTargetSpeed value="{_number(speed)}"/></SpeedActionTarget></SpeedAction>'
        "</LongitudinalAction>"
    )


def _trigger(kind: str, conditions: Mapping[str, str]) -> str:
    """Return a trigger that fires when any of the conditions holds.

    Args:
        kind: ``Start`` or ``Stop``.
        conditions: name of a condition -> XML of the condition.
    """
    groups = (
        f'<ConditionGroup><Condition name="{name}" delay="0.0" conditionEdge="none">{condition}'
        "</Condition></ConditionGroup>"
        for name, condition in conditions.items()
    )
    return f"<{kind}Trigger>{''.join(groups)}</{kind}Trigger>"


def _driven_farther_than(distance: float) -> str:
    """Return the condition that the car has driven more than ``distance`` m."""
    return (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{EGO}"/></TriggeringEntities><EntityCondition>'
        f'<TraveledDistanceCondition value="{_number(distance)}"/></EntityCondition>'
        "</ByEntityCondition>"
    )


def _later_than(seconds: float) -> str:
    """Return the condition that the simulated time is more than ``seconds``."""
    condition = f'<SimulationTimeCondition value="{_number(seconds)}" rule="greaterThan"/>'
    return f"<ByValueCondition>{condition}</ByValueCondition>"
