"""A stranger's package: a driver, a layer, a strategy, a simulator and a command of its own."""
