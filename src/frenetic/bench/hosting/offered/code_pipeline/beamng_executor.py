"""The executor with BeamNG.tech."""

from __future__ import annotations

from frenetic.bench.hosting.offered.placeholder import Placeholder


class BeamngExecutor(Placeholder):
    """The pipeline's executor with BeamNG.tech."""
