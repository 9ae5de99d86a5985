"""Comparison of road generators, others' and our own, with repeats, on the same terms.

The names are imported on use, so that the help of its command comes at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.plugins.bench.bench import Bench
    from frenetic.plugins.bench.entrants import Entrant
    from frenetic.plugins.bench.file import open_bench
    from frenetic.plugins.bench.recipes import RECIPES
    from frenetic.plugins.bench.runs import RunState, RunTerms
    from frenetic.plugins.bench.strategy import End

__getattr__ = lazy_names(__name__)

__all__ = [
    "RECIPES",
    "Bench",
    "End",
    "Entrant",
    "RunState",
    "RunTerms",
    "open_bench",
]
