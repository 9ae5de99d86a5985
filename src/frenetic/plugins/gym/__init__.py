"""Lane keeping in the embedded simulator as an environment of Gymnasium (extra ``gym``).

Importing this registers ``frenetic/LaneKeeping-v0``, so either of these makes it::

    import gymnasium
    import frenetic.plugins.gym

    gymnasium.make("frenetic/LaneKeeping-v0")
    gymnasium.make("frenetic.plugins.gym:frenetic/LaneKeeping-v0")  # imports it by itself

`gymnasium.make_vec` makes `LaneKeepingVectorEnv`, which steps all its cars in one compiled call.
"""

from typing import Final

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError

try:
    import gymnasium
except ImportError as error:
    raise FreneticError(
        f"the environment needs Gymnasium, which is not installed: {pip_install('gym')}"
    ) from error

from frenetic.plugins.gym.cars import FAILURE
from frenetic.plugins.gym.environment import LaneKeepingEnv, LaneKeepingVectorEnv

__all__ = ["FAILURE", "ID", "LaneKeepingEnv", "LaneKeepingVectorEnv"]

ID: Final = "frenetic/LaneKeeping-v0"
"""Name of the environment."""

gymnasium.register(
    ID,
    entry_point="frenetic.plugins.gym.environment:LaneKeepingEnv",
    vector_entry_point="frenetic.plugins.gym.environment:LaneKeepingVectorEnv",
)
