"""Roads that were driven before, driven again: how often they fail, where else, and how short."""
