"""Importing this module loads the compiled kernels, if they are on disk.

On Linux, the server from which worker processes are forked imports it, so that each worker has the
kernels from the start.
"""

from frenetic.simulators.embedded import interprets_drives, rehearse

if not interprets_drives():
    rehearse()
