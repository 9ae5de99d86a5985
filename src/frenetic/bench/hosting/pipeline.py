"""The pipeline's modules on the module path: a generator's own, or stand-ins for a lone file."""

from __future__ import annotations

import os
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from frenetic.bench.hosting.validity import overlaps_not

STAND_INS: Final = Path(__file__).resolve().parent / "standins"
PACKAGES: Final = ("code_pipeline", "self_driving")
_UNUSED: Final = ("beamngpy", "cv2", "descartes", "tensorflow")


class Unused(MetaPathFinder, Loader):
    """Gives the pipeline what it imports to drive and draw, which nobody does here.

    Every name of such a module is an empty class. Installed packages come first.
    """

    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        """Return a module's spec, None for all that is used."""
        unused = name.partition(".")[0] in _UNUSED
        return ModuleSpec(name, self, is_package=True) if unused else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module."""
        module = ModuleType(spec.name)
        module.__getattr__ = _empty_class  # type: ignore[method-assign]
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing: it is whole."""


def _empty_class(name: str) -> type:
    if name.startswith("__"):  # what the import system asks for
        raise AttributeError(name)
    return type(name, (), {"__init__": lambda *_, **__: None})


def offer(folder: str | None) -> None:
    """Make the pipeline's modules importable.

    Args:
        folder: with the pipeline's own; without any, the stand-ins are used, and of a part of the
            pipeline on the module path what these lack.

    """
    if folder is None:
        sys.path.insert(0, str(STAND_INS))
        return
    sys.path.insert(sys.path.index("") + 1, folder)
    sys.meta_path.append(Unused())
    os.environ["MPLBACKEND"] = "Agg"
    os.environ.setdefault("USERPROFILE", str(Path.home()))  # which the pipeline reads


def quicken() -> None:
    """Replace the self-intersection test of the pipeline's modules imported so far by ours."""
    for name, module in list(sys.modules.items()):
        if name.endswith("self_driving.road_polygon"):
            module.RoadPolygon.is_valid = overlaps_not
