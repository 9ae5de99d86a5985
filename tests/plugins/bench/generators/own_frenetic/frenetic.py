"""A generator in a module that is called like our package."""

from code_pipeline.tests_generation import RoadTestFactory


class Frenetic:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        import frenetic

        assert frenetic.Frenetic is type(self)
        while not self.executor.is_over():
            test = RoadTestFactory.create_road_test([(50.0, 20.0), (60.0, 60.0), (60.0, 90.0)])
            assert self.executor.validate_test(test) == (True, "")
            self.executor.execute_test(test)
