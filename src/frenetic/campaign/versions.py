"""Versions that a campaign's results depend on."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Final

PACKAGES: Final = ("frenetic-roads", "numpy", "numba", "scipy")
"""Distributions that a campaign's results depend on."""


def package_versions() -> dict[str, str]:
    """Versions of Python and of these distributions."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions
