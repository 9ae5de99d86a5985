"""Domains as ASAM OpenODD 1.0 YAML, read and written, and what was driven in them.

The package ``openodd-py`` (extra ``odd``) reads and judges; it is imported when it is used.
"""

from frenetic.openodd.reading import read_domain
from frenetic.openodd.writing import domain_document, write_campaign

__all__ = ["domain_document", "read_domain", "write_campaign"]
