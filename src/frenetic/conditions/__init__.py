"""Conditions of a drive, such as noise or friction, and domains: distributions of conditions."""

TYPE_CHECKING = False  # importing `typing` takes time
if TYPE_CHECKING:
    from typing import Any

    from frenetic.conditions.condition import known_conditions
    from frenetic.conditions.declaration import Condition
    from frenetic.conditions.domain import Distribution, Domain

_MODULES = {
    "Distribution": "frenetic.conditions.domain",
    "Domain": "frenetic.conditions.domain",
    "Condition": "frenetic.conditions.declaration",
    "known_conditions": "frenetic.conditions.condition",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> "Any":
    from frenetic._support.lazy_names import import_name  # only where a name is used

    return import_name(__name__, _MODULES, name)


__all__ = ["Condition", "Distribution", "Domain", "known_conditions"]
