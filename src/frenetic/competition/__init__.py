"""Frenetic as a plug-in of the official SBST/SBFT pipeline: its test generators.

``competition.py --module-name frenetic.competition --class-name Frenetic`` runs one. This package,
and what it imports of Frenetic, needs numpy and scipy only and works on Python 3.9.
"""

from __future__ import annotations

from frenetic.competition.generator import Frenetic, Frenetic2021, Generator, RandomSearch

__all__ = ["Frenetic", "Frenetic2021", "Generator", "RandomSearch"]
