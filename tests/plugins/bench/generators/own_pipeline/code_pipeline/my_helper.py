"""Imports a module of the pipeline, which the bench provides."""

from code_pipeline.tests_generation import RoadTest


def straight_road(length):
    assert RoadTest is not None
    return [(100.0, 20.0), (100.0, 20.0 + length)]
