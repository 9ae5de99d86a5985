"""The embedded car of a drive with a driver in Python, and the renderer of its camera."""

from __future__ import annotations

from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic._support.entry_points import imported, installed
from frenetic.drivers.camera import RENDERERS, Camera, Renderer, Scene
from frenetic.drivers.driver import Observation
from frenetic.errors import DriverError
from frenetic.oracle.assessment import (
    RECORD_TIME,
    RECORD_X,
    RECORD_Y,
    RULES_SIZE,
    RUNNING,
    rules_array,
)
from frenetic.oracle.drive import BODY_SIZE, CarBody, Rules
from frenetic.oracle.drive_assessment import (
    ASSESSMENT_SIZE,
    DISTANCE,
    OFFSET,
    OOB_SHARE,
    Assessment,
)
from frenetic.road import Road
from frenetic.simulators.drive_loop import ObservedCar, most_records
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.embedded.rollout import write_record
from frenetic.simulators.embedded.single_track import (
    ASKED,
    BRAKE,
    HEADING,
    INPUT_SIZE,
    LATERAL_SPEED,
    SPEED,
    STATE_SIZE,
    STEERING,
    THROTTLE,
    YAW_RATE,
    X,
    Y,
    advance,
)
from frenetic.simulators.embedded.vehicle import PARAMETER_COUNT
from frenetic.simulators.observer import DriverViews, glance, observe

_ASSESSED: Final = kernels.RECORD_SIZE
"""First column of the assessment in a row of `EmbeddedCar`."""
_LARGEST_SHARE: Final = _ASSESSED + ASSESSMENT_SIZE
"""Column of the largest oob share so far in a row of `EmbeddedCar`."""
_ROW_SIZE: Final = _LARGEST_SHARE + 1
"""Number of columns of a row of `EmbeddedCar`."""


# First values of the parts of the numbers of `EmbeddedCar`.
_SUB_STEP, _LANE_WIDTH, _RULES = range(3)
_BODY: Final = _RULES + RULES_SIZE
_CAR_STATE: Final = _BODY + BODY_SIZE
_CAR_INPUTS: Final = _CAR_STATE + STATE_SIZE
_GROUND: Final = _CAR_INPUTS + INPUT_SIZE
_NUMBER_COUNT: Final = _GROUND + PARAMETER_COUNT


@njit(error_model="numpy", interpret_first=6.0)
def advance_to_record(
    table: FloatArray,
    numbers: FloatArray,
    rows: FloatArray,
    i: int,
    are_chosen: bool,
    inputs: tuple[float, float, float],
    seconds: float,
    ahead: FloatArray,
    curvature_ahead: FloatArray,
    row: int,
) -> tuple[int, tuple[float, ...], tuple[float, float, float]]:
    """Move a car to its next record, write and assess the record, and look ahead from there.

    Args:
        table: the road, see `frenetic.road.geometry`.
        numbers: (52,) numbers of the drive, see `EmbeddedCar`; state and inputs change.
        rows: (n, 15) rows of the records, see `EmbeddedCar`.
        i: number of the record.
        are_chosen: whether the inputs were chosen at the record before.
        inputs: angle asked of the front wheels in rad, throttle and brake.
        seconds: simulated time to the record, in s, a multiple of the integration step; 0 for the
            record at the start.
        ahead, curvature_ahead, row: see `frenetic.simulators.observer.DriverViews.new_lane`.

    Returns:
        RUNNING or how the drive ended; time and state of the car; distance along the road and
        offset to the left of the ego lane's centre in m, and heading error in rad.
    """
    states = numbers[_CAR_STATE:_CAR_INPUTS][np.newaxis]
    car_inputs = numbers[_CAR_INPUTS:_GROUND][np.newaxis]
    grounds = numbers[_GROUND:][np.newaxis]
    car_inputs[0, ASKED], car_inputs[0, THROTTLE], car_inputs[0, BRAKE] = inputs
    if are_chosen:
        for v in range(INPUT_SIZE):
            rows[i - 1, kernels.INPUTS + v] = car_inputs[0, v]
    s_before = largest = 0.0
    if i:
        s_before, largest = rows[i - 1, _ASSESSED + DISTANCE], rows[i - 1, _LARGEST_SHARE]
        steps = int(seconds / kernels.STEP + 0.5)
        advance(states, car_inputs, grounds, np.zeros(1, np.int64), kernels.STEP, steps)
    write_record(rows, i, states, car_inputs, 0)
    lane_width = numbers[_LANE_WIDTH]
    end, s, d, heading_error, share = observe(
        table,
        numbers[_SUB_STEP],
        lane_width,
        numbers[_RULES:_BODY],
        numbers[_BODY:_CAR_STATE],
        rows,
        i,
        s_before,
        largest,
        ahead[row],
        curvature_ahead[row],
    )
    rows[i, _ASSESSED + DISTANCE] = s
    rows[i, _ASSESSED + OFFSET] = d
    rows[i, _ASSESSED + OOB_SHARE] = share
    rows[i, _LARGEST_SHARE] = max(largest, share)
    motion = (
        rows[i, RECORD_TIME],
        states[0, X],
        states[0, Y],
        states[0, HEADING],
        states[0, SPEED],
        states[0, LATERAL_SPEED],
        states[0, YAW_RATE],
        states[0, STEERING],
    )
    return end, motion, (s, d + 0.5 * lane_width, heading_error)


