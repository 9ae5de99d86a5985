"""What a process is told to run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Assignment:
    """A generator, and the terms on which it runs."""

    module: str
    """``package.module``, or a file whose name ends with ``.py``."""
    class_name: str
    path: Path | None
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
    result_folder: Path

    @property
    def is_file(self) -> bool:
        """Whether the module is given as a file."""
        return self.module.endswith(".py")

    @classmethod
    def from_json(cls, message: Mapping[str, Any]) -> Assignment:
        """Return what the first object that the bench sends says."""
        path = message["path"]
        return cls(
            module=message["module"],
            class_name=message["class"],
            path=None if path is None else Path(path),
            seed=message["seed"],
            map_size=message["map_size"],
            time_budget=message["time_budget"],
            seconds_per_test=message["seconds_per_test"],
            counts_computing=message["counts_computing"],
            oob_tolerance=message["oob_tolerance"],
            speed_limit=message["speed_limit"],
            result_folder=Path(message["result_folder"]),
        )
