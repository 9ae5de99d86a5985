"""Imported for its effect: compiles the kernels or loads them.

Where worker processes are forked from a server (Linux), it has imported this, so that they have the
kernels from the start.
"""

from frenetic.simulators.embedded import compile_kernels

compile_kernels()
