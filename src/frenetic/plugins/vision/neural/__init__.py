"""Neural networks as drivers: a model in an ONNX file gets images or vectors, and steers.

The names below are imported when they are used, so the command line stays fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.plugins.vision.neural.convention import METADATA, PRESETS, Convention
    from frenetic.plugins.vision.neural.network import Dave2, Network

__all__ = ["METADATA", "PRESETS", "Convention", "Dave2", "Network"]

_MODULES = {
    "METADATA": "frenetic.plugins.vision.neural.convention",
    "PRESETS": "frenetic.plugins.vision.neural.convention",
    "Convention": "frenetic.plugins.vision.neural.convention",
    "Dave2": "frenetic.plugins.vision.neural.network",
    "Network": "frenetic.plugins.vision.neural.network",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
