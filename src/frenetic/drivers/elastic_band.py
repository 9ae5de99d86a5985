"""The law of `BeamngAi`: an elastic band within the lane, as kernels.

The driver's plan is a chain of nodes along the lane: one every ``spacing`` metres, and one in the
middle of each gap, on the straight line between its neighbours. The chain behaves like an elastic
band. A node is drawn to the inside of the turn that the plan takes there, at
``strength * (1 - cos(angle))`` m/s, less ``recoil`` times the draws of its neighbours; it moves
along its normal and stays within the lane. So the plan cuts corners. Where the car is off the plan,
the plan moves to the car and forgives the error. The speed follows from the plan's curvature, and
the front of the car steers for a point ahead on the smoothed plan.

``memory`` is the driver's state between two calls, (`MEMORY`,), zeros at the start of a drive.
Entry ``j % NODES`` holds the lateral offset of node ``j``, which is ``j * spacing / 2`` m along the
road, from the middle of the lane, in m to the left. The last entry, `NODES`, is one more than the
number of the last node.

What is known of BeamNG.AI is in ``research/beamng-ai.md``.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.trigonometry import arctangent, cosine, hypotenuse, sine
from frenetic.drivers.driver import AHEAD_SPACING

HORIZON: Final = 48.0
"""Longest road ahead of the car that is planned, in m."""
MOST_SPEED: Final = 6.0
"""Fastest move of a node, in m/s: BeamNG.AI moves one by 0.1 m a frame at most, at 60 a second."""
FORGIVEN: Final = 20.0
"""Distance ahead of the car over which forgiving its error fades out, in m."""
NODES: Final = 64
"""Number of nodes that the memory holds."""
MEMORY: Final = NODES + 1
"""Number of values in the memory."""

# Indices of ``parameters``, see `frenetic.drivers.builtin.BeamngAi`.
(
    LATERAL,
    BRAKING,
    SPACING,
    STRENGTH,
    RECOIL,
    CLEARANCE,
    FORGIVENESS,
    LOOKAHEAD_TIME,
    LOOKAHEAD_MIN,
    AIMING_POINT,
    STEERING_GAIN,
    THROTTLE_GAIN,
    SPEED_SLACK,
    BRAKE_GAIN,
) = range(14)


@njit()
def lane_at(
    u: float,
    heading_error: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    rows: int,
) -> tuple[float, float]:
    """Return the point of the lane's middle ``u`` m of road ahead, in the car's frame in m.

    Within the view, the line between two points is an arc. Behind the car the lane continues as a
    clothoid, and beyond the view straight.
    """
    if u < 0.0:
        kappa = curvature_ahead[0]
        rate = (curvature_ahead[1] - kappa) / AHEAD_SPACING
        half = 0.5 * u
        first = -heading_error
        middle = first + half * (kappa + 0.5 * rate * half)
        last = first + u * (kappa + 0.5 * rate * u)
        x = cosine(first) + 4.0 * cosine(middle) + cosine(last)
        y = sine(first) + 4.0 * sine(middle) + sine(last)
        return ahead[0, 0] + u * x / 6.0, ahead[0, 1] + u * y / 6.0
    i = min(int(u / AHEAD_SPACING), rows - 2)
    t = u / AHEAD_SPACING - i
    x = ahead[i + 1, 0] - ahead[i, 0]
    y = ahead[i + 1, 1] - ahead[i, 1]
    bulge = 0.0
    if t < 1.0:
        bulge = 0.5 * AHEAD_SPACING * t * (1.0 - t) * curvature_ahead[i]
    return ahead[i, 0] + t * x + bulge * y, ahead[i, 1] + t * y - bulge * x


@njit()
def square_of_limit(limit_ahead: FloatArray, u: float) -> float:
    """Return the square of the speed limit ``u`` m of road ahead of the car, in m^2/s^2."""
    limit: float = limit_ahead[min(max(int(u / AHEAD_SPACING), 0), len(limit_ahead) - 1)]
    return limit * limit


@njit()
def _lay_nodes(
    first: int,
    count: int,
    spacing: float,
    distance: float,
    heading_error: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    rows: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the lane's middle at 2 `count` - 1 nodes and its normals there, (n, 2) each.

    Nodes are `spacing` m of road apart, from number `first` on, and in the middle of each gap.
    """
    line = np.empty((count + 2, 2))
    for i in range(count + 2):
        x, y = lane_at(
            (first - 1 + i) * spacing - distance, heading_error, ahead, curvature_ahead, rows
        )
        line[i, 0] = x
        line[i, 1] = y
    nodes = 2 * count - 1
    middle = np.empty((nodes, 2))
    normal = np.empty((nodes, 2))
    for i in range(count):
        x = line[i + 2, 0] - line[i, 0]
        y = line[i + 2, 1] - line[i, 1]
        length = hypotenuse(x, y)
        normal[2 * i, 0] = -y / length
        normal[2 * i, 1] = x / length
        middle[2 * i, 0] = line[i + 1, 0]
        middle[2 * i, 1] = line[i + 1, 1]
        if i:
            x = line[i + 1, 0] - line[i, 0]
            y = line[i + 1, 1] - line[i, 1]
            length = hypotenuse(x, y)
            normal[2 * i - 1, 0] = -y / length
            normal[2 * i - 1, 1] = x / length
            middle[2 * i - 1, 0] = 0.5 * (line[i, 0] + line[i + 1, 0])
            middle[2 * i - 1, 1] = 0.5 * (line[i, 1] + line[i + 1, 1])
    return middle, normal


