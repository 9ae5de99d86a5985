"""What the bench and the process of a generator say to each other: JSON objects, a line each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

Message = Mapping[str, Any]


@dataclass(frozen=True)
class Assignment:
    """A generator, and the terms on which it runs: the first that the bench sends."""

    module: str
    """``package.module``, or a file whose name ends with ``.py``."""
    class_name: str
    path: str | None
    """Folder that is put on the module path."""
    seed: int
    """Of `random` and of numpy's global generator."""
    map_size: float
    """m, as an integer if it is a whole number."""
    time_budget: float
    """Virtual s."""
    seconds_per_test: float
    """Virtual s that every executed test costs."""
    counts_computing: bool
    """Whether the time that the generator itself takes counts, too."""
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
    """What became of a test that the generator asked for."""

    outcome: str
    """PASS, FAIL, ERROR or INVALID."""
    description: str
    records: list[Any]
    """What was recorded of the drive: rows with the values of `SimulationDataRecord`."""
    spent: float
    """Virtual s of the budget so far."""
    simulated: float
    """s of simulated time."""

    @property
    def is_executed(self) -> bool:
        """Whether it cost a simulation."""
        return self.outcome != "INVALID"


@dataclass(frozen=True)
class End:
    """How a generator ended: the last that its process sends."""

    how: str
    """``over``: the budget was spent; ``returned`` or ``exit``, of its process: by itself before
    that; ``crashed``: it raised."""
    detail: str = ""
    """One line."""
    traceback: str = ""
    """Its last lines."""
    seconds: float = 0.0
    """Of wall time since ``start`` was called or the bench was last told of any."""
    threads: int = 0
    """That it left running."""
    kind: str = "end"
    """Which message this is."""
