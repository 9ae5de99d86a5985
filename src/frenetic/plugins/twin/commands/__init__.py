"""The command of twins: ``frenetic calibrate``."""
