"""Imported for its effect: compiles the kernels or loads them.

The server from which worker processes are forked (Linux) imports this, so they have the kernels
from the start.
"""

from frenetic.simulators.embedded import rehearse

rehearse()
