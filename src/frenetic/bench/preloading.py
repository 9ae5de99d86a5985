"""Imported for its effect: the processes of runs are forked from a server that has all of this."""

import frenetic.bench.running
import frenetic.campaign.workers.preloading  # noqa: F401
