"""Drives of built-in drivers side by side: the arrays of the compiled rollout, and its drives."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.interpreted import end_interpretation
from frenetic.drivers.compiled_form import Compiled
from frenetic.drivers.driver import DriveSetup
from frenetic.drivers.laws import new_memory, setup_array
from frenetic.drivers.sensor_errors import new_sensor_memories
from frenetic.drivers.steering_errors import STEERING_STATE_SIZE
from frenetic.oracle.assessment import rules_array
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.drive_assessment import ASSESSMENT_SIZE, Assessment, DriveAssessment
from frenetic.road import Road
from frenetic.road.geometry import WIDENING
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.observer import in_metres_per_second

_MOST_DRIVES: Final = 64
"""Largest number of drives in a batch, whose records take about 10 MB; our choice."""
LONGEST_INTERPRETED: Final = 5_000.0
"""Length of roads above which kernels are compiled at once, in m: interpreted, a drive takes 0.7 s
of processor time for 1 km; our choice."""


@dataclass(frozen=True, eq=False)
class CompiledDrive:
    """A drive of a built-in driver along a road, ready to be driven in its conditions."""

    road: Road
    rules: Rules
    body: CarBody
    """The box that the car covers."""
    setup: DriveSetup
    """Setup of the drive, for the driver."""
    parameters: FloatArray
    """`Vehicle.to_array` of the car as it is loaded, (32,)."""
    weather: FloatArray | None
    """See `frenetic.simulators.embedded.weather`."""
    state: FloatArray
    """State of the car at the start, (7,)."""
    driver: Compiled

    @property
    def most_records(self) -> int:
        """Largest number of records."""
        # The record at 0 s, and the one after the timeout, which ends every drive, are two more.
        return math.ceil(self.rules.timeout(self.road.length) / kernels.PERIOD) + 2

    @property
    def kind(self) -> tuple[int, bool, bool, bool]:
        """Law, and whether there are slopes, weather and errors of sensors or steering.

        It is alike for all drives of a batch.
        """
        has_slopes, has_weather = len(self.road.slopes) > 0, self.weather is not None
        return self.driver.law, has_slopes, has_weather, self.driver.interface is not None


def drive_side_by_side(drives: Sequence[CompiledDrive], threads: int) -> list[Drive]:
    """Drive, and return the drives in the same order, with their assessments.

    Each drive is the same as alone, bit for bit.

    Args:
        drives: the drives.
        threads: number of threads that drive.
    """
    if sum(drive.road.length for drive in drives) > LONGEST_INTERPRETED:
        end_interpretation()
    # Errors are drawn before threads read them: drives may share a sequence of errors.
    for drive in drives:
        if drive.driver.errors is not None:
            drive.driver.errors.upto(drive.most_records)
        if drive.driver.interface is not None:
            drive.driver.interface.dropped(drive.most_records, kernels.PERIOD)
    batches = _batches(drives, threads)
    batch_drives = [[drives[k] for k in batch] for batch in batches]
    if threads == 1 or len(batches) == 1:
        driven = [_drive_batch(batch) for batch in batch_drives]
    else:
        with ThreadPoolExecutor(threads) as pool:
            driven = list(pool.map(_drive_batch, batch_drives))
    in_order = dict(zip(chain(*batches), chain(*driven), strict=True))
    return [in_order[k] for k in range(len(drives))]


def _batches(drives: Sequence[CompiledDrive], threads: int) -> list[list[int]]:
    """Return the numbers of the drives in batches, each of drives of one kind."""
    numbers: dict[tuple[int, bool, bool, bool], list[int]] = defaultdict(list)
    for k, drive in enumerate(drives):
        numbers[drive.kind].append(k)
    batches = []
    for alike in numbers.values():
        size = min(math.ceil(len(alike) / threads), _MOST_DRIVES)
        batches += [alike[i : i + size] for i in range(0, len(alike), size)]
    return batches


def _drive_batch(drives: Sequence[CompiledDrive]) -> list[Drive]:
    """Drive drives of one kind."""
    count, most_records = len(drives), max(drive.most_records for drive in drives)
    cars = kernels.CarArrays(
        np.array([drive.body.to_array() for drive in drives]),
        np.array([drive.parameters for drive in drives]),
        np.array([drive.state for drive in drives]),
        np.empty((count, most_records, kernels.RECORD_SIZE)),
        np.empty((count, most_records, ASSESSMENT_SIZE)),
        np.zeros(count),
        np.zeros(count, np.int64),
        np.zeros(count, np.int64),
    )
    slopes = _slopes([drive.road for drive in drives])
    has_weather = drives[0].weather is not None
    kernels.rollout(
        tuple(_roads(drives)),
        None if slopes is None else tuple(slopes),
        np.array([drive.weather for drive in drives]) if has_weather else None,
        tuple(_drivers(drives, most_records)),
        _interfaces(drives, most_records),
        new_memory(drives[0].driver.law, count),
        tuple(cars),
    )
    return [_drive(drive, cars, k) for k, drive in enumerate(drives)]


def _drivers(drives: Sequence[CompiledDrive], most_records: int) -> kernels.Drivers:
    """Return the drivers as the kernel takes them."""
    drivers = [drive.driver for drive in drives]
    have_errors = any(driver.errors is not None for driver in drivers)
    errors = np.zeros((len(drives), most_records if have_errors else 0, 2))
    for k, driver in enumerate(drivers):
        if driver.errors is not None:
            errors[k] = driver.errors.upto(most_records)[:most_records]
    return kernels.Drivers(
        drivers[0].law,
        np.array([driver.parameters for driver in drivers]),
        np.array([setup_array(drive.setup) for drive in drives]),
        np.array([driver.rows for driver in drivers]),
        np.array([driver.delay for driver in drivers]),
        errors,
    )


def _interfaces(drives: Sequence[CompiledDrive], most_records: int) -> kernels.Fields | None:
    """Return the sensors and the steering as the kernel takes them; None if nothing errs."""
    interfaces = [drive.driver.interface for drive in drives if drive.driver.interface is not None]
    if not interfaces:
        return None
    count, period = len(drives), kernels.PERIOD
    return tuple(
        kernels.Interfaces(
            np.array([interface.biases for interface in interfaces]),
            np.array([interface.dropped(most_records, period) for interface in interfaces]),
            new_sensor_memories(count),
            np.array([interface.steering for interface in interfaces]),
            np.zeros((count, STEERING_STATE_SIZE)),
        )
    )


def _roads(drives: Sequence[CompiledDrive]) -> kernels.Roads:
    """Return the roads as the kernel takes them."""
    roads = [drive.road for drive in drives]
    widens = any(road.table.shape[1] > WIDENING for road in roads)
    tables, first_rows = _joined([_widened(road.table) if widens else road.table for road in roads])
    tables.setflags(write=False)  # as a road's table: kernels are compiled for such arrays
    limits, first_limits = _joined([_limits(drive) for drive in drives])
    return kernels.Roads(
        tables,
        first_rows,
        np.array([road.sub_step for road in roads]),
        np.array([road.lane_width for road in roads]),
        np.array([rules_array(drive.rules, drive.road.length) for drive in drives]),
        limits,
        first_limits,
    )


def _limits(drive: CompiledDrive) -> FloatArray:
    """Return the limits to which the driver keeps, (k, 2): station in m, and limit in m/s."""
    limits = in_metres_per_second(drive.rules.speed_limits_on(drive.road))
    limits[:, 1] += drive.driver.excess
    return limits


def _widened(table: FloatArray) -> FloatArray:
    """Return a road's table with the column of the widening, which is 0 if the road has none."""
    if table.shape[1] > WIDENING:
        return table
    return np.column_stack([table, np.zeros(len(table))])


def _slopes(roads: Sequence[Road]) -> kernels.Slopes | None:
    """Return the slopes of roads, of which all or none have slopes; None for flat roads."""
    if not len(roads[0].slopes):
        return None
    slopes, first_rows = _joined([road.slopes for road in roads])
    slopes.setflags(write=False)
    return kernels.Slopes(slopes, first_rows)


def _joined(arrays: Sequence[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Return arrays one after the other, and the first row of each with the number of rows."""
    lengths: npt.NDArray[np.int64] = np.array([0, *map(len, arrays)])
    return np.concatenate(arrays), np.cumsum(lengths)


def _drive(drive: CompiledDrive, cars: kernels.CarArrays, k: int) -> Drive:
    """Return the drive of car ``k``, with the assessment that the kernel made on the way."""
    road, rules, body = drive.road, drive.rules, drive.body
    count = int(cars.counts[k])
    path = Trajectory.from_rows(cars.records[k, :count])
    assessment = Assessment.of(road, int(cars.ends[k]), cars.assessments[k, :count])
    assessed = DriveAssessment(assessment, (road, rules, body, path))
    return Drive(path, body, rules, road, assessed=assessed)
