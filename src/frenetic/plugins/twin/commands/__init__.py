"""The commands of twins: calibrate."""