@njit()
def _recall(memory: FloatArray, number: int, nodes: int) -> FloatArray:
    """Return the remembered offsets of `nodes` nodes from number `number` on, (nodes,) in m.

    Nodes that have just come into view are in the middle of the lane.
    """
    end = number + nodes
    for j in range(int(memory[NODES]), end):
        memory[j % NODES] = 0.0
    memory[NODES] = max(memory[NODES], float(end))
    offset = np.empty(nodes)
    for i in range(nodes):
        offset[i] = memory[(number + i) % NODES]
    return offset


@njit()
def _gap_of(plan: FloatArray, front: float) -> int:
    """Return the number of the gap between nodes in which the front of the car is."""
    here = 0
    for i in range(len(plan) - 2):
        x = plan[i + 1, 0] - plan[i, 0]
        y = plan[i + 1, 1] - plan[i, 1]
        if (front - plan[i, 0]) * x - plan[i, 1] * y < x * x + y * y:
            break
        here = i + 1
    return here


@njit()
def _move_band(
    plan: FloatArray,
    offset: FloatArray,
    middle: FloatArray,
    normal: FloatArray,
    here: int,
    bound: float,
    p: FloatArray,
    period: float,
) -> None:
    """Draw the nodes beyond gap `here` to the inside of their turns."""
    nodes = len(plan)
    draw = np.zeros(nodes)
    strength = p[STRENGTH] * period
    most = MOST_SPEED * period
    before_x = before_y = 0.0
    for i in range(here, nodes - 1):
        x = plan[i + 1, 0] - plan[i, 0]
        y = plan[i + 1, 1] - plan[i, 1]
        length = hypotenuse(x, y)
        x /= length
        y /= length
        if i > here:
            pull = strength * (1.0 - before_x * x - before_y * y)
            draw[i] = pull if before_x * y - before_y * x > 0.0 else -pull
        before_x = x
        before_y = y
    for i in range(here + 1, nodes - 1):
        move = draw[i] - p[RECOIL] * (draw[i - 1] + draw[i + 1])
        move = min(max(move, -most), most)
        offset[i] = min(max(offset[i] + move, -bound), bound)
        plan[i, 0] = middle[i, 0] + offset[i] * normal[i, 0]
        plan[i, 1] = middle[i, 1] + offset[i] * normal[i, 1]


@njit()
def _forgive(
    plan: FloatArray,
    offset: FloatArray,
    middle: FloatArray,
    normal: FloatArray,
    here: int,
    bound: float,
    share: float,
    spacing: float,
) -> None:
    """Move the nodes beyond gap `here` by `share`, in m, which fades out over `FORGIVEN` m."""
    nodes = len(plan)
    for i in range(here + 1, nodes):
        fading = 1.0 - 0.5 * spacing * (i - here - 1) / FORGIVEN
        if fading <= 0.0:
            break
        offset[i] = min(max(offset[i] + share * fading, -bound), bound)
        plan[i, 0] = middle[i, 0] + offset[i] * normal[i, 0]
        plan[i, 1] = middle[i, 1] + offset[i] * normal[i, 1]


@njit()
def _speed_square(
    plan: FloatArray,
    limit_ahead: FloatArray,
    here: int,
    number: int,
    spacing: float,
    distance: float,
    p: FloatArray,
) -> float:
    """Return the square of the speed allowed at the node after gap `here`, in m^2/s^2.

    From the last node back to this node, the square is limited by the speed limit, by the bend at
    each node, and by braking for the node after it.
    """
    nodes = len(plan)
    square = square_of_limit(limit_ahead, (number + nodes - 1) * 0.5 * spacing - distance)
    for i in range(nodes - 2, here, -1):
        limit = square_of_limit(limit_ahead, (number + i) * 0.5 * spacing - distance)
        ax = plan[i, 0] - plan[i - 1, 0]
        ay = plan[i, 1] - plan[i - 1, 1]
        bx = plan[i + 1, 0] - plan[i, 0]
        by = plan[i + 1, 1] - plan[i, 1]
        b = hypotenuse(bx, by)
        cx, cy = ax + bx, ay + by
        chords = math.sqrt((ax * ax + ay * ay) * (cx * cx + cy * cy)) * b
        bend = 2.0 * abs(ax * by - ay * bx)
        square = min(square + 2.0 * p[BRAKING] * b, limit)
        if bend * square > p[LATERAL] * chords:
            square = p[LATERAL] * chords / bend
    return square


