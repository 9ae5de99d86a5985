"""Imported for its effect: loads BeamNGpy, which takes seconds, into the server of processes."""

from contextlib import suppress

from frenetic.plugins.beamng.link import beamngpy

with suppress(Exception):  # the process that uses it says what is wrong
    beamngpy()
