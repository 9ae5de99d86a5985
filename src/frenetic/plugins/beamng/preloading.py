"""Importing this module loads BeamNGpy, which takes seconds, before worker processes are forked."""

from contextlib import suppress

from frenetic.plugins.beamng.package import beamngpy

with suppress(Exception):  # a process that uses BeamNGpy raises the error again
    beamngpy()
