"""The monitor of a car in BeamNG.tech."""

from __future__ import annotations

from frenetic.bench.hosting.offered.placeholder import Placeholder


class OutOfBoundsMonitor(Placeholder):
    """The pipeline's monitor of a car in BeamNG.tech."""
