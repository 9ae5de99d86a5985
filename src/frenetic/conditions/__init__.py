"""Conditions of a drive, such as noise or grip, and domains: how often they and roads occur."""

TYPE_CHECKING = False  # numba takes its time
if TYPE_CHECKING:
    from typing import Any

    from frenetic.conditions.condition import Quantity, quantities
    from frenetic.conditions.domain import Distribution, Domain


def __getattr__(name: str) -> "Any":
    from frenetic._support.public_names import lazy_names

    return lazy_names(__name__)(name)


__all__ = ["Distribution", "Domain", "Quantity", "quantities"]
