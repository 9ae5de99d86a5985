"""Opens a file relative to its repository, and writes beside its source."""

from pathlib import Path

from code_pipeline.tests_generation import RoadTestFactory


class AtHome:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor
        self.numbers = Path("tool/data/places.txt").read_text(encoding="utf-8").split()

    def start(self):
        for x in map(float, self.numbers):
            test = RoadTestFactory.create_road_test([(x, 20.0), (x, 120.0)])
            outcome, _, _ = self.executor.execute_test(test)
            with (Path(__file__).parent / "outcomes.txt").open("a", encoding="utf-8") as file:
                file.write(f"{outcome}\n")
