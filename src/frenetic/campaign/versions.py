"""What a campaign's results depend on, beside its parts."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Final

PACKAGES: Final = ("frenetic-roads", "numpy", "numba", "scipy")
"""Distributions whose versions a campaign records: its results depend on them."""


def package_versions() -> dict[str, str]:
    """Versions of Python and of what a campaign's results depend on."""
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "unknown"
    return versions
