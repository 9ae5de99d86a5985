"""Imported for its effect: compiles or loads what runs need, and imports what takes long.

The server from which runs are forked (Linux) imports this, so they have it from the start.
"""

import scipy.interpolate  # noqa: F401 - for the competition's measures of a failure

from frenetic.plugins.bench.runs import compile_measures

compile_measures()
