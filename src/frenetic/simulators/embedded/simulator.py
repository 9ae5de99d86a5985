"""The embedded simulator as a `Simulator`, and the preparation of its kernels."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import cache
from typing import Any, ClassVar, Final

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Positive, check
from frenetic._support.compiled import cache_folder
from frenetic._support.interpreted import end_interpretation, is_interpreted, without_compiling
from frenetic._support.kernel_cache import VARIABLE
from frenetic.drivers import Planner
from frenetic.drivers.compiled_form import compiled_form
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.stack import camera_of, scene_of, unwrapped
from frenetic.drivers.wrappers import Noisy
from frenetic.errors import DriverError, Trouble
from frenetic.oracle.drive import Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.simulators.capabilities import check_road
from frenetic.simulators.checks import SimulatorCheck
from frenetic.simulators.drive_loop import run_drive
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.embedded.batch import (
    LONGEST_INTERPRETED,
    CompiledDrive,
    drive_side_by_side,
)
from frenetic.simulators.embedded.python_car import (
    EmbeddedCar,
    advance_to_record,
    new_renderer,
)
from frenetic.simulators.embedded.single_track import SPEED
from frenetic.simulators.embedded.vehicle import Vehicle
from frenetic.simulators.embedded.weather import weather_array
from frenetic.simulators.simulator import Amount, Ready, StartingPlace, unusual_amounts

_COMPILING_LIMIT: Final = 3600.0
"""Wall time that a drive may take in which kernels are compiled, in s; our choice."""


class EmbeddedSimulator(StartingPlace, Ready):
    """A dynamic single-track car in compiled code; a drive of 250 m takes about a millisecond.

    Args:
        rules: Speed limit, oob tolerance and when a drive ends.
        vehicle: The car: a `Vehicle`, or its name, which is ``default`` (a BMW 320i), ``metadrive``
            or ``etk800``, or a mapping of the parameters in which the car differs from the default
            one or from the one with the mapping's ``name``. None takes the car that the driver
            brings: `frenetic.drivers.BeamngAi` brings an ``etk800``, other drivers the default.
        friction: Friction of the road, in place of the vehicle's: 1 is dry, 0.7 wet, 0.3 snow.
        steering_lag: Time constant of the steering in s, in place of the vehicle's.
        wall_limit: Wall time that a drive with a driver written in Python may take, in s; a longer
            one is an ERROR. Drives of built-in drivers have no such limit.
        start_offset: Distance of the car's start to the left of the ego lane's centre, in m, -2..2.
        start_heading: Angle of the car's start to the left of the road's direction, in rad, within
            an eighth of a turn.
        start_speed: Speed of the car at the start, in km/h.
        load: Load in the car, spread between its axles, in kg. The driver's setup leaves it out.
        wet: Friction on one wet stretch of 40 m, as a share of the road's; 1 for no wet stretch.
        wet_at: Distance of the wet stretch's middle along the road in m; None for the road's
            middle.
        gust: Speed in m/s, positive to the left, of one gust across 60 m of the road, see
            `frenetic.simulators.embedded.weather`.
        gust_at: Distance of the gust's middle along the road in m; None for the road's middle.

    All but `wall_limit` may be set between two drives; they hold from the next drive on.

    Raises:
        ValueError: An option is out of range.
    """

    start_speed = Amount[float]("start_speed", 0.0)
    load = Amount[float]("load", 0.0)
    wet = Amount[float]("wet", 1.0)
    wet_at = Amount[float | None]("wet_at", None)
    gust = Amount[float]("gust", 0.0)
    gust_at = Amount[float | None]("gust_at", None)

    draws: Final = True
    lays_slopes: Final = True
    period_step: Final = kernels.STEP
    BEHAVIOUR: ClassVar[int] = 2
    """Version of the drives: to be increased when they change; campaigns record it."""

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
        start_speed: float = 0.0,
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
        # Name of the car that the last driver brought; None if a car was chosen
        self._driver_vehicle = None if vehicle else "default"
        if friction is not None:
            self.friction = friction
        self.start_offset = start_offset
        self.start_heading = start_heading
        self.start_speed = start_speed
        self.load, self.wet, self.gust = load, wet, gust
        self.wet_at, self.gust_at = wet_at, gust_at
        self.wall_limit = wall_limit

    @property
    def options(self) -> dict[str, Any]:
        """Options of the simulator beside the rules, without conditions at their usual amounts."""
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
        self._set_vehicle(vehicle)

    def _set_vehicle(self, vehicle: Vehicle) -> None:
        """Take over a car, and the car with this simulator's steering lag, which drives."""
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
        self._set_vehicle(replace(self.vehicle, friction=friction))

    @property
    def steering_lag(self) -> float | None:
        """Time constant of the steering, in s; None for the vehicle's."""
        return self._steering_lag

    @steering_lag.setter
    def steering_lag(self, lag: float | None) -> None:
        if lag is not None:
            replace(self.vehicle, steering_lag=lag)  # raises a ValueError for a lag out of range
        self._steering_lag = lag
        self._set_vehicle(self.vehicle)

    def check_driver(self, driver: Driver) -> None:
        """Take the car that the driver brings, unless a car was chosen."""
        vehicle = getattr(unwrapped(driver), "VEHICLE", "default")
        if self._driver_vehicle not in (None, vehicle):
            self._driver_vehicle = vehicle
            self._set_vehicle(replace(Vehicle.named(vehicle), friction=self.friction))

    def checks(self) -> Iterator[SimulatorCheck]:
        """Yield the check whether compiled kernels can be cached."""
        yield _cache_check()

    def drives_compiled(self, driver: Driver) -> bool:
        """Return whether the driver's drives run compiled code alone."""
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
        compiled = self.compiled_drive(road, driver)
        if compiled is None:
            return self._drive_python(road, driver, self.setup(road))
        return self.drive_compiled([compiled])[0]

    def drive_many(self, roads: Sequence[Road], driver: Driver, *, threads: int = 1) -> list[Drive]:
        """Drive along each road, and return the drives in the order of the roads.

        Each drive is the same as alone, bit for bit. Drives of a built-in driver run side by side,
        which takes about a third of the time.

        Args:
            roads: The roads.
            driver: The driver of each car.
            threads: Number of threads that drive with a built-in driver.

        Raises:
            RoadError: A road leans, rises or widens, and the driver has a camera.
            ValueError: The number of threads is less than 1.
        """
        compiled = [self.compiled_drive(road, driver) for road in roads]
        ready = [drive for drive in compiled if drive is not None]
        if len(ready) < len(compiled):
            return [self.drive(road, driver) for road in roads]
        return self.drive_compiled(ready, threads=threads)

    def compiled_drive(self, road: Road, driver: Driver) -> CompiledDrive | None:
        """Return a drive for `drive_compiled`, in the conditions that the simulator has now.

        Returns:
            The drive; None if the driver has to be called from Python.
        """
        self.check_driver(driver)
        compiled = compiled_form(driver, kernels.PERIOD)
        if compiled is None:
            return None
        parameters, weather = self._conditions(road)
        return CompiledDrive(
            road,
            self.rules,
            self.car,
            self.setup(road),
            parameters,
            weather,
            self._start(road),
            compiled,
        )

    def drive_compiled(self, drives: Sequence[CompiledDrive], *, threads: int = 1) -> list[Drive]:
        """Drive side by side, each drive in its own conditions; return the drives in this order.

        Args:
            drives: The drives, of `compiled_drive`.
            threads: Number of threads that drive.

        Raises:
            ValueError: The number of threads is less than 1.
        """
        if threads < 1:
            raise ValueError(f"threads is {threads}, but must be at least 1")
        return drive_side_by_side(drives, threads)

    def _drive_python(self, road: Road, driver: Driver, setup: DriveSetup) -> Drive:
        """Drive with the compiled rollout's kernels and calls of the driver in between."""
        check_road(self, driver, road)
        is_rehearsal = isinstance(unwrapped(driver), _Rehearsing)
        if not is_rehearsal and (road.length > LONGEST_INTERPRETED or not interprets_drives()):
            rehearse()  # before the driver's wall time is measured
        try:
            camera = camera_of(driver)
            renderer = None if camera is None else new_renderer(road, camera, scene_of(driver))
        except DriverError as error:
            return Drive(Trajectory.empty(), self.car, self.rules, road, Trouble.of(error))
        if renderer is not None:
            renderer.draw(*road.pose)  # the first picture takes longer: before that time, too
        car = EmbeddedCar(
            self._start(road),
            *self._conditions(road),
            road=road,
            rules=self.rules,
            body=self.car,
            renderer=renderer,
        )
        with without_compiling():
            return run_drive(
                car,
                driver,
                road=road,
                rules=self.rules,
                body=self.car,
                setup=setup,
                limit=self.wall_limit,
                period_step=self.period_step,
            )

    def _conditions(self, road: Road) -> tuple[FloatArray, FloatArray | None]:
        """Return the car's parameters with its load, and the weather, as the kernels take them."""
        car, parameters = self._steered, self._parameters
        if self.load:
            car = car.loaded(self.load)
            parameters = car.to_array()
        middle = 0.5 * road.length
        return parameters, weather_array(
            car,
            self.wet,
            self.gust,
            wet_at=middle if self.wet_at is None else self.wet_at,
            gust_at=middle if self.gust_at is None else self.gust_at,
        )

    def _start(self, road: Road) -> FloatArray:
        """Return the state (7,) of the car at the start of a drive."""
        state = kernels.start_state(
            road.table, road.lane_width, self.start_offset, self.start_heading
        )
        state[SPEED] = self.start_speed / 3.6
        return state


