"""The embedded simulator as a `Simulator`."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from functools import cache
from types import TracebackType
from typing import Any, ClassVar, Final, Self

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import cache_folder
from frenetic._support.entry_points import imported, installed
from frenetic._support.kernel_cache import VARIABLE
from frenetic.drive import Breakdown, Drive, Rules, Trajectory
from frenetic.drivers import Planner
from frenetic.drivers.camera import RENDERERS, Camera, Renderer, Scene
from frenetic.drivers.driver import (
    Driver,
    DriveSetup,
    blaming_driver,
    camera_of,
    checked_controls,
    scene_of,
    under_layers,
)
from frenetic.drivers.laws import setup_array
from frenetic.drivers.layers import Compiled, Noisy, compiled_form
from frenetic.errors import DriverError
from frenetic.oracle import judge, rules_array
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators.checks import Check, broken, drive_checks, time_of_drives
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.embedded.vehicle import (
    HEADING,
    SPEED,
    STEERING,
    YAW_RATE,
    Vehicle,
    X,
    Y,
)
from frenetic.simulators.observing import Observer
from frenetic.simulators.simulator import StartingPlace
from frenetic.simulators.wall_limit import WallLimitExceeded, wall_limit

SLOW: Final = 0.1
"""Wall time that no drive of a second needs where kernels are compiled, in s."""
_TIMED_DRIVES: Final = 20

_NO_ERRORS = np.empty((0, 2))


class EmbeddedSimulator(StartingPlace):
    """A dynamic single-track car in compiled code; a drive of 250 m takes about a millisecond.

    Args:
        rules: speed limit, oob tolerance and when a drive ends.
        vehicle: the car, or the name of one: ``default``, a BMW 320i, ``metadrive`` or
            ``etk800``; or the parameters in which it differs from the default, or from the one in
            ``name``. Without any, the driver brings its car: `frenetic.drivers.BeamngAi` an
            ``etk800``, others the default.
        friction: of the road, in place of the vehicle's: 1 is dry, 0.7 wet, 0.3 snow.
        wall_limit: s of wall time that a drive with a driver written in Python may take; then it
            is an ERROR. Built-in drivers end by the rules.
        start_offset: m to the left of the ego lane's centre at which the car starts, -2 to 2.
        start_heading: rad to the left of the road's direction in which it points there, within an
            eighth of a turn.

    `rules`, `vehicle`, `friction`, `start_offset` and `start_heading` may be set between two
    drives; they hold from the next one on.

    Raises:
        ValueError: an option is out of range.
    """

    draws: Final = True
    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its drives change; campaigns record it."""

    def __init__(
        self,
        *,
        rules: Rules | None = None,
        vehicle: Vehicle | str | Mapping[str, float | str] | None = None,
        friction: float | None = None,
        wall_limit: float = 60.0,
        start_offset: float = 0.0,
        start_heading: float = 0.0,
    ) -> None:
        self.rules = rules or Rules()
        if isinstance(vehicle, Mapping):
            vehicle = Vehicle.of(vehicle)
        elif isinstance(vehicle, str):
            vehicle = Vehicle.named(vehicle)
        self.vehicle = vehicle or Vehicle()
        self._brought = None if vehicle else "default"  # name of the car that the driver brings
        if friction is not None:
            self.friction = friction
        self.start_offset = start_offset
        self.start_heading = start_heading
        if not (math.isfinite(wall_limit) and wall_limit > 0.0):
            raise ValueError(f"wall_limit is {wall_limit}: a positive number of seconds is needed")
        self.wall_limit = wall_limit
        self._room = np.empty(0)  # memory for the records, used again and again

    @property
    def options(self) -> dict[str, Any]:
        """Its options beside the rules; of the start only unusual ones."""
        start = {"start_offset": self.start_offset, "start_heading": self.start_heading}
        unusual = {name: value for name, value in start.items() if value != 0.0}
        return {"vehicle": asdict(self.vehicle), "wall_limit": self.wall_limit, **unusual}

    @property
    def vehicle(self) -> Vehicle:
        """The car."""
        return self._vehicle

    @vehicle.setter
    def vehicle(self, vehicle: Vehicle) -> None:
        self._brought = None
        self._take(vehicle)

    def _take(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._parameters = vehicle.to_array()
        self.car = vehicle.body()
        self._car = self.car.to_array()

    @property
    def friction(self) -> float:
        """Friction of the road: 1 is dry."""
        return self.vehicle.friction

    @friction.setter
    def friction(self, friction: float) -> None:
        self._take(replace(self.vehicle, friction=friction))

    def check_driver(self, driver: Driver) -> None:
        """Takes the car that the driver brings, unless one was chosen."""
        brought = getattr(under_layers(driver), "VEHICLE", "default")
        if self._brought not in (None, brought):
            self._brought = brought
            self._take(replace(Vehicle.named(brought), friction=self.friction))

    def __enter__(self) -> Self:
        """Compiles kernels that are not compiled yet."""
        compile_kernels()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Ends nothing."""

    def checks(self) -> Iterator[Check]:
        """Checks of compiled kernels, their cache, two drives, and speed."""
        start = time.perf_counter()
        try:
            self.__enter__()
        except Exception as error:
            yield broken(
                "kernels", error, "reinstall numba; on a new Python it may have to be upgraded"
            )
            return
        yield Check("kernels", True, f"compiled, ready after {time.perf_counter() - start:.1f} s")
        yield _cache_check()
        yield from drive_checks(self)
        seconds = time_of_drives(self, Planner(), _TIMED_DRIVES)
        yield Check(
            "speed",
            seconds < SLOW,
            f"{1e3 * seconds:.2f} ms a drive",
            "" if seconds < SLOW else "unset NUMBA_DISABLE_JIT; is the machine busy?",
        )

    def drives_compiled(self, driver: Driver) -> bool:
        """Whether the driver's drives are compiled code alone."""
        is_ours = type(self) is EmbeddedSimulator
        return is_ours and compiled_form(driver, kernels.PERIOD) is not None

    def setup(self, road: Road) -> DriveSetup:
        """The setup of a drive along the road for its driver."""
        return self.vehicle.setup(self.rules, road, kernels.PERIOD)

    def drive(self, road: Road, driver: Driver) -> Drive:
        """One drive of the driver along the road."""
        self.check_driver(driver)
        rules = rules_array(self.rules, road.length)
        # The record after the timeout ends every drive.
        most = math.ceil(self.rules.timeout(road.length) / kernels.PERIOD) + 2
        columns_needed = len(Trajectory.names())
        if self._room.size < columns_needed * most:
            self._room = np.empty(columns_needed * most)
        room = self._room[: columns_needed * most].reshape(columns_needed, most)
        setup = self.setup(road)
        compiled = compiled_form(driver, setup.period)
        breakdown: Breakdown | None = None
        if compiled is not None:
            n = self._drive_compiled(road, compiled, setup, rules, room)
        else:
            n, breakdown = self._drive_python(road, driver, setup, room)
        path = Trajectory(*room[:, :n])
        return Drive.of(path, self.car, self.rules, road, breakdown)

    def _drive_compiled(
        self,
        road: Road,
        driver: Compiled,
        setup: DriveSetup,
        rules: FloatArray,
        room: FloatArray,
    ) -> int:
        errors = _NO_ERRORS if driver.errors is None else driver.errors.upto(room.shape[1])
        n: int = kernels.rollout(
            road.table,
            road.sub_step,
            road.lane_width,
            rules,
            self._car,
            self._parameters,
            driver.law,
            driver.parameters,
            setup_array(setup),
            driver.rows,
            driver.delay,
            errors,
            kernels.start_state(road.table, road.lane_width, self.start_offset, self.start_heading),
            room,
        )
        return n

    def _drive_python(
        self,
        road: Road,
        driver: Driver,
        setup: DriveSetup,
        room: FloatArray,
    ) -> tuple[int, Breakdown | None]:
        """The compiled rollout's loop with calls of the driver in between.

        Returns the number of records, and what broke it.
        """
        if not isinstance(under_layers(driver), _Rehearsing):
            rehearse()  # not on the driver's time
        try:
            camera = camera_of(driver)
        except DriverError as error:
            return 0, Breakdown.of(error)
        renderer = None
        if camera is not None:
            try:
                renderer = _renderer(road, camera, scene_of(driver))
            except DriverError as error:
                return 0, Breakdown.of(error)
            renderer.draw(*road.pose)  # likewise
        written = 0
        state = kernels.start_state(
            road.table, road.lane_width, self.start_offset, self.start_heading
        )
        controls = (0.0, 0.0, 0.0)

        def loop() -> None:
            nonlocal written, controls
            driver.reset(setup)
            observer = Observer(road, self.rules, self.car, room.shape[1])
            for i in range(room.shape[1]):
                kernels.write_record(room, i, state, *controls)
                written = i + 1
                if not observer.see(i * kernels.PERIOD, state[X], state[Y], state[HEADING]):
                    return
                image = None
                if renderer is not None:
                    image = renderer.draw(state[X], state[Y], state[HEADING])
                observation = observer.observation(
                    state[SPEED], state[YAW_RATE], state[STEERING], image
                )
                controls = checked_controls(driver.act(observation))
                kernels.write_record(room, i, state, *controls)
                kernels.advance_period(state, *controls, self._parameters)

        try:
            with wall_limit(self.wall_limit), blaming_driver():
                loop()
        except WallLimitExceeded as error:
            at = max(written - 1, 0) * kernels.PERIOD
            text = (
                f"the driver did not finish its drive within {self.wall_limit:g} s of wall time"
                f" (it had driven {at:.1f} s{error.place})"
            )
            return written, Breakdown.of(error, text)
        except DriverError as error:
            return written, Breakdown.of(error)
        return written, None


def _renderer(road: Road, camera: Camera, scene: Scene) -> Renderer:
    """What draws for a camera: the first that is installed.

    Raises:
        DriverError: none is.
    """
    for entry in installed(RENDERERS):
        renderer: Renderer = imported(entry.target)(road, camera, scene)
        return renderer
    raise DriverError(
        f"the driver has a camera, and nothing is installed that draws for it ({RENDERERS})"
    )


@cache
def compile_kernels() -> None:
    """Fits, validates, drives and judges one road, so that every kernel is ready afterwards.

    The first time on a machine this compiles for some seconds; the result is cached on disk, and
    then it takes a fraction of a second.
    """
    # Too long for the map unless it is turned, and not quite straight.
    road, verdict = Road([0.0] * 10 + [0.005] + [0.0] * 11).placed()
    assert road is not None
    assert verdict.valid, verdict.message
    simulator = EmbeddedSimulator()
    result = judge(road, simulator.drive(road, Planner()))
    assert result.outcome is Outcome.PASS, result.reason


class _Rehearsing(Planner):
    """The planner as a driver in Python."""


@cache
def rehearse() -> None:
    """Drives as a driver in Python does, which needs more kernels, so that these are ready, too."""
    compile_kernels()
    EmbeddedSimulator().drive(Road([0.0] * 5), Noisy(_Rehearsing()))


def _cache_check() -> Check:
    """Whether compiled kernels can be kept."""
    folder = cache_folder(kernels.rollout)
    if folder is None or not folder.is_dir():
        return Check("cache", False, "kernels are not cached", "unset NUMBA_DISABLE_JIT")
    if not os.access(folder, os.W_OK):
        return Check(
            "cache",
            False,
            f"{folder} cannot be written: kernels are compiled anew after every change",
            f"make it writable, or set {VARIABLE} to a folder that is",
        )
    return Check("cache", True, f"{folder} can be written")
