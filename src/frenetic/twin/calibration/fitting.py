"""The fit: CMA-ES proposes values of the parameters, the twin drives, the loss judges.

The state of a fit on disk is its `Journal`: what was driven, line by line, so that a killed fit
goes on. The optimiser is never stored: with the same seed it proposes the same candidates again,
and those that are in the journal need no driving. A line is written whole and flushed to the disk
before the next generation is proposed; a torn last line is ignored.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from cmaes import CMA
from filelock import lock_descriptor

from frenetic._support.arrays import FloatArray
from frenetic.errors import FreneticError
from frenetic.twin.calibration.driving import IntArray, TwinDriver
from frenetic.twin.calibration.loss import Loss
from frenetic.twin.calibration.parameters import Model

_SIGMA: Final = 0.25
"""First step size, as a share of the bounds' distance."""
_NEAR_SIGMA: Final = 0.1
"""The same around a good candidate."""
_EDGE: Final = 0.02
"""Least distance of the first mean from the bounds."""
_CONVERGED: Final = 1e-3
"""Range of a generation, as a share of the bounds' distance, at which a fit begins again."""


class Stopped(Exception):  # noqa: N818  # no error: the user asked
    """The user asked to stop; what was driven is stored."""


@dataclass(frozen=True, eq=False)
class Evaluated:
    """A candidate with its loss."""

    places: FloatArray
    """(parameters,) 0..1 between the bounds."""
    contributions: FloatArray
    """(drives,) shares of the drives in the loss."""

    @property
    def loss(self) -> float:
        """The loss, the mean of the contributions."""
        return float(self.contributions.mean())


class Journal:
    """A file of results, by key; a context manager.

    Args:
        path: of the file; None for no file.
        settings: digest of all that the results depend on. A file of other settings is replaced.
    """

    def __init__(self, path: Path | str | None, settings: str) -> None:
        self._path = None if path is None else Path(path)
        self._settings = settings
        self._known: dict[str, FloatArray] = {}
        self._file: Any = None
        self.found = 0
        """Number of results that an earlier call has left."""

    def __enter__(self) -> Self:
        """Reads what is there.

        Raises:
            FreneticError: it cannot be read or written, or another process writes it.
        """
        if self._path is None:
            return self
        head = json.dumps({"settings": self._settings}).encode()
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.touch()
            self._file = self._path.open("r+b")
            if not lock_descriptor(self._file.fileno(), blocking=False):
                raise BlockingIOError
            *lines, torn = self._file.read().split(b"\n")
            if lines and lines[0] == head:
                for line in lines[1:]:
                    with suppress(ValueError, KeyError, TypeError):
                        entry = json.loads(line)
                        self._known[str(entry["key"])] = np.array(entry["values"], dtype=np.float64)
                self._file.seek(-len(torn), os.SEEK_END)
                self._file.truncate()
            else:
                self._file.seek(0)
                self._file.truncate()
                self._file.write(head + b"\n")
                self._flush()
            self.found = len(self._known)
        except (BlockingIOError, PermissionError):
            self.close()
            raise FreneticError(
                f"{self._path} is being written by another process, or may not be: wait for that,"
                " or choose another place"
            ) from None
        except OSError as error:
            self.close()
            raise FreneticError(
                f"{self._path} cannot be written: {error.strerror or error}; choose another place"
            ) from None
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the file, which stays."""
        self.close()

    def close(self) -> None:
        """Closes the file; later results are not kept."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def get(self, key: str, count: int) -> FloatArray | None:
        """The results under a key, (count, ...); None if they are not there."""
        found = self._known.get(key)
        return None if found is None or len(found) != count else found

    def put(self, key: str, values: FloatArray | Sequence[float]) -> None:
        """Stores results under a key."""
        if self._file is not None:
            entry = {"key": key, "values": np.asarray(values).tolist()}
            self._file.write(json.dumps(entry).encode() + b"\n")
            self._flush()

    def remove(self) -> None:
        """Removes the file, when it is no longer needed."""
        if self._path is not None:
            self.close()
            with suppress(OSError):
                self._path.unlink()

    def _flush(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())


