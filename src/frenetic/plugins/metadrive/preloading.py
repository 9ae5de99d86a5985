"""Imported for its effect: loads MetaDrive, which takes seconds, into the server of processes."""

from contextlib import suppress

with suppress(Exception):  # the process that uses it says what is wrong
    import frenetic.plugins.metadrive.world  # noqa: F401
