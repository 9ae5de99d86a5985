"""Cars in the embedded simulator that one kernel steps together: decide, move, observe, judge.

The kernel calls the same kernels as the embedded simulator's rollout, in the same order. So an
episode is, bit for bit, the drive that the same policy has in the embedded simulator.

The reward of a step is the progress along the road over the progress at the speed limit, at most 1,
minus the share of the car that is outside its lane, minus `FAILURE` if the drive fails.
"""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Dict, Space

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.compiled import njit
from frenetic.drivers import Camera
from frenetic.drivers.driver import AHEAD_POINTS
from frenetic.drivers.laws import setup_array
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import REACHED, RUNNING, TIMED_OUT, rules_array
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.vision.policy import ACTION_SIZE, VECTOR_SIZE, controls_of, write_vector
from frenetic.plugins.vision.rendering import CameraRenderer
from frenetic.road import Road
from frenetic.road.geometry import WIDENING, widening_at
from frenetic.simulators import Drive, EmbeddedSimulator, Trajectory
from frenetic.simulators.capabilities import check_drawn
from frenetic.simulators.embedded.rollout import (
    PERIOD,
    STEPS_PER_PERIOD,
    ground_under,
    start_state,
    write_record,
)
from frenetic.simulators.embedded.rollout import STEP as INTEGRATION_STEP
from frenetic.simulators.embedded.single_track import (
    INPUT_SIZE,
    MOST_CARS,
    SPEED,
    STATE_SIZE,
    STEERING,
    YAW_RATE,
    advance,
)
from frenetic.simulators.observer import in_metres_per_second, limit_at, observe

CarObservation: TypeAlias = npt.NDArray[np.float32] | dict[str, npt.NDArray[Any]]
"""Observation of a car or of several: a vector; with a camera a ``vector`` and an ``image``."""

FAILURE: Final = 10.0
"""Reward that a failing drive loses: about as much as it gets in half a second at the speed limit;
our choice."""
WAIT, START, STEP = range(3)
"""Tasks of a car in a call of the kernel: do nothing, begin a drive, or drive for a period."""

_COLUMNS: Final = len(Trajectory.names())
_FIRST_CAPACITY: Final = 256
"""Number of records for which memory is taken at first; our choice."""
_RULE_NUMBERS: Final = 5
"""Size of `frenetic.oracle.assessment.rules_array`."""
_SETUP_NUMBERS: Final = 9
"""Size of `frenetic.drivers.laws.setup_array`."""


@njit()
def _move(
    cars: IntArray,
    tables: FloatArray,
    slopes: FloatArray,
    rows: IntArray,
    roads: FloatArray,
    vehicle: FloatArray,
    states: FloatArray,
    inputs: FloatArray,
    places: FloatArray,
) -> None:
    """Move the cars with these numbers for a period, side by side.

    Args:
        cars: numbers of the cars.
        inputs: (n, 3) controls of the cars, see `advance`.
        tables, slopes, rows, roads, vehicle, states, places: see `step_cars`.
    """
    grounds = np.empty((len(states), len(vehicle)))
    for k in cars:
        grounds[k] = vehicle
        if rows[k, 1]:
            grounds[k], _ = ground_under(
                vehicle,
                tables[k][: rows[k, 0]],
                roads[k, 0],
                slopes[k][: rows[k, 1]],
                None,
                states[k],
                places[k, 0],
                PERIOD,
            )
    for first in range(0, len(cars), MOST_CARS):
        group = cars[first : first + MOST_CARS]
        advance(states, inputs, grounds, group, INTEGRATION_STEP, STEPS_PER_PERIOD)


