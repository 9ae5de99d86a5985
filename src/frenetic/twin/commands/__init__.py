"""The commands of twins: calibrate, rank."""
