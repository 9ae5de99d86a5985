"""Comparison of road generators, others' and our own, with repeats, on the same terms.

The names are imported on use, so that the help of its command comes at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.bench.bench import Bench
    from frenetic.bench.entrants import Entrant
    from frenetic.bench.file import BenchFile, open_bench
    from frenetic.bench.recipes import RECIPES, Recipe, find_recipe
    from frenetic.bench.runs import Run, RunState, Terms
    from frenetic.bench.strategy import End, Ending

__getattr__ = lazy_names(
    __name__,
    {
        "frenetic.bench.bench": ("Bench",),
        "frenetic.bench.entrants": ("Entrant",),
        "frenetic.bench.file": ("BenchFile", "open_bench"),
        "frenetic.bench.recipes": ("RECIPES", "Recipe", "find_recipe"),
        "frenetic.bench.runs": ("Run", "RunState", "Terms"),
        "frenetic.bench.strategy": ("End", "Ending"),
    },
)

__all__ = [
    "RECIPES",
    "Bench",
    "BenchFile",
    "End",
    "Ending",
    "Entrant",
    "Recipe",
    "Run",
    "RunState",
    "Terms",
    "find_recipe",
    "open_bench",
]