@njit()
def step_cars(
    tasks: IntArray,
    actions: FloatArray,
    tables: FloatArray,
    slopes: FloatArray,
    rows: IntArray,
    roads: FloatArray,
    rules: FloatArray,
    setups: FloatArray,
    limits: FloatArray,
    car: FloatArray,
    vehicle: FloatArray,
    start: FloatArray,
    states: FloatArray,
    records: FloatArray,
    steps: IntArray,
    ends: IntArray,
    places: FloatArray,
    rewards: FloatArray,
    vectors: npt.NDArray[np.float32],
) -> None:
    """Let each of n cars wait, start or drive for a period.

    The arguments from ``states`` on are changed.

    Args:
        tasks: (n,) WAIT, START or STEP.
        actions: (n, 2) actions, see `frenetic.plugins.vision.policy.controls_of`.
        tables: (n, m, 7) tables of the roads, see `frenetic.road.geometry`.
        slopes: (n, m, 2) slopes of the roads, see `Road.slopes`.
        rows: (n, 2) numbers of rows of each road's table and slopes.
        roads: (n, 2) sub-step and lane width of each road, in m.
        rules: (n, 5) rules, see `frenetic.oracle.assessment.rules_array`.
        setups: (n, 9) setups, see `frenetic.drivers.laws.setup_array`.
        limits: (n, m, 2) station in m, and the speed limit from there on in m/s.
        car, vehicle: see `rollout`.
        start: (3,) offset in m, angle in rad and speed in m/s of the start, see `start_state`.
        states: (n, 7) states of the cars.
        records: (n, r, 11) records of the trajectories, which are filled.
        steps: (n,) numbers of control periods driven.
        ends: (n,) RUNNING, or how the drive ended.
        places: (n, 2) distance along the road and least oob distance so far, in m.
        rewards: (n,) rewards of the step.
        vectors: (n, 26) observations, see `frenetic.plugins.vision.policy.write_vector`.
    """
    ahead = np.empty((AHEAD_POINTS, 2))
    curvature_ahead = np.empty(AHEAD_POINTS)
    inputs = np.zeros((len(tasks), INPUT_SIZE))
    moving = np.empty(len(tasks), np.int64)
    count = 0
    for k in range(len(tasks)):
        if tasks[k] == START:
            table = tables[k][: rows[k, 0]]
            states[k] = start_state(table, roads[k, 1], start[0], start[1])
            states[k, SPEED] = start[2]
            steps[k] = 0
            places[k, 0] = 0.0
            places[k, 1] = math.inf
        elif tasks[k] == STEP:
            steering, throttle, brake = controls_of(actions[k, 0], actions[k, 1], setups[k])
            inputs[k, 0], inputs[k, 1], inputs[k, 2] = steering, throttle, brake
            write_record(records[k], steps[k], states, inputs, k)
            steps[k] += 1
            moving[count] = k
            count += 1
    _move(moving[:count], tables, slopes, rows, roads, vehicle, states, inputs, places)
    for k in range(len(tasks)):
        if tasks[k] == WAIT:
            continue
        table = tables[k][: rows[k, 0]]
        ds, lane_width = roads[k, 0], roads[k, 1]
        i, state, before = steps[k], states[k], places[k, 0]
        write_record(records[k], i, states, inputs, k)
        end, s, road_offset, heading_error, share = observe(
            table,
            ds,
            lane_width,
            rules[k],
            car,
            records[k],
            i,
            before,
            0.0,
            ahead,
            curvature_ahead,
        )
        offset = road_offset + 0.5 * lane_width  # from the ego lane's centre
        limit = limit_at(limits[k], s)
        write_vector(
            state[SPEED],
            state[YAW_RATE],
            state[STEERING],
            offset,
            heading_error,
            curvature_ahead,
            AHEAD_POINTS,
            setups[k],
            limit,
            vectors[k],
        )
        ends[k] = end
        places[k, 0] = s
        right = 0.5 * lane_width + offset + widening_at(table, ds, s)
        places[k, 1] = min(places[k, 1], 0.5 * lane_width - offset, right)
        if tasks[k] == START:
            rewards[k] = 0.0
            continue
        rewards[k] = min((s - before) / (limit * PERIOD), 1.0) - share
        if end not in (RUNNING, REACHED):
            rewards[k] -= FAILURE


