"""Parts by their names: strategies, drivers and simulators, their versions, and whose code runs."""
