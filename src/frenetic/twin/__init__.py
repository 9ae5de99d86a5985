"""Twins: a driver in a fast simulator that stands in for a slow one."""

from frenetic.twin.profile import Profile
from frenetic.twin.screening import screened
from frenetic.twin.twin import Twin

__all__ = ["Profile", "Twin", "screened"]
