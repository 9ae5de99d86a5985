"""A drive along a road as an OpenSCENARIO 1.0 file, for simulators that play such scenarios.

The ego car stands at the start of the ego lane, speeds up to the speed limit, has a route to the
lane's end, and the scenario ends when it is there or takes too long. Who steers is up to the
simulator. The same road always gives the same bytes; the date, which the format demands, is fixed.
"""

from __future__ import annotations

from typing import Final
from xml.etree import ElementTree

from frenetic.road import Road
from frenetic.simulators import Rules
from frenetic.simulators.embedded import Vehicle

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
    speed = rules.speed_limit / 3.6
    root = ElementTree.Element("OpenSCENARIO")
    _add(
        root,
        "FileHeader",
        revMajor="1",
        revMinor="0",
        date=DATE,
        description=_printable(name) or "road",
        author="Frenetic",
    )
    _add(root, "CatalogLocations")
    _add(_add(root, "RoadNetwork"), "LogicFile", filepath=_printable(road_file))
    _add_car(_add(root, "Entities"))
    start, goal = min(START, 0.25 * road.length), max(road.length - END, 0.75 * road.length)
    storyboard = _add(root, "Storyboard")
    init = _add(_add(_add(storyboard, "Init"), "Actions"), "Private", entityRef=EGO)
    _add_position(_add(_add(init, "PrivateAction"), "TeleportAction"), start)
    _add_speed(_add(init, "PrivateAction"), 0.0, shape="step", seconds=0.0)
    act = _add(_add(storyboard, "Story", name="drive"), "Act", name="drive")
    group = _add(act, "ManeuverGroup", name="ego", maximumExecutionCount="1")
    actors = _add(group, "Actors", selectTriggeringEntities="false")
    _add(actors, "EntityRef", entityRef=EGO)
    maneuver = _add(group, "Maneuver", name="drive")
    # Not in Init, where CARLA's runner takes the last position of all for the car's start.
    _add_route(_add_event(maneuver, "take the route"), start, goal)
    _add_speed(
        _add_event(maneuver, "speed up"), speed, shape="linear", seconds=speed / ACCELERATION
    )
    _add_time(_add_condition(_add(act, "StartTrigger"), "at once"), 0.0)
    # esmini ends with the storyboard, CARLA's runner with the act.
    for parent in (act, storyboard):
        stop = _add(parent, "StopTrigger")
        _add_arrival(_add_condition(stop, "at the goal"), goal, rules.goal_distance)
        _add_time(_add_condition(stop, "out of time"), rules.timeout(road.length))
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _printable(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _add(
    parent: ElementTree.Element, tag: str, /, **attributes: float | str
) -> ElementTree.Element:
    texts = {
        key: value if isinstance(value, str) else repr(round(value, 6) + 0.0)
        for key, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, texts)


def _add_car(entities: ElementTree.Element) -> None:
    """The embedded simulator's car, measured from its rear axle as the format wants it."""
    car = Vehicle()
    body = car.body()
    ego = _add(entities, "ScenarioObject", name=EGO)
    vehicle = _add(ego, "Vehicle", name=MODEL, vehicleCategory="car")
    box = _add(vehicle, "BoundingBox")
    _add(box, "Center", x=car.rear_axle + body.centre_ahead, y=0.0, z=0.5 * _HEIGHT)
    _add(box, "Dimensions", width=car.width, length=car.length, height=_HEIGHT)
    _add(
        vehicle,
        "Performance",
        maxSpeed=_MAX_SPEED,
        maxAcceleration=car.engine_acceleration,
        maxDeceleration=car.brake_deceleration,
    )
    axles = _add(vehicle, "Axles")
    for tag, steering, ahead in (
        ("FrontAxle", car.steering_limit, car.wheelbase),
        ("RearAxle", 0.0, 0.0),
    ):
        _add(
            axles,
            tag,
            maxSteering=steering,
            wheelDiameter=_WHEEL,
            trackWidth=car.width - 0.2,
            positionX=ahead,
            positionZ=0.5 * _WHEEL,
        )
    properties = _add(vehicle, "Properties")
    _add(properties, "Property", name="type", value="ego_vehicle")  # for CARLA's runner


def _add_position(parent: ElementTree.Element, distance: float) -> None:
    """A place on the centre of the ego lane."""
    position = _add(parent, "Position")
    _add(position, "LanePosition", roadId="1", laneId="-1", s=distance, offset=0.0)


def _add_speed(action: ElementTree.Element, speed: float, *, shape: str, seconds: float) -> None:
    change = _add(_add(action, "LongitudinalAction"), "SpeedAction")
    _add(
        change,
        "SpeedActionDynamics",
        dynamicsShape=shape,
        dynamicsDimension="time",
        value=seconds,
    )
    _add(_add(change, "SpeedActionTarget"), "AbsoluteTargetSpeed", value=speed)


def _add_route(action: ElementTree.Element, start: float, goal: float) -> None:
    assign = _add(_add(action, "RoutingAction"), "AssignRouteAction")
    route = _add(assign, "Route", name="to the goal", closed="false")
    for place in (start, goal):
        _add_position(_add(route, "Waypoint", routeStrategy="shortest"), place)


def _add_event(maneuver: ElementTree.Element, name: str) -> ElementTree.Element:
    """The action of a new event that happens at once."""
    event = _add(maneuver, "Event", name=name, priority="parallel")
    action = _add(_add(event, "Action", name=name), "PrivateAction")
    _add_time(_add_condition(_add(event, "StartTrigger"), name), 0.0)
    return action


def _add_condition(trigger: ElementTree.Element, name: str) -> ElementTree.Element:
    """A condition that suffices on its own."""
    group = _add(trigger, "ConditionGroup")
    return _add(group, "Condition", name=name, delay=0.0, conditionEdge="none")


def _add_time(condition: ElementTree.Element, seconds: float) -> None:
    value = _add(condition, "ByValueCondition")
    _add(value, "SimulationTimeCondition", value=seconds, rule="greaterThan")


def _add_arrival(condition: ElementTree.Element, goal: float, within: float) -> None:
    by_entity = _add(condition, "ByEntityCondition")
    entities = _add(by_entity, "TriggeringEntities", triggeringEntitiesRule="any")
    _add(entities, "EntityRef", entityRef=EGO)
    reach = _add(_add(by_entity, "EntityCondition"), "ReachPositionCondition", tolerance=within)
    _add_position(reach, goal)
