"""A drive along a road as an OpenSCENARIO 1.0 file, for simulators that play such scenarios.

The ego car stands at the start of the ego lane, keeps to the speed limits, has a route to the
lane's end, and the scenario ends when the car is there or takes too long. The simulator chooses the
driver. The same road always gives the same bytes; the date, which the format demands, is fixed.
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
"""Name of the ego car, which CARLA's tools look for."""
MODEL: Final = "vehicle.tesla.model3"
"""Name of the car's model, which CARLA has; other simulators draw a car by its box and axles."""
START: Final = 2.5
"""Distance of the car from the road's start, in m; ours: all wheels stand on the road."""
END: Final = 0.01
"""Distance of the route's goal from the road's end, in m; ours: beyond the end is no lane."""
ACCELERATION: Final = 3.0
"""Acceleration to the speed limit, in m/s^2; ours."""
DATE: Final = "2000-01-01T00:00:00"
"""Date in the file, which the format demands."""

_HEIGHT: Final = 1.5  # [m] height of the car's box; ours
_WHEEL: Final = 0.65  # [m] diameter of a wheel; ours
_MAX_SPEED: Final = 70.0  # [m/s] top speed of the car; ours


def to_openscenario(
    road: Road, road_file: str, *, name: str = "road", rules: Rules | None = None
) -> str:
    """Return an OpenSCENARIO 1.0 file that drives along a road of `to_opendrive`, as text.

    Args:
        road: the road in the OpenDRIVE file.
        road_file: name of that file, seen from the scenario's folder.
        name: name of the scenario; characters that XML cannot hold are replaced.
        rules: rules with the speed limits, the distance from the goal at which the drive ends, and
            the longest time of a drive.
    """
    rules = rules or Rules()
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
    """Yield an event for each of the `_speeds`; for a lower limit, the car brakes before it."""
    (_, before), *changes = speeds
    speed_up = _speed(before, "linear", before / ACCELERATION)
    yield _event("speed up", "parallel", speed_up, _later_than(0.0))
    for place, after in changes:
        braking = max(before**2 - after**2, 0.0) / (2.0 * ACCELERATION)
        change = _speed(after, "linear", abs(after - before) / ACCELERATION)
        name = f"speed limit from {_number(place)} m on"
        yield _event(name, "overwrite", change, _driven_farther_than(place - braking - start))
        before = after


def _event(name: str, priority: str, action: str, condition: str) -> str:
    """Return an event with one action, which a condition starts."""
    return (
        f'<Event name="{name}" priority="{priority}"><Action name="{name}"><PrivateAction>{action}'
        f"</PrivateAction></Action>{_trigger('Start', {name: condition})}</Event>"
    )


def _route(start: float, goal: float) -> str:
    """Return the action that assigns the route between two places along the road, in m."""
    waypoints = (
        f'<Waypoint routeStrategy="shortest">{_position(place)}</Waypoint>'
        for place in (start, goal)
    )
    return (
        '<RoutingAction><AssignRouteAction><Route name="to the goal" closed="false">'
        f"{''.join(waypoints)}</Route></AssignRouteAction></RoutingAction>"
    )


def _arrived(goal: float, tolerance: float) -> str:
    """Return the condition that the car is near the goal, in m along the road."""
    return (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{EGO}"/></TriggeringEntities><EntityCondition>'
        f'<ReachPositionCondition tolerance="{_number(tolerance)}">{_position(goal)}'
        "</ReachPositionCondition></EntityCondition></ByEntityCondition>"
    )


def _speeds(limits: FloatArray, start: float, goal: float) -> list[tuple[float, float]]:
    """Return the speeds that keep limits between two places: each from m along the road, in m/s.

    On a short stretch, the car drives no faster than it can brake to the limit behind it.

    Args:
        limits: speed limits, (k, 2) in m and km/h.
        start: first place, in m along the road.
        goal: last place, in m along the road.
    """
    steps = in_metres_per_second(piece_of(LIMITS, limits, start, goal)).tolist()
    speeds: list[tuple[float, float]] = []
    for place, limit in reversed([(start + place, limit) for place, limit in steps]):
        if speeds:
            end, after = speeds[0]
            limit = min(limit, math.sqrt(after**2 + 2.0 * ACCELERATION * (end - place)))
        speeds.insert(0, (place, limit))
    return speeds


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _number(value: float) -> str:
    return repr(round(value, 6) + 0.0)


def _car() -> str:
    """Return the embedded simulator's car, measured from its rear axle as the format demands."""
    car = Vehicle()
    ahead = car.rear_axle + car.body().centre_ahead
    axles = "".join(
        f'<{tag} maxSteering="{_number(steering)}" wheelDiameter="{_WHEEL}"'
        f' trackWidth="{_number(car.width - 0.2)}" positionX="{_number(place)}"'
        f' positionZ="{_number(0.5 * _WHEEL)}"/>'
        for tag, steering, place in (
            ("FrontAxle", car.steering_limit, car.wheelbase),
            ("RearAxle", 0.0, 0.0),
        )
    )
    return f'''<ScenarioObject name="{EGO}"><Vehicle name="{MODEL}" vehicleCategory="car">
        <BoundingBox><Center x="{_number(ahead)}" y="0.0" z="{_number(0.5 * _HEIGHT)}"/>
        <Dimensions width="{_number(car.width)}" length="{_number(car.length)}"
        height="{_HEIGHT}"/></BoundingBox><Performance maxSpeed="{_MAX_SPEED}"
        maxAcceleration="{_number(car.engine_acceleration)}"
        maxDeceleration="{_number(car.brake_deceleration)}"/><Axles>{axles}</Axles>
        <Properties><Property name="type" value="ego_vehicle"/></Properties></Vehicle>
        </ScenarioObject>'''  # the property is for CARLA's runner


def _position(distance: float) -> str:
    """Return a place on the centre of the ego lane, in m along the road."""
    place = f'<LanePosition roadId="1" laneId="-1" s="{_number(distance)}" offset="0.0"/>'
    return f"<Position>{place}</Position>"


def _speed(speed: float, shape: str, seconds: float) -> str:
    return (
        f'<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="{shape}"'
        f' dynamicsDimension="time" value="{_number(seconds)}"/><SpeedActionTarget>'
        f'<AbsoluteTargetSpeed value="{_number(speed)}"/></SpeedActionTarget></SpeedAction>'
        "</LongitudinalAction>"
    )


def _trigger(kind: str, conditions: Mapping[str, str]) -> str:
    """Return a trigger that any of the conditions fires, by their names."""
    groups = (
        f'<ConditionGroup><Condition name="{name}" delay="0.0" conditionEdge="none">{condition}'
        "</Condition></ConditionGroup>"
        for name, condition in conditions.items()
    )
    return f"<{kind}Trigger>{''.join(groups)}</{kind}Trigger>"


def _driven_farther_than(distance: float) -> str:
    return (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{EGO}"/></TriggeringEntities><EntityCondition>'
        f'<TraveledDistanceCondition value="{_number(distance)}"/></EntityCondition>'
        "</ByEntityCondition>"
    )


def _later_than(seconds: float) -> str:
    condition = f'<SimulationTimeCondition value="{_number(seconds)}" rule="greaterThan"/>'
    return f"<ByValueCondition>{condition}</ByValueCondition>"
