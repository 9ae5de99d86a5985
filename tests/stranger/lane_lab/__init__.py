"""A stranger's package: a driver, a wrapper, a strategy, a simulator and a command."""