@njit()
def _point_on_plan(plan: FloatArray, here: int, gap: float, rest: float) -> tuple[float, float]:
    """Return the point `rest` m after the beginning of gap `here`, which is `gap` m long.

    The corners of the plan are rounded by a quadratic B-spline.
    """
    nodes = len(plan)
    i = here
    while rest > gap and i < nodes - 2:
        rest -= gap
        i += 1
        gap = hypotenuse(plan[i + 1, 0] - plan[i, 0], plan[i + 1, 1] - plan[i, 1])
    t = rest / gap
    k = i if t < 0.5 else i + 1
    if t <= 1.0 and 0 < k < nodes - 1:
        t += 0.5 - (k - i)
        before = 0.5 * (1.0 - t) * (1.0 - t)
        after = 0.5 * t * t
        x = before * plan[k - 1, 0] + (1.0 - before - after) * plan[k, 0] + after * plan[k + 1, 0]
        y = before * plan[k - 1, 1] + (1.0 - before - after) * plan[k, 1] + after * plan[k + 1, 1]
    else:
        x = plan[i, 0] + t * (plan[i + 1, 0] - plan[i, 0])
        y = plan[i, 1] + t * (plan[i + 1, 1] - plan[i, 1])
    return x, y


@njit()
def drive_along_band(
    speed: float,
    distance: float,
    heading_error: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    limit_ahead: FloatArray,
    rows: int,
    parameters: FloatArray,
    lane_width: float,
    car_width: float,
    rear_axle: float,
    period: float,
    memory: FloatArray,
) -> tuple[float, float, float]:
    """Return the angle of the front wheels in rad, throttle and brake; update ``memory``.

    Args:
        speed, distance, heading_error: see `frenetic.drivers.driver.Observation`.
        ahead, curvature_ahead, limit_ahead, rows: the view, see `frenetic.drivers.laws`.
        parameters: see `frenetic.drivers.builtin.BeamngAi.parameters`.
        lane_width, car_width, rear_axle: see `frenetic.drivers.driver.DriveSetup`.
        period: time between two calls, in s.
        memory: state of the driver, (`MEMORY`,), see the module's text.
    """
    p = parameters
    spacing = p[SPACING] * lane_width
    bound = max(0.5 * lane_width - p[CLEARANCE] * car_width, 0.0)
    view = min((rows - 1) * AHEAD_SPACING, HORIZON)

    # Map nodes on the lane's middle, from two behind the car to the end of the view.
    first = math.floor(distance / spacing) - 1
    count = min(max(int((distance + view) / spacing) - first + 1, 5), NODES // 2 - 2)
    middle, normal = _lay_nodes(
        first, count, spacing, distance, heading_error, ahead, curvature_ahead, rows
    )
    nodes = len(middle)
    number = 2 * first
    offset = _recall(memory, number, nodes)
    plan = np.empty((nodes, 2))
    for i in range(nodes):
        plan[i, 0] = middle[i, 0] + offset[i] * normal[i, 0]
        plan[i, 1] = middle[i, 1] + offset[i] * normal[i, 1]
    front = p[AIMING_POINT] - rear_axle
    here = _gap_of(plan, front)
    _move_band(plan, offset, middle, normal, here, bound, p, period)

    # Find the car's position along the plan; its error beside the plan moves the nodes ahead.
    x = plan[here + 1, 0] - plan[here, 0]
    y = plan[here + 1, 1] - plan[here, 1]
    gap = hypotenuse(x, y)
    along = min(max(((front - plan[here, 0]) * x - plan[here, 1] * y) / gap, 0.0), gap)
    error = (-plan[here, 1] * x - (front - plan[here, 0]) * y) / gap
    share = p[FORGIVENESS] * period * error
    _forgive(plan, offset, middle, normal, here, bound, share, spacing)
    for i in range(nodes):
        memory[(number + i) % NODES] = offset[i]

    # Pedals: for the planned speed.
    square = _speed_square(plan, limit_ahead, here, number, spacing, distance, p)
    limit = square_of_limit(limit_ahead, 0.0)
    wanted = math.sqrt(min(square + 2.0 * p[BRAKING] * (gap - along), limit))
    missing = wanted - speed
    throttle = min(max(p[THROTTLE_GAIN] * (missing - p[SPEED_SLACK]), 0.0), 1.0)
    brake = min(max(-p[BRAKE_GAIN] * missing, 0.0), 1.0)

    # Steering: for a point ahead on the plan.
    rest = along + max(p[LOOKAHEAD_TIME] * speed, p[LOOKAHEAD_MIN])
    x, y = _point_on_plan(plan, here, gap, rest)
    x -= front
    turned = arctangent(y / x) if x > 0.0 else math.copysign(1.0, y)
    return p[STEERING_GAIN] * min(max(turned, -1.0), 1.0), throttle, brake