class Cars:
    """Cars in the embedded simulator, each on a road of its own.

    Args:
        count: number of cars.
        simulator: simulator whose rules, vehicle, friction and start hold for all cars.
        camera: camera of every car; None for cars without a camera.

    Raises:
        FreneticError: the camera is no `Camera`.
    """

    def __init__(
        self, count: int, simulator: EmbeddedSimulator, camera: Camera | None = None
    ) -> None:
        if camera is not None and not isinstance(camera, Camera):
            raise FreneticError(f"camera is {camera!r}: a frenetic.drivers.Camera is needed")
        self.simulator = simulator
        self._camera = camera
        self._renderers: list[CameraRenderer | None] = [None] * count
        vector = Box(-1.0, 1.0, (VECTOR_SIZE,), np.float32)
        self.observation_space: Space[Any] = vector
        """Space of one car's observations."""
        if camera is not None:
            image = Box(0, 255, camera.shape, np.uint8)
            self.observation_space = Dict({"vector": vector, "image": image})
        self.action_space = Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        """Space of one car's actions."""
        self._car = simulator.car.to_array()
        self._vehicle = simulator.vehicle.to_array()
        self._start = np.array(
            [simulator.start_offset, simulator.start_heading, simulator.start_speed / 3.6]
        )
        # Arrays of the kernel, see `step_cars`; the tables and slopes grow with longer roads.
        self._driven_roads: list[Road | None] = [None] * count
        self._tables = np.empty((count, 0, WIDENING + 1))
        self._tables_view = _read_only(self._tables)
        self._slopes = np.empty((count, 0, 2))
        self._slopes_view = _read_only(self._slopes)
        self._rows = np.zeros((count, 2), np.int64)
        self._roads = np.empty((count, 2))
        self._rules = np.empty((count, _RULE_NUMBERS))
        self._setups = np.empty((count, _SETUP_NUMBERS))
        self._limits = np.full((count, 1, 2), np.inf)
        self._states = np.empty((count, STATE_SIZE))
        self._records = np.empty((count, _FIRST_CAPACITY, _COLUMNS))
        self._steps_left = 0  # number of steps for which the records surely have room
        self._places = np.zeros((count, 2))
        self.steps = np.zeros(count, np.int64)
        """Numbers of control periods driven, (n,)."""
        self.ends = np.full(count, REACHED, np.int64)
        """RUNNING, or how each drive ended, (n,), see `frenetic.oracle.assessment`; at first, none
        runs."""
        self.rewards = np.zeros(count)
        """Rewards of the last step, (n,)."""
        self.vectors = np.zeros((count, VECTOR_SIZE), np.float32)
        """Observations, (n, 26)."""

    def place(self, k: int, road: Road) -> None:
        """Give car ``k`` a road; the next task of the car has to be START.

        Raises:
            RoadError: the road leans, rises or widens, and the car has a camera.
        """
        if self._camera is not None:
            check_drawn(road)
        if self._tables.shape[1] < len(road.table):
            self._tables = _longer(self._tables, axis=1, needed=len(road.table))
            self._tables_view = _read_only(self._tables)
        if self._slopes.shape[1] < len(road.slopes):
            self._slopes = _longer(self._slopes, axis=1, needed=len(road.slopes))
            self._slopes_view = _read_only(self._slopes)
        self._tables[k, : len(road.table), WIDENING] = 0.0
        self._tables[k, : len(road.table), : road.table.shape[1]] = road.table
        self._slopes[k, : len(road.slopes)] = road.slopes
        self._rows[k] = len(road.table), len(road.slopes)
        self._roads[k] = road.sub_step, road.lane_width
        self._rules[k] = rules_array(self.simulator.rules, road.length)
        self._setups[k] = setup_array(self.simulator.setup(road))
        limits = in_metres_per_second(self.simulator.rules.speed_limits_on(road))
        if self._limits.shape[1] < len(limits):
            old_limits = self._limits
            self._limits = np.full((len(old_limits), len(limits), 2), np.inf)
            self._limits[:, : old_limits.shape[1]] = old_limits
        self._limits[k] = np.inf  # unused rows have stations that no car reaches
        self._limits[k, : len(limits)] = limits
        self._driven_roads[k], self._renderers[k] = road, None

    def observation(self, k: int) -> CarObservation:
        """Return the observation of car ``k``."""
        vector = self.vectors[k].copy()
        return vector if self._camera is None else {"vector": vector, "image": self._image(k)}

    def observations(self) -> CarObservation:
        """Return the observations of all cars."""
        vectors = self.vectors.copy()
        if self._camera is None:
            return vectors
        return {"vector": vectors, "image": np.stack([self._image(k) for k in range(len(vectors))])}

    def _image(self, k: int) -> npt.NDArray[np.uint8]:
        """Return the picture of car ``k``'s camera."""
        road = self._driven_roads[k]
        assert road is not None
        assert self._camera is not None
        renderer = self._renderers[k]
        if renderer is None:
            renderer = self._renderers[k] = CameraRenderer(road, self._camera)
        x, y, heading = self._states[k, :3].tolist()
        return renderer.draw(x, y, heading)

    def step(self, tasks: IntArray, actions: FloatArray) -> None:
        """Let each car wait, start or drive for a period.

        Args:
            tasks: (n,) WAIT, START or STEP; STEP only while the drive is RUNNING.
            actions: (n, 2) actions, -1..1; finite for the cars with STEP.
        """
        if self._steps_left < 1:
            needed = int(self.steps.max()) + 2  # the records so far, and the one of this step
            if needed > self._records.shape[1]:
                self._records = _longer(self._records, axis=1, needed=needed)
            self._steps_left = self._records.shape[1] - needed + 1
        self._steps_left -= 1
        step_cars(
            tasks,
            actions,
            self._tables_view,
            self._slopes_view,
            self._rows,
            self._roads,
            self._rules,
            self._setups,
            self._limits,
            self._car,
            self._vehicle,
            self._start,
            self._states,
            self._records,
            self.steps,
            self.ends,
            self._places,
            self.rewards,
            self.vectors,
        )

    @property
    def timed_out(self) -> npt.NDArray[np.bool_]:
        """Whether each car took too long, (n,)."""
        timed_out: npt.NDArray[np.bool_] = self.ends == TIMED_OUT
        return timed_out

    def info(self, k: int) -> dict[str, Any]:
        """Return outcome, MOOBD and distance of car ``k``'s drive; empty while it is running."""
        if self.ends[k] == RUNNING:
            return {}
        distance, moobd = self._places[k]
        outcome = Outcome.PASS if self.ends[k] == REACHED else Outcome.FAIL
        return {"outcome": str(outcome), "moobd": float(moobd), "distance": float(distance)}

    def road(self, k: int) -> Road | None:
        """Return the road of car ``k``; None before it was given one."""
        return self._driven_roads[k]

    def drive(self, k: int) -> Drive:
        """Return the drive of car ``k`` so far."""
        count = self.steps[k] + 1 if self._driven_roads[k] is not None else 0
        path = Trajectory.from_rows(self._records[k, :count])
        return Drive(path, self.simulator.car, self.simulator.rules)


def checked_actions(actions: npt.ArrayLike, count: int) -> FloatArray:
    """Return the actions of ``count`` cars as an array for `Cars.step`.

    Raises:
        ValueError: the actions are not (count, 2) finite numbers.
    """
    checked = np.asarray(actions, dtype=np.float64)
    if checked.shape != (count, ACTION_SIZE):
        raise ValueError(
            f"the actions have shape {checked.shape}: steering and pedal of each car,"
            f" {(count, ACTION_SIZE)}, are needed"
        )
    if not np.isfinite(checked).all():
        raise ValueError(
            f"an action is not finite: {checked[~np.isfinite(checked).all(axis=1)][0]}"
        )
    return checked


def _longer(array: FloatArray, axis: int, needed: int) -> FloatArray:
    """Return a copy that is longer along an axis: at least ``needed``, or half as long again."""
    shape = list(array.shape)
    shape[axis] = max(needed, 3 * shape[axis] // 2)
    longer = np.empty(shape)
    longer[tuple(map(slice, array.shape))] = array
    return longer


def _read_only(array: FloatArray) -> FloatArray:
    """Return a read-only view: kernels are compiled for read-only tables, as a `Road` has them."""
    view = array.view()
    view.setflags(write=False)
    return view
