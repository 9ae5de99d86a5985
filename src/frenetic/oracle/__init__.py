"""The oracle: the record of a drive, and the verdict whether the car kept its lane."""

TYPE_CHECKING = False  # numba takes its time
if TYPE_CHECKING:
    from typing import Any

    from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
    from frenetic.oracle.outcome import Outcome
    from frenetic.oracle.verdict import Finding, Result, judge


def __getattr__(name: str) -> "Any":
    from frenetic._support.public_names import lazy_names

    return lazy_names(__name__)(name)


__all__ = [
    "CarBody",
    "Drive",
    "Finding",
    "Outcome",
    "Result",
    "Rules",
    "Trajectory",
    "judge",
]
