"""Importing this module compiles the kernels or loads them.

On Linux, the server from which worker processes are forked imports it, so that each worker has the
kernels from the start.
"""

from frenetic.simulators.embedded import rehearse

rehearse()
