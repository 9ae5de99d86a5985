"""Road generators held against each other: others' and our own, with repeats, on the same terms."""

from __future__ import annotations

from frenetic.bench.bench import Bench, BenchProgress, RunState, new_folder, read_bench
from frenetic.bench.entrants import Entrant
from frenetic.bench.processes import Run, RunEnd
from frenetic.bench.proposing import End, Ending
from frenetic.bench.running import Terms, run_entrant

__all__ = [
    "Bench",
    "BenchProgress",
    "End",
    "Ending",
    "Entrant",
    "Run",
    "RunEnd",
    "RunState",
    "Terms",
    "new_folder",
    "read_bench",
    "run_entrant",
]
