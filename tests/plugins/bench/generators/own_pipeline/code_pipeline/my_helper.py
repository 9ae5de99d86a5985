"""Builds on a module that the bench offers."""

from code_pipeline.tests_generation import RoadTest


def straight_road(length):
    assert RoadTest is not None
    return [(100.0, 20.0), (100.0, 20.0 + length)]
