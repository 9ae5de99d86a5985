"""A drive along a road as an OpenSCENARIO 1.0 file, for simulators that play such scenarios.

The ego car stands at the start of the ego lane, keeps to the speed limits, has a route to the
lane's end, and the scenario ends when it is there or takes too long. Who steers is up to the
simulator. The same road always gives the same bytes; the date, which the format demands, is fixed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
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
"""Name of the car's model, which CARLA has; others make their own of the box and axles."""
START: Final = 2.5
"""Distance of the car from the road's start, in m, so that all its wheels are on the road."""
END: Final = 0.01
"""Distance of the route's goal from the road's end, in m; beyond the end there is no lane."""
ACCELERATION: Final = 3.0
"""Acceleration to the speed limit, in m/s^2."""
DATE: Final = "2000-01-01T00:00:00"

_HEIGHT: Final = 1.5  # m, of the car's box
_WHEEL: Final = 0.65  # m, diameter
_MAX_SPEED: Final = 70.0  # m/s


def to_openscenario(
    road: Road, road_file: str, *, name: str = "road", rules: Rules | None = None
) -> str:
    """The text of an OpenSCENARIO 1.0 file that drives along a road of `to_opendrive`.

    Args:
        road: the road in the OpenDRIVE file.
        road_file: name of that file, as seen from the scenario's folder.
        name: of the scenario; characters that XML cannot hold are replaced.
        rules: the speed limit, how near the goal counts as there, and how long a drive may take.
    """
    rules = rules or Rules()
    start, goal = min(START, 0.25 * road.length), max(road.length - END, 0.75 * road.length)
    (_, speed), *changes = _speeds(rules.speed_limits_on(road), start, goal)
    at_once = _later_than(0.0)
    arrived = (
        '<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any">'
        f'<EntityRef entityRef="{EGO}"/></TriggeringEntities><EntityCondition>'
        f'<ReachPositionCondition tolerance="{_number(rules.goal_distance)}">{_position(goal)}'
        "</ReachPositionCondition></EntityCondition></ByEntityCondition>"
    )
    # esmini ends with the storyboard, CARLA's runner with the act.
    stop = _trigger(
        "Stop", {"at the goal": arrived, "out of time": _later_than(rules.timeout(road.length))}
    )
    waypoints = (
        f'<Waypoint routeStrategy="shortest">{_position(place)}</Waypoint>'
        for place in (start, goal)
    )
    # Not in Init, where CARLA's runner takes the last position of all for the car's start.
    route = (
        '<RoutingAction><AssignRouteAction><Route name="to the goal" closed="false">'
        f"{''.join(waypoints)}</Route></AssignRouteAction></RoutingAction>"
    )
    events = {
        "take the route": ("parallel", route, at_once),
        "speed up": ("parallel", _speed(speed, "linear", speed / ACCELERATION), at_once),
    }
    before = speed
    for place, after in changes:
        # To a lower limit it brakes before.
        braking = max(before**2 - after**2, 0.0) / (2.0 * ACCELERATION)
        change = _speed(after, "linear", abs(after - before) / ACCELERATION)
        name = f"speed limit from {_number(place)} m on"
        events[name] = "overwrite", change, _driven_farther_than(place - braking - start)
        before = after
    maneuver = "".join(
        f'<Event name="{name}" priority="{priority}"><Action name="{name}"><PrivateAction>{action}'
        f"</PrivateAction></Action>{_trigger('Start', {name: condition})}</Event>"
        for name, (priority, action, condition) in events.items()
    )
    root = ElementTree.fromstring(  # noqa: S314  # our own
        f'''<OpenSCENARIO><FileHeader revMajor="1" revMinor="0" date="{DATE}"
        description={quoteattr(_printable(name) or "road")} author="Frenetic"/>
        <CatalogLocations/><RoadNetwork><LogicFile filepath={quoteattr(_printable(road_file))}/>
        </RoadNetwork><Entities>{_car()}</Entities><Storyboard><Init><Actions>
        <Private entityRef="{EGO}"><PrivateAction><TeleportAction>{_position(start)}
        </TeleportAction></PrivateAction><PrivateAction>{_speed(0.0, "step", 0.0)}</PrivateAction>
        </Private></Actions></Init><Story name="drive"><Act name="drive">
        <ManeuverGroup name="ego" maximumExecutionCount="1">
        <Actors selectTriggeringEntities="false"><EntityRef entityRef="{EGO}"/></Actors>
        <Maneuver name="drive">{maneuver}</Maneuver></ManeuverGroup>
        {_trigger("Start", {"at once": at_once})}{stop}</Act></Story>{stop}</Storyboard>
        </OpenSCENARIO>'''
    )
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _speeds(limits: FloatArray, start: float, goal: float) -> list[tuple[float, float]]:
    """The speeds that keep limits between two places: m along the road and m/s, from there on.

    A short stretch is driven no faster than the car can brake to the limit behind it.

    Args:
        limits: (k, 2) in m and km/h.
        start: m.
        goal: m.
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
    """The embedded simulator's car, measured from its rear axle as the format wants it."""
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
    """A place on the centre of the ego lane."""
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
    """A trigger of conditions each of which suffices on its own, by their names."""
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
