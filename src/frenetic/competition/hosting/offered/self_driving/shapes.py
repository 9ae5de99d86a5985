"""The way to shapely, which only those need who ask for its objects."""

from __future__ import annotations

from typing import Any

from frenetic.errors import FreneticError


def shapely_geometry() -> Any:
    """Return the module `shapely.geometry`.

    Raises:
        FreneticError: It is not installed.

    """
    try:
        import shapely.geometry
    except ImportError:
        raise FreneticError(
            "a generator asks for a shapely object, but shapely is not installed: pip install"
            ' "frenetic-roads[bench]", or shapely for the interpreter that runs the generator'
        ) from None
    return shapely.geometry
