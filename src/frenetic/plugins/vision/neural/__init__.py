"""Neural networks as drivers: a model in an ONNX file answers its camera's image.

The names below are imported when they are used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.plugins.vision.neural.convention import METADATA, PRESETS, Convention
    from frenetic.plugins.vision.neural.network import Dave2, Network

__all__ = ["METADATA", "PRESETS", "Convention", "Dave2", "Network"]

__getattr__ = lazy_names(__name__)
