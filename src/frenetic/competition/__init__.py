"""Frenetic as a plug-in of the official SBST/SBFT pipeline: its test generators.

``competition.py --module-name frenetic.competition --class-name Frenetic`` runs one. This package,
and what it imports of Frenetic, needs numpy and scipy only and works on Python 3.9. Taking one of
them out of it compiles all kernels, before the pipeline's clock starts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.competition.generator import Frenetic, Frenetic2021, Generator, RandomSearch

__all__ = ["Frenetic", "Frenetic2021", "Generator", "RandomSearch"]

__getattr__ = lazy_names(__name__, {"frenetic.competition.generator": __all__})