@cache
def compile_kernels() -> None:
    """Fit, validate, drive and judge one road, so that every kernel is compiled afterwards.

    On a machine's first call this takes some seconds. The compiled kernels are cached on disk, so a
    later call takes a fraction of a second. Call it where many drives follow: otherwise the first
    drives are interpreted, see `frenetic._support.interpreted`.
    """
    end_interpretation()
    with _compiling_rollout_elsewhere():
        _test_a_road(Planner())


def _test_a_road(driver: Driver) -> None:
    """Fit, validate, drive and judge one road."""
    # So long that fitting must turn it, and not quite straight: this runs every kernel.
    road = Road([0.0] * 10 + [0.005] + [0.0] * 11)
    placed, verdict = road.placed()
    assert placed is not None
    assert verdict.valid, verdict.message
    simulator = EmbeddedSimulator(wall_limit=_COMPILING_LIMIT)
    result = judge(placed, simulator.drive(placed, driver))
    assert result.outcome is Outcome.PASS, result.reason


@contextmanager
def _compiling_rollout_elsewhere() -> Iterator[None]:
    """Let another process compile the kernels of a drive meanwhile, if they are not on disk yet."""
    folder = cache_folder(kernels.rollout)
    if folder is None or next(folder.glob("rollout.*.nbi"), None) or not sys.executable:
        yield
        return
    drive = (
        f"from {__name__} import EmbeddedSimulator, Planner, Road, end_interpretation;"
        " end_interpretation(); EmbeddedSimulator().drive(Road([0.0] * 5), Planner())"
    )
    discard = subprocess.DEVNULL
    command = [sys.executable, "-P", "-c", drive]
    with subprocess.Popen(command, stdout=discard, stderr=discard):  # noqa: S603 - our own code
        yield


