"""The embedded simulator as a `Simulator`."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache
from typing import Any, ClassVar, Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Positive, check
from frenetic._support.compiled import cache_folder
from frenetic._support.entry_points import imported, installed
from frenetic._support.kernel_cache import VARIABLE
from frenetic.drivers import Planner
from frenetic.drivers.camera import RENDERERS, Camera, Image, Renderer, Scene
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.laws import setup_array
from frenetic.drivers.stack import camera_of, scene_of, unwrapped
from frenetic.drivers.wrappers import Noisy, compiled_form
from frenetic.errors import DriverError, Trouble
from frenetic.oracle.assessment import rules_array
from frenetic.oracle.drive import Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.checks import SimulatorCheck
from frenetic.simulators.drive_loop import follow
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.embedded.single_track import HEADING, X, Y
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.simulators.embedded.weather import weather_array
from frenetic.simulators.observer import in_metres_per_second
from frenetic.simulators.simulator import Amount, Ready, StartingPlace, unusual_amounts

_NO_ERRORS = np.empty((0, 2))


class EmbeddedSimulator(StartingPlace, Ready):
    """A dynamic single-track car in compiled code; a drive of 250 m takes about a millisecond.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        vehicle: the car, or the name of one: ``default``, a BMW 320i, ``metadrive`` or
            ``etk800``; or the parameters in which it differs from the default, or from the one in
            ``name``. Without any, the driver brings its car: `frenetic.drivers.BeamngAi` an
            ``etk800``, others the default.
        friction: of the road, in place of the vehicle's: 1 is dry, 0.7 wet, 0.3 snow.
        steering_lag: s, time constant of the steering, in place of the vehicle's.
        wall_limit: s of wall time that a drive with a driver written in Python may take; then it
            is an ERROR. Built-in drivers end by the rules.
        start_offset: m to the left of the ego lane's centre at which the car starts, -2 to 2.
        start_heading: rad to the left of the road's direction in which it points there, within an
            eighth of a turn.
        load: kg in the car, spread between its axles, of which the driver is not told.
        wet: friction on one wet stretch of 40 m, as a share of the road's; 1 for none.
        wet_at: m along the road, the stretch's middle; None for the road's.
        gust: m/s to the left, of one gust across 60 m of the road, see `weather`.
        gust_at: m along the road, the gust's middle; None for the road's.

    All but `wall_limit` may be set between two drives; they hold from the next one on.

    Raises:
        ValueError: An option is out of range.
    """

    load = Amount[float]("load", 0.0)
    wet = Amount[float]("wet", 1.0)
    wet_at = Amount[float | None]("wet_at", None)
    gust = Amount[float]("gust", 0.0)
    gust_at = Amount[float | None]("gust_at", None)

    draws: Final = True
    lays_slopes: Final = True
    period_step: Final = kernels.STEP
    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its drives change; campaigns record it."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        vehicle: Vehicle | str | Mapping[str, float | str] | None = None,
        friction: float | None = None,
        steering_lag: float | None = None,
        wall_limit: Positive = 60.0,
        start_offset: float = 0.0,
        start_heading: float = 0.0,
        load: float = 0.0,
        wet: float = 1.0,
        wet_at: float | None = None,
        gust: float = 0.0,
        gust_at: float | None = None,
    ) -> None:
        check({"wall_limit": wall_limit}, EmbeddedSimulator.__init__)
        self.rules = rules or Rules()
        if isinstance(vehicle, Mapping):
            vehicle = Vehicle.of(vehicle)
        elif isinstance(vehicle, str):
            vehicle = Vehicle.named(vehicle)
        self._steering_lag = steering_lag
        self.vehicle = vehicle or Vehicle()
        # Name of the vehicle that the driver brings:
        self._driver_vehicle = None if vehicle else "default"
        if friction is not None:
            self.friction = friction
        self.start_offset = start_offset
        self.start_heading = start_heading
        self.load, self.wet, self.gust = load, wet, gust
        self.wet_at, self.gust_at = wet_at, gust_at
        self.wall_limit = wall_limit
        self._room = np.empty(0)  # memory for the records, used again and again

    @property
    def options(self) -> dict[str, Any]:
        """Options of the simulator beside the rules; of conditions only unusual ones."""
        unusual = unusual_amounts(self)
        if self.steering_lag is not None:
            unusual["steering_lag"] = self.steering_lag
        return {"vehicle": asdict(self.vehicle), "wall_limit": self.wall_limit, **unusual}

    @property
    def vehicle(self) -> Vehicle:
        """The car."""
        return self._vehicle

    @vehicle.setter
    def vehicle(self, vehicle: Vehicle) -> None:
        self._driver_vehicle = None
        self._take(vehicle)

    def _take(self, vehicle: Vehicle) -> None:
        self._vehicle = self._steered = vehicle
        if self._steering_lag is not None:
            self._steered = replace(vehicle, steering_lag=self._steering_lag)
        self._parameters = self._steered.to_array()
        self.car = vehicle.body()
        self._car = self.car.to_array()

    @property
    def friction(self) -> float:
        """Friction of the road: 1 is dry."""
        return self.vehicle.friction

    @friction.setter
    def friction(self, friction: float) -> None:
        self._take(replace(self.vehicle, friction=friction))

    @property
    def steering_lag(self) -> float | None:
        """Time constant of the steering, in s; None if it is the vehicle's."""
        return self._steering_lag

    @steering_lag.setter
    def steering_lag(self, lag: float | None) -> None:
        if lag is not None:
            replace(self.vehicle, steering_lag=lag)  # which checks it
        self._steering_lag = lag
        self._take(self.vehicle)

    def check_driver(self, driver: Driver) -> None:
        """Take the car that the driver brings, unless a car was chosen."""
        vehicle = getattr(unwrapped(driver), "VEHICLE", "default")
        if self._driver_vehicle not in (None, vehicle):
            self._driver_vehicle = vehicle
            self._take(replace(Vehicle.named(vehicle), friction=self.friction))

    def __enter__(self) -> Self:
        """Compile kernels that are not compiled yet."""
        compile_kernels()
        return self

    def checks(self) -> Iterator[SimulatorCheck]:
        """Yield whether compiled kernels are cached."""
        yield _cache_check()

    def drives_compiled(self, driver: Driver) -> bool:
        """Return whether the driver's drives are compiled code alone."""
        is_ours = type(self) is EmbeddedSimulator
        return is_ours and compiled_form(driver, kernels.PERIOD) is not None

    def setup(self, road: Road) -> DriveSetup:
        """Return the setup of a drive along the road, for its driver."""
        return self._steered.setup(self.rules, road, kernels.PERIOD)

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Drive along the road.

        Raises:
            RoadError: The road leans, rises or widens, and the driver has a camera.
        """
        self.check_driver(driver)
        setup = self.setup(road)
        compiled = compiled_form(driver, setup.period)
        if compiled is None:
            return self._drive_python(road, driver, setup)
        # The record after the timeout ends every drive.
        most = math.ceil(self.rules.timeout(road.length) / kernels.PERIOD) + 2
        columns = len(Trajectory.names())
        if self._room.size < columns * most:
            self._room = np.empty(columns * most)
        room = self._room[: columns * most].reshape(columns, most)
        parameters, weather = self._conditions(road)
        limits = in_metres_per_second(self.rules.speed_limits_on(road))
        limits[:, 1] += compiled.excess
        n = kernels.rollout(
            road.table,
            road.sub_step,
            road.slopes,
            road.lane_width,
            rules_array(self.rules, road.length),
            self._car,
            parameters,
            compiled.law,
            compiled.parameters,
            setup_array(setup),
            compiled.rows,
            compiled.delay,
            _NO_ERRORS if compiled.errors is None else compiled.errors.upto(most),
            self._start(road),
            room,
            weather,
            limits,
        )
        return Drive(Trajectory(*room[:, :n]), self.car, self.rules, road)

    def _drive_python(self, road: Road, driver: Driver, setup: DriveSetup) -> Drive:
        """Drive with the compiled rollout's kernels and calls of the driver in between."""
        check_road(self, driver, road)
        if not isinstance(unwrapped(driver), _Rehearsing):
            rehearse()  # not on the driver's time
        try:
            camera = camera_of(driver)
            renderer = None if camera is None else _renderer(road, camera, scene_of(driver))
        except DriverError as error:
            return Drive(Trajectory.empty(), self.car, self.rules, road, Trouble.of(error))
        if renderer is not None:
            renderer.draw(*road.pose)  # nor this
        car = _EmbeddedCar(self._start(road), *self._conditions(road), road, renderer)
        return follow(
            car,
            road,
            self.rules,
            self.car,
            setup,
            driver,
            self.wall_limit,
            period_step=self.period_step,
        )

    def _conditions(self, road: Road) -> tuple[FloatArray, FloatArray]:
        """Return the car's parameters on this road, and its weather, as the kernels take them."""
        car, parameters = self._steered, self._parameters
        if self.load:
            car = car.loaded(self.load)
            parameters = car.to_array()
        places = (0.5 * road.length if at is None else at for at in (self.wet_at, self.gust_at))
        return parameters, weather_array(car, self.wet, self.gust, *places)

    def _start(self, road: Road) -> FloatArray:
        return kernels.start_state(
            road.table, road.lane_width, self.start_offset, self.start_heading
        )


