"""Candidates driven: the twin on the recorded roads, compared with the record, on all cores."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Self, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.drivers.driver import Driver
from frenetic.errors import FreneticError
from frenetic.oracle import REACHED, assess
from frenetic.simulators.embedded import compile_kernels
from frenetic.simulators.isolated import BrokenDriveError, isolated
from frenetic.simulators.simulator import Simulator
from frenetic.twin.calibration.parameters import Model
from frenetic.twin.calibration.recordings import RecordedDrive, on_grid
from frenetic.worker import MOST_WORKERS, LostWorkerError, Worker, pack, ready

IntArray: TypeAlias = npt.NDArray[np.int64]

# Columns of a twin's drive.
FAILED, SHARE, MOOBD, OOB_DISTANCE, STEERING = range(5)
"""0 or 1; largest oob share 0..1; m; mean oob distance in m; standard deviation in rad."""
COVERED, OFFSET, SPEED, OFFSET_MEDIAN = range(5, 9)
"""Share 0..1 of the recorded places that the twin reached; there, the mean absolute errors of
offset (m) and speed (m/s), and the median of the offset's. NaN without a record."""
COLUMNS: Final = 9
_CHUNK: Final = 25  # drives of a task


def drive_twin(
    recorded: RecordedDrive,
    driver: Driver,
    simulator: Simulator,
) -> FloatArray:
    """The twin's drive along a recorded road, (COLUMNS,); NaN if the driver broke or hung.

    Args:
        recorded: the recorded drive.
        driver: the twin's.
        simulator: the twin's, whose rules become those of the record.
    """
    row = np.full(COLUMNS, math.nan)
    try:
        drive = simulator.drive(recorded.road, driver)
    except BrokenDriveError:
        return row
    if drive.error is not None:
        return row
    seen = assess(recorded.road, drive)
    n = len(seen.distance)
    row[FAILED] = seen.end != REACHED
    row[SHARE] = seen.oob_share.max()
    row[MOOBD] = seen.oob_distance.min()
    row[OOB_DISTANCE] = seen.oob_distance.mean()
    row[STEERING] = drive.trajectory.steering[:n].std()
    if len(recorded.offset):
        offset, speed = on_grid(seen.distance, seen.lateral_offset, drive.trajectory.speed[:n])
        m = min(len(offset), len(recorded.offset))
        both = np.flatnonzero(np.isfinite(offset[:m]) & np.isfinite(recorded.offset[:m]))
        row[COVERED] = len(both) / max(1, int(np.isfinite(recorded.offset).sum()))
        if len(both):
            aside = np.abs(offset[both] - recorded.offset[both])
            row[OFFSET], row[OFFSET_MEDIAN] = aside.mean(), np.median(aside)
            row[SPEED] = np.abs(speed[both] - recorded.speed[both]).mean()
    return row


@dataclass(frozen=True, eq=False)
class _Work:
    """What candidates are driven on."""

    model: Model
    drives: Sequence[RecordedDrive]
    drive_limit: float | None

    def start(self) -> None:
        compile_kernels()

    def rows(self, values: Mapping[str, float], indices: Sequence[int]) -> FloatArray:
        rows = np.full((len(indices), COLUMNS), math.nan)
        try:
            driver, simulator = self.model.make(values, self.drives[0].rules)
        except (FreneticError, ValueError):
            return rows  # together, values within their bounds may be no car
        with isolated(simulator, driver, self.drive_limit) as own:
            for i, index in enumerate(indices):
                rows[i] = drive_twin(self.drives[index], driver, own)
        return rows


class TwinDriver:
    """Drives candidates along recorded roads; a context manager.

    The results are the same whatever the number of workers.

    Args:
        model: of the twin.
        drives: the recorded ones.
        workers: number of processes; with 1, this one drives. A driver that is not compiled drives
            in a process of its own beside each.
        drive_limit: s after which a drive counts as hanging, as for `IsolatedSimulator`.
        notify: called with the number of candidates, after each batch.
    """

    def __init__(
        self,
        model: Model,
        drives: Sequence[RecordedDrive],
        *,
        workers: int = 1,
        drive_limit: float | None = None,
        notify: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.start = np.array([one.place for one in model.parameters])
        """(parameters,) places of the model as it was."""
        self._work = _Work(model, drives, drive_limit)
        self._notify = notify
        self._workers: list[Worker] = []
        if workers > 1:
            held = pack(self._work)
            count = min(workers, MOST_WORKERS)
            self._workers = [Worker(f"worker {number}", held) for number in range(1, count + 1)]

    def __enter__(self) -> Self:
        """Starts the processes."""
        compile_kernels()
        try:
            for worker in self._workers:
                worker.start()
        except BaseException:  # Ctrl-C
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Ends the processes."""
        for worker in self._workers:
            worker.kill()

    def rows(self, batch: FloatArray, indices: IntArray) -> FloatArray:
        """The drives of candidates, (candidates, indices, COLUMNS).

        Args:
            batch: (candidates, parameters) places 0..1 between the bounds.
            indices: of the recorded drives.

        Raises:
            FreneticError: a worker was lost.
        """
        candidates = [self._work.model.values(places.tolist()) for places in batch]
        wanted = indices.tolist()
        if self._workers:
            rows = self._by_workers(candidates, wanted)
        else:
            rows = np.stack([self._work.rows(values, wanted) for values in candidates])
        self._notify(len(candidates))
        return rows

    def checked(self, places: FloatArray, indices: IntArray) -> FloatArray:
        """The drives of one candidate, (indices, COLUMNS).

        Raises:
            FreneticError: a worker was lost, or the driver broke.
        """
        rows: FloatArray = self.rows(places[None, :], indices)[0]
        broken = np.flatnonzero(np.isnan(rows[:, SHARE]))
        if not len(broken):
            return rows
        model, first = self._work.model, self._work.drives[indices[broken[0]]]
        values = model.values(places.tolist())
        driver, simulator = model.make(values, first.rules)
        try:
            with isolated(simulator, driver, self._work.drive_limit) as own:
                why = own.drive(first.road, driver).error or "not any more, when driven again"
        except BrokenDriveError as error:
            why = str(error)
        told = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
        raise FreneticError(
            f"the driver {model.driver!r} with {told} broke on {len(broken)} of {len(indices)}"
            f" recorded roads that it drove, first on that of {first.name}: {why}"
        )

    def _by_workers(
        self, candidates: Sequence[Mapping[str, float]], wanted: Sequence[int]
    ) -> FloatArray:
        chunks = [wanted[i : i + _CHUNK] for i in range(0, len(wanted), _CHUNK)]
        tasks = [(values, chunk) for values in candidates for chunk in chunks]
        waiting = deque(enumerate(tasks))
        driving: dict[Worker, int] = {}  # number of the task
        found: dict[int, FloatArray] = {}
        try:
            while len(found) < len(tasks):
                for worker in self._workers:
                    if waiting and not len(worker):
                        driving[worker], task = waiting.popleft()
                        worker.send("rows", *task, limit=math.inf)
                for worker in ready(self._workers):
                    for rows in worker.receive():
                        if rows is not None:
                            found[driving[worker]] = rows
        except LostWorkerError as error:
            raise FreneticError(
                f"{worker.name} was lost: {error.reason}; with 1 worker one process drives"
            ) from None
        rows = np.concatenate([found[number] for number in range(len(tasks))])
        return rows.reshape(len(candidates), len(wanted), COLUMNS)
