"""What watches a car in BeamNG.tech."""

from __future__ import annotations

from frenetic.competition.hosting.offered.elsewhere import OnlyByName


class OutOfBoundsMonitor(OnlyByName):
    """The pipeline's watch on a car in BeamNG.tech."""