class _EmbeddedCar:
    """A car that is moved for a driver in Python."""

    def __init__(
        self,
        state: FloatArray,
        parameters: FloatArray,
        weather: FloatArray,
        road: Road,
        renderer: Renderer | None,
    ) -> None:
        self._state = state
        self._ground = parameters, road.table, road.sub_step, road.slopes
        self._weather = weather
        self._s = 0.0  # a place of the car, on slopes and in weather
        self._renderer = renderer

    def motion(self) -> list[float]:
        """Return the state, whose order is the order of a trajectory's columns."""
        values: list[float] = self._state.tolist()
        return values

    def picture(self) -> Image | None:
        """Return what the camera sees; None without a camera."""
        state = self._state
        if self._renderer is None:
            return None
        return self._renderer.draw(state[X], state[Y], state[HEADING])

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Move the car on."""
        steps = round(seconds / kernels.STEP)
        self._s = kernels.advance_period(
            self._state,
            steering,
            throttle,
            brake,
            *self._ground,
            self._s,
            self._weather,
            steps,
        )


def _renderer(road: Road, camera: Camera, scene: Scene) -> Renderer:
    """Return a renderer for a camera, the first that is installed.

    Raises:
        DriverError: No renderer is installed.
    """
    for entry in installed(RENDERERS):
        renderer: Renderer = imported(entry.target)(road, camera, scene)
        return renderer
    raise DriverError(
        f"the driver has a camera, and nothing is installed that draws for it ({RENDERERS})"
    )


@cache
def compile_kernels() -> None:
    """Fit, validate, drive and judge one road, so that every kernel is ready afterwards.

    The first time on a machine this compiles for some seconds; the result is cached on disk, and
    then it takes a fraction of a second.
    """
    # Too long for the map unless it is turned, and not quite straight.
    road = Road([0.0] * 10 + [0.005] + [0.0] * 11)
    with _driving_elsewhere():
        placed, verdict = road.placed()
        assert placed is not None
        assert verdict.valid, verdict.message
        result = judge(placed, EmbeddedSimulator().drive(placed, Planner()))
    assert result.outcome is Outcome.PASS, result.reason


@contextmanager
def _driving_elsewhere() -> Iterator[None]:
    """Have another process compile a drive's kernels meanwhile, where none is on disk yet."""
    folder = cache_folder(kernels.rollout)
    if folder is None or next(folder.glob("rollout.*.nbi"), None) or not sys.executable:
        yield
        return
    drive = (
        f"from {__name__} import EmbeddedSimulator, Planner, Road;"
        " EmbeddedSimulator().drive(Road([0.0] * 5), Planner())"
    )
    nowhere = subprocess.DEVNULL
    command = [sys.executable, "-P", "-c", drive]
    with subprocess.Popen(command, stdout=nowhere, stderr=nowhere):  # noqa: S603 - our own code
        yield


class _Rehearsing(Planner):
    """The planner as a driver in Python, which looks at the lane, too."""

    def act(self, observation: Observation) -> Controls:
        """Return the planner's controls."""
        observation.lane()
        return super().act(observation)


@cache
def rehearse() -> None:
    """Drive as a driver in Python does, which needs more kernels, so that they are ready."""
    compile_kernels()
    EmbeddedSimulator().drive(Road([0.0] * 5), Noisy(_Rehearsing()))


def _cache_check() -> SimulatorCheck:
    """Return whether compiled kernels can be cached."""
    folder = cache_folder(kernels.rollout)
    if folder is None or not folder.is_dir():
        return SimulatorCheck("cache", False, "kernels are not cached", "unset NUMBA_DISABLE_JIT")
    if not os.access(folder, os.W_OK):
        return SimulatorCheck(
            "cache",
            False,
            f"{folder} cannot be written: kernels are compiled anew after every change",
            f"make it writable, or set {VARIABLE} to a folder that is",
        )
    return SimulatorCheck("cache", True, f"{folder} can be written")
