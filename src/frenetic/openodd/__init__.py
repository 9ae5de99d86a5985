"""Domains in ASAM OpenODD 1.0 YAML.

The package ``openodd-py`` (extra ``odd``) reads and judges; it is imported when it is used.
"""

from frenetic.openodd.reading import read_domain

__all__ = ["read_domain"]
