"""Cars that are stepped together: observe, decide, move, judge, for all of them in one kernel.

The kernel calls what the embedded simulator's rollout calls, in the same order, so an episode is
the drive that the same policy gives there, bit for bit.

The reward of a step is the progress along the road, as a share of what the speed limit allows and
at most 1, less the share of the car that is outside its lane, less `FAILURE` if the drive fails.
"""

from __future__ import annotations

import math
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box, Dict, Space

from frenetic._support.arrays import FloatArray
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
    advance_period,
    start_state,
    write_record,
)
from frenetic.simulators.embedded.single_track import HEADING, SPEED, STATE_SIZE, STEERING, YAW_RATE
from frenetic.simulators.observer import in_metres_per_second, limit_at, observe

Seen: TypeAlias = npt.NDArray[np.float32] | dict[str, npt.NDArray[Any]]
"""A vector, or with a camera a ``vector`` and an ``image``; or a batch of them."""

FAILURE: Final = 10.0
"""Reward that a failing drive costs: about what half a second at the speed limit brings."""
WAIT, START, STEP = range(3)
"""Task of a car in a call of the kernel."""

_COLUMNS: Final = len(Trajectory.names())
_FIRST_ROOM: Final = 256  # records


@njit()
def step_cars(
    tasks: npt.NDArray[np.int64],
    actions: FloatArray,
    tables: FloatArray,
    slopes: FloatArray,
    rows: npt.NDArray[np.int64],
    roads: FloatArray,
    rules: FloatArray,
    setups: FloatArray,
    limits: FloatArray,
    car: FloatArray,
    vehicle: FloatArray,
    start: FloatArray,
    states: FloatArray,
    records: FloatArray,
    steps: npt.NDArray[np.int64],
    ends: npt.NDArray[np.int64],
    places: FloatArray,
    rewards: FloatArray,
    vectors: npt.NDArray[np.float32],
) -> None:
    """Start cars or move them on by one period; the later arguments are written to.

    Args:
        tasks: (n,) WAIT, START or STEP.
        actions: (n, 2) see `frenetic.plugins.vision.policy.controls_of`.
        tables: (n, m, 7) the roads, see `frenetic.road.geometry`.
        slopes: (n, m, 2) theirs, see `Road.slopes`.
        rows: (n, 2) rows of each road's table and slopes.
        roads: (n, 2) sub-step and lane width of each road in m.
        rules: (n, 5) see `frenetic.oracle.assessment.rules_array`.
        setups: (n, 9) see `frenetic.drivers.laws.setup_array`.
        limits: (n, m, 2) m and m/s, the speed limits, each from its station on.
        car, vehicle: see `rollout`.
        start: (2,) m and rad, see `start_state`.
        states: (n, 7).
        records: (n, 11, r), room for the columns of trajectories.
        steps: (n,) control periods driven.
        ends: (n,) RUNNING, or how the drive ended.
        places: (n, 2) distance along the road and least oob distance so far, in m.
        rewards: (n,).
        vectors: (n, 26) see `frenetic.plugins.vision.policy.write_vector`.
    """
    ahead = np.empty((AHEAD_POINTS, 2))
    curvature_ahead = np.empty(AHEAD_POINTS)
    weather = np.empty(0)  # none
    for k in range(len(tasks)):
        if tasks[k] == WAIT:
            continue
        table = tables[k][: rows[k, 0]]
        ds, lane_width = roads[k, 0], roads[k, 1]
        state = states[k]
        rows_of = records[k]
        steering = throttle = brake = 0.0
        if tasks[k] == START:
            state[:] = start_state(table, lane_width, start[0], start[1])
            steps[k] = 0
            places[k, 0] = 0.0
            places[k, 1] = math.inf
        else:
            steering, throttle, brake = controls_of(actions[k, 0], actions[k, 1], setups[k])
            write_record(rows_of, steps[k], state, steering, throttle, brake)
            advance_period(
                *(state, steering, throttle, brake, vehicle),
                *(table, ds, slopes[k][: rows[k, 1]], places[k, 0], weather),
            )
            steps[k] += 1
        i = steps[k]
        write_record(rows_of, i, state, steering, throttle, brake)
        before = places[k, 0]
        end, s, offset, heading_error, share = observe(
            table,
            ds,
            lane_width,
            rules[k],
            car,
            rows_of,
            i,
            state[HEADING],
            before,
            0.0,
            ahead,
            curvature_ahead,
        )
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
    """Cars in the embedded simulator, each with a road and a drive of its own.

    Args:
        count: number of cars.
        simulator: its rules, car, friction and starting place hold for all of them.
        camera: of every car, if they have one.
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
        self._start = np.array([simulator.start_offset, simulator.start_heading])
        self._on: list[Road | None] = [None] * count
        self._tables = np.empty((count, 0, WIDENING + 1))
        self._tables_seen = _read_only(self._tables)
        self._slopes = np.empty((count, 0, 2))
        self._slopes_seen = _read_only(self._slopes)
        self._rows = np.zeros((count, 2), np.int64)
        self._roads = np.empty((count, 2))
        self._rules = np.empty((count, 5))
        self._setups = np.empty((count, 9))
        self._limits = np.full((count, 1, 2), np.inf)
        self._states = np.empty((count, STATE_SIZE))
        self._records = np.empty((count, _COLUMNS, _FIRST_ROOM))
        self._steps_left = 0  # at least as many fit into the records
        self._places = np.zeros((count, 2))
        self.steps = np.zeros(count, np.int64)
        """Control periods driven, (n,)."""
        self.ends = np.full(count, REACHED, np.int64)
        """State of each drive, (n,), see `frenetic.oracle.assessment`; at first, all have ended."""
        self.rewards = np.zeros(count)
        """Rewards of the last step, (n,)."""
        self.vectors = np.zeros((count, VECTOR_SIZE), np.float32)
        """Observations, (n, 26)."""

    def place(self, k: int, road: Road) -> None:
        """Give car ``k`` a road, on which it has to be started.

        Raises:
            RoadError: it leans or rises, and the car has a camera.
        """
        if self._camera is not None:
            check_drawn(road)
        if self._tables.shape[1] < len(road.table):
            self._tables = _longer(self._tables, 1, len(road.table))
            self._tables_seen = _read_only(self._tables)
        if self._slopes.shape[1] < len(road.slopes):
            self._slopes = _longer(self._slopes, 1, len(road.slopes))
            self._slopes_seen = _read_only(self._slopes)
        self._tables[k, : len(road.table), WIDENING] = 0.0
        self._tables[k, : len(road.table), : road.table.shape[1]] = road.table
        self._slopes[k, : len(road.slopes)] = road.slopes
        self._rows[k] = len(road.table), len(road.slopes)
        self._roads[k] = road.sub_step, road.lane_width
        self._rules[k] = rules_array(self.simulator.rules, road.length)
        self._setups[k] = setup_array(self.simulator.setup(road))
        limits = in_metres_per_second(self.simulator.rules.speed_limits_on(road))
        if self._limits.shape[1] < len(limits):
            narrower = self._limits
            self._limits = np.full((len(narrower), len(limits), 2), np.inf)
            self._limits[:, : narrower.shape[1]] = narrower
        self._limits[k] = np.inf  # stations that no car reaches
        self._limits[k, : len(limits)] = limits
        self._on[k], self._renderers[k] = road, None

    def observation(self, k: int) -> Seen:
        """Return what car ``k`` sees."""
        vector = self.vectors[k].copy()
        return vector if self._camera is None else {"vector": vector, "image": self._image(k)}

    def observations(self) -> Seen:
        """Return what all cars see."""
        vectors = self.vectors.copy()
        if self._camera is None:
            return vectors
        return {"vector": vectors, "image": np.stack([self._image(k) for k in range(len(vectors))])}

    def _image(self, k: int) -> npt.NDArray[np.uint8]:
        road = self._on[k]
        assert road is not None
        assert self._camera is not None
        renderer = self._renderers[k]
        if renderer is None:
            renderer = self._renderers[k] = CameraRenderer(road, self._camera)
        x, y, heading = self._states[k, :3].tolist()
        return renderer.draw(x, y, heading)

    def step(self, tasks: npt.NDArray[np.int64], actions: FloatArray) -> None:
        """Start cars or move them on by one period.

        Args:
            tasks: (n,) WAIT, START or STEP; a car steps only while its drive is RUNNING.
            actions: (n, 2) in -1..1; of those that step, finite.
        """
        if self._steps_left < 1:
            needed = int(self.steps.max()) + 2
            if needed > self._records.shape[2]:
                self._records = _longer(self._records, 2, needed)
            self._steps_left = self._records.shape[2] - needed + 1
        self._steps_left -= 1
        step_cars(
            tasks,
            actions,
            self._tables_seen,
            self._slopes_seen,
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
        """Cars that took too long, (n,)."""
        timed_out: npt.NDArray[np.bool_] = self.ends == TIMED_OUT
        return timed_out

    def info(self, k: int) -> dict[str, Any]:
        """Information on the drive of car ``k``; nothing unless it has ended by the rules."""
        if self.ends[k] == RUNNING:
            return {}
        distance, moobd = self._places[k]
        outcome = Outcome.PASS if self.ends[k] == REACHED else Outcome.FAIL
        return {"outcome": str(outcome), "moobd": float(moobd), "distance": float(distance)}

    def road(self, k: int) -> Road | None:
        """Return the road of car ``k``; None before the first one."""
        return self._on[k]

    def drive(self, k: int) -> Drive:
        """Return the drive of car ``k`` so far."""
        written = self.steps[k] + 1 if self._on[k] is not None else 0
        columns = self._records[k, :, :written]
        return Drive(Trajectory(*columns), self.simulator.car, self.simulator.rules)


def checked_actions(actions: npt.ArrayLike, count: int) -> FloatArray:
    """Actions of ``count`` cars for `Cars.step`.

    Raises:
        ValueError: they are not (count, 2) finite numbers.
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
    """A copy whose ``axis`` has room for ``needed``, and some more."""
    shape = list(array.shape)
    shape[axis] = max(needed, 3 * shape[axis] // 2)
    longer = np.empty(shape)
    longer[tuple(map(slice, array.shape))] = array
    return longer


def _read_only(array: FloatArray) -> FloatArray:
    """A view as a road's table is, for which the simulator's kernels are compiled."""
    view = array.view()
    view.setflags(write=False)
    return view
