"""The oracle: the record of a drive, and the verdict whether the car kept its lane."""

TYPE_CHECKING = False  # importing `typing` takes time
if TYPE_CHECKING:
    from typing import Any

    from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
    from frenetic.oracle.outcome import Outcome
    from frenetic.oracle.verdict import Finding, Result, judge

_MODULES = {
    "CarBody": "frenetic.oracle.drive",
    "Drive": "frenetic.oracle.drive",
    "Finding": "frenetic.oracle.verdict",
    "Outcome": "frenetic.oracle.outcome",
    "Result": "frenetic.oracle.verdict",
    "Rules": "frenetic.oracle.drive",
    "Trajectory": "frenetic.oracle.drive",
    "judge": "frenetic.oracle.verdict",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> "Any":
    from frenetic._support.lazy_names import import_name  # only where a name is used

    return import_name(__name__, _MODULES, name)


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