class EmbeddedCar(ObservedCar):
    """The car of one drive with a driver in Python.

    Two arrays hold the drive, since a call of a kernel takes longer with each argument. Its rows,
    (n, 15), are the records, each followed by its assessment and the largest oob share so far. Its
    numbers, (52,), are the distance between rows of the road's table and the width of a lane in m,
    the rules, the car's box, its state, its inputs and its parameters on the ground under it.

    Args:
        state: (7,) state at the start.
        parameters: `Vehicle.to_array()`.
        weather: see `frenetic.simulators.embedded.weather`; None without.
        road: Road under the car.
        rules: Rules of the drive.
        body: The box that the car covers.
        renderer: Renderer of the driver's camera; None without a camera.
    """

    def __init__(
        self,
        state: FloatArray,
        parameters: FloatArray,
        weather: FloatArray | None,
        *,
        road: Road,
        rules: Rules,
        body: CarBody,
        renderer: Renderer | None,
    ) -> None:
        self._road = road
        self._line = road.table, road.sub_step, road.lane_width
        self._numbers = numbers = np.zeros(_NUMBER_COUNT)
        numbers[_SUB_STEP], numbers[_LANE_WIDTH] = road.sub_step, road.lane_width
        numbers[_RULES:_BODY] = rules_array(rules, road.length)
        numbers[_BODY:_CAR_STATE] = body.to_array()
        self._state, self._inputs = numbers[_CAR_STATE:_CAR_INPUTS], numbers[_CAR_INPUTS:_GROUND]
        self._ground = numbers[_GROUND:]
        self._state[:], self._ground[:] = state, parameters
        slopes = road.slopes if len(road.slopes) else None
        self._surface = parameters, road.table, road.sub_step, slopes, weather
        self._is_plain = slopes is None and weather is None
        self._s = 0.0  # distance along the road before the last move, on slopes and in weather
        self._rows = np.empty((most_records(rules, road), _ROW_SIZE))
        self._count = 0  # of the rows so far
        self._end = RUNNING  # or how the drive ended
        self._is_recorded = False  # whether the car is at its last record
        self._views = DriverViews(road, rules)
        self._renderer = renderer

    def start(self) -> bool:
        """Record the car at the start; return whether the drive continues."""
        return self._advance_to_record((0.0, 0.0, 0.0), 0.0)

    def advance(
        self, controls: tuple[float, float, float], seconds: float, time: float, *, is_record: bool
    ) -> bool:
        """Move the car, and record it or not; return whether the drive continues."""
        if not self._is_plain:
            ground, self._s = kernels.ground_under(*self._surface, self._state, self._s, seconds)
            self._ground[:] = ground
        if is_record:
            return self._advance_to_record(controls, seconds)
        self._inputs[:] = controls
        if self._is_recorded:
            self._rows[self._count - 1, kernels.INPUTS : kernels.RECORD_SIZE] = controls
            self._is_recorded = False
        car = self._state[np.newaxis], self._inputs[np.newaxis], self._ground[np.newaxis]
        steps = round(seconds / kernels.STEP)
        advance(*car, np.zeros(1, np.int64), kernels.STEP, steps)
        self._motion = time, *self._state.tolist()
        return True

    def _advance_to_record(self, controls: tuple[float, float, float], seconds: float) -> bool:
        """Move the car and record it; return whether the drive continues."""
        self._end, self._motion, self._place = advance_to_record(
            self._line[0],
            self._numbers,
            self._rows,
            self._count,
            self._is_recorded,
            controls,
            seconds,
            *self._views.new_lane(),
        )
        self._count += 1
        self._is_recorded = True
        return self._end == RUNNING

    def observation(self) -> Observation:
        """Return what the driver sees now."""
        if not self._is_recorded:
            self._glance()
        image = None
        if self._renderer is not None:
            image = self._renderer.draw(*self._state[: HEADING + 1])
        return self._views.observation(self._motion, self._place, image)

    def _glance(self) -> None:
        """Look ahead from between two records."""
        _, x, y, heading, *_ = self._motion
        before = self._rows[self._count - 1]
        before_place = float(before[RECORD_X]), float(before[RECORD_Y]), float(before[_ASSESSED])
        lane = self._views.new_lane()
        self._place = glance(self._line, (x, y, heading), before_place, lane)

    def rows(self) -> FloatArray:
        """Return the records so far, (n, 11) with the columns of a `Trajectory`."""
        return self._rows[: self._count, : kernels.RECORD_SIZE]

    def assessment(self) -> Assessment:
        """Return the assessment of the records so far."""
        rows = self._rows[: self._count, _ASSESSED:_LARGEST_SHARE]
        return Assessment.of(self._road, self._end, rows)


def new_renderer(road: Road, camera: Camera, scene: Scene) -> Renderer:
    """Return a renderer for a camera, made by the first installed entry point.

    Raises:
        DriverError: No renderer is installed.
    """
    entry = next(iter(installed(RENDERERS)), None)
    if entry is None:
        raise DriverError(
            f"the driver has a camera, and nothing is installed that draws for it ({RENDERERS})"
        )
    renderer: Renderer = imported(entry.target)(road, camera, scene)
    return renderer
