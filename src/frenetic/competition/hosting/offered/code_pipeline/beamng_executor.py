"""The executor with BeamNG.tech."""

from __future__ import annotations

from frenetic.competition.hosting.offered.elsewhere import OnlyByName


class BeamngExecutor(OnlyByName):
    """The pipeline's executor with BeamNG.tech."""