class _Rehearsing(Planner):
    """Planner that reads its observation's lane, to compile what only drivers in Python use."""

    def act(self, observation: Observation) -> Controls:
        """Return the planner's controls."""
        observation.lane()
        return super().act(observation)


@cache
def rehearse() -> None:
    """Do as `compile_kernels` with a driver in Python, whose drives use other kernels."""
    end_interpretation()
    _test_a_road(Noisy(_Rehearsing()))


def interprets_drives() -> bool:
    """Return whether kernels of drives with a driver in Python are interpreted for now."""
    return is_interpreted(advance_to_record)


def _cache_check() -> SimulatorCheck:
    """Return the check whether compiled kernels can be cached."""
    folder = cache_folder(kernels.rollout)
    if folder is None or not folder.is_dir():
        return SimulatorCheck(
            "cache",
            is_ok=False,
            state="kernels are not cached",
            remedy="unset NUMBA_DISABLE_JIT",
        )
    if not os.access(folder, os.W_OK):
        return SimulatorCheck(
            "cache",
            is_ok=False,
            state=f"{folder} cannot be written: kernels are compiled anew after every change",
            remedy=f"make it writable, or set {VARIABLE} to a folder that is",
        )
    return SimulatorCheck("cache", is_ok=True, state=f"{folder} can be written")
