"""Errors of BeamNG.tech."""

from __future__ import annotations

from frenetic.errors import FreneticError


class BeamngError(FreneticError):
    """BeamNG.tech cannot be started or reached, or it broke.

    Args:
        found: what is wrong.
        remedy: what to do, if known; the message ends with it.
    """

    def __init__(self, found: str, remedy: str = "") -> None:
        super().__init__(f"{found}: {remedy}" if remedy else found)
        self.found = found
        self.remedy = remedy
