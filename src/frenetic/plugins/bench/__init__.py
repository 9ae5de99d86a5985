"""Comparison of road generators and search strategies, with repeats, on the same terms.

Names are imported on use: the modules would slow down ``frenetic bench --help``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.plugins.bench.bench import Bench
    from frenetic.plugins.bench.entrants import Entrant
    from frenetic.plugins.bench.file import open_bench
    from frenetic.plugins.bench.recipes import RECIPES
    from frenetic.plugins.bench.runs import RunState, RunTerms
    from frenetic.plugins.bench.strategy import End

__all__ = [
    "RECIPES",
    "Bench",
    "End",
    "Entrant",
    "RunState",
    "RunTerms",
    "open_bench",
]

_MODULES = {
    "RECIPES": "frenetic.plugins.bench.recipes",
    "Bench": "frenetic.plugins.bench.bench",
    "End": "frenetic.plugins.bench.strategy",
    "Entrant": "frenetic.plugins.bench.entrants",
    "RunState": "frenetic.plugins.bench.runs",
    "RunTerms": "frenetic.plugins.bench.runs",
    "open_bench": "frenetic.plugins.bench.file",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
