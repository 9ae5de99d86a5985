"""Messages between the bench and a generator's process: JSON objects, a line each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Message = Mapping[str, Any]


@dataclass(frozen=True)
class Assignment:
    """A generator and its terms: the bench's first message."""

    module: str
    """``package.module``, or a file whose name ends with ``.py``."""
    class_name: str
    path: str | None
    """Folder that is put on the module path."""
    seed: int
    """Seed of `random` and of numpy's global generator."""
    map_size: float
    """Map size in m, as an integer if it is a whole number."""
    time_budget: float
    """Budget in virtual s."""
    seconds_per_test: float
    """Virtual s that every executed test costs."""
    counts_computing: bool
    """Whether the generator's own time counts, too."""
    oob_tolerance: float
    """Share 0..1 of the car that may be outside the lane."""
    speed_limit: float
    """km/h."""
    result_folder: str

    @property
    def is_file(self) -> bool:
        """Whether the module is given as a file."""
        return self.module.endswith(".py")


@dataclass(frozen=True)
class Answer:
    """Result of a test that the generator asked for."""

    outcome: str
    """PASS, FAIL, ERROR or INVALID."""
    description: str
    records: list[Any]
    """Record of the drive: rows with the values of `SimulationDataRecord`."""
    spent: float
    """Virtual s of the budget so far."""
    simulated: float
    """Simulated time, in s."""

    @property
    def is_executed(self) -> bool:
        """Whether it cost a simulation."""
        return self.outcome != "INVALID"


@dataclass(frozen=True)
class End:
    """End of a generator: its process's last message."""

    how: str
    """``over``: the budget was spent; ``returned`` or ``exit``, of its process: by itself before
    that; ``crashed``: it raised."""
    detail: str = ""
    """One line."""
    traceback: str = ""
    """Its last lines."""
    seconds: float = 0.0
    """Wall time since ``start`` was called or the bench last got any, in s."""
    threads: int = 0
    """Number of threads that it left running."""
    kind: str = "end"
    """Kind of the message."""
