"""Compile or load what runs need, and import what takes long; importing this module does both.

The server from which runs are forked (on Linux) imports it, so runs have all this from the start.
"""

import scipy.interpolate  # noqa: F401 - for the competition's measures of a failure

from frenetic.plugins.bench.runs import compile_measures

compile_measures()
