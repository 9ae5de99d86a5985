"""Plug-ins that come with us: simulators, drivers, searches and commands beyond the core.

Each is found by its entry points, as a stranger's package is: the core imports none of them.
"""
