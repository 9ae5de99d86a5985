"""What goes wrong with BeamNG.tech."""

from __future__ import annotations

from frenetic.errors import FreneticError


class BeamngError(FreneticError):
    """BeamNG.tech cannot be started or reached, or it broke; the message says what to do."""