class Evaluator:
    """Drives candidates on some recorded drives, or finds them in the journal.

    Args:
        model: of the twin.
        twins: drives them.
        journal: keeps what was driven.
        notify: called with the number of candidates, after each batch.
        should_stop: asked before each batch.
    """

    def __init__(
        self,
        model: Model,
        twins: TwinDriver,
        journal: Journal,
        notify: Callable[[int], None],
        should_stop: Callable[[], bool],
    ) -> None:
        self.model = model
        self.twins = twins
        self._journal = journal
        self._notify = notify
        self._should_stop = should_stop

    def rows(self, key: str, places: FloatArray, indices: IntArray) -> FloatArray:
        """The twin's drives of one candidate, (indices, COLUMNS), kept in full.

        Raises:
            Stopped: the user asked to stop.
        """
        found = self._journal.get(key, len(indices))
        if found is None:
            self._check()
            found = self.twins.rows([self.model.values(list(places))], indices)[0]
            self._journal.put(key, found)
        self._notify(1)
        return found

    def evaluate(
        self, key: str, batch: FloatArray, indices: IntArray, loss: Loss
    ) -> list[Evaluated]:
        """Candidates with their losses.

        Args:
            key: of the batch in the journal.
            batch: (candidates, parameters) places.
            indices: of the recorded drives.
            loss: on them.

        Raises:
            Stopped: the user asked to stop.
        """
        found = self._journal.get(key, len(batch))
        if found is None:
            self._check()
            rows = self.twins.rows([self.model.values(list(one)) for one in batch], indices)
            found = np.stack([loss.contributions(one) for one in rows])
            self._journal.put(key, found)
        self._notify(len(batch))
        return [Evaluated(one, told) for one, told in zip(batch, found, strict=True)]

    def _check(self) -> None:
        if self._should_stop():
            raise Stopped


def fit(
    evaluator: Evaluator,
    key: str,
    indices: IntArray,
    loss: Loss,
    *,
    seed: int,
    evaluations: int,
    start: FloatArray | None = None,
) -> list[Evaluated]:
    """All candidates of a fit, in the order of driving; the first is the model as it was.

    The search is CMA-ES within the bounds (`cmaes`), from the model's own values. When it has
    converged, it begins again from the middle with twice as many candidates at once.

    Args:
        evaluator: drives the candidates.
        key: of this fit in the journal.
        indices: of the recorded drives.
        loss: on them.
        seed: of the search.
        evaluations: number of candidates, at least 1; the last generation is driven whole.
        start: (parameters,) places of a good candidate to begin around; by default the model's.

    Raises:
        Stopped: the user asked to stop.
    """
    parameters = evaluator.model.parameters
    p = len(parameters)
    sigma = _SIGMA if start is None else _NEAR_SIGMA
    own = np.array([parameter.place(parameter.start) for parameter in parameters])
    found = evaluator.evaluate(f"{key} start", own[None, :], indices, loss)
    size = 4 + math.floor(3.0 * math.log(p + 1))
    generator = np.random.default_rng(seed)
    mean = np.clip(own if start is None else start, _EDGE, 1.0 - _EDGE)
    number = 0
    while len(found) < evaluations:
        search = _search(mean, sigma, size, int(generator.integers(2**31)))
        width = 1.0
        while len(found) < evaluations and width > _CONVERGED and not search.should_stop():
            asked = np.stack([search.ask() for _ in range(search.population_size)])
            driven = evaluator.evaluate(f"{key} {number}", asked[:, :p], indices, loss)
            # One parameter alone has a second, idle place that costs nothing.
            told = [(x, one.loss) for x, one in zip(asked, driven, strict=True)]
            search.tell(told)
            found += driven
            number += 1
            width = float(np.ptp(asked[:, :p], axis=0).max())
        size *= 2
        sigma = _SIGMA
        mean = np.full(p, 0.5)
    return found


def _search(mean: FloatArray, sigma: float, size: int, seed: int) -> CMA:
    padded = np.concatenate((mean, np.full(max(0, 2 - len(mean)), 0.5)))
    bounds = np.tile([0.0, 1.0], (len(padded), 1))
    return CMA(mean=padded, sigma=sigma, bounds=bounds, seed=seed, population_size=size)


def best(candidates: list[Evaluated]) -> Evaluated:
    """The candidate of least loss, the first of equal ones."""
    return min(candidates, key=lambda one: one.loss)
