"""RILaST behind the pipeline's interface.

What stands for RILaST here has the gaps of the published one, and no search.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from textwrap import dedent

import pytest

from frenetic.bench import Bench, End, Ending, Terms, find_recipe
from frenetic.campaign import CampaignStore
from frenetic.drivers import Planner
from frenetic.simulators import EmbeddedSimulator

pytestmark = pytest.mark.usefixtures("new_process_server")

FILES = {
    "__init__": """
        from aerialist.px4.obstacle import Obstacle
        from rilast.problems.lkas_vae_problem import LKASVAEProblem
        """,
    "common/load_config": """
        import json, os
        class yaml:
            safe_load = json.loads
        def load_config(name):
            return open("rilast\\\\test_generators\\\\configs" + os.sep + name + ".yaml")
        """,
    "problems/lkas_problem": """
        class LKASProblem:
            requires_kwargs = False
            def __init__(self, executor):
                self.executor = executor
        """,
    "test_generators/abstract_test_generator": """
        import time
        def get_random_seed():
            return time.time()
        """,
    "test_generators/lkas_test_generator": """
        from rilast.problems.lkas_problem import LKASProblem
        class LKASTestGenerator:
            def __init__(self, map_size):
                self.beamng_executor = BeamngExecutor("results", map_size)
            def problem(self):
                return LKASProblem(executor=self.beamng_executor)
        """,
    "test_generators/latent_lkas_test_generator": """
        import random
        from beamng_sim.code_pipeline.beamng_executor import BeamngExecutor
        from beamng_sim.code_pipeline.test_analysis import compute_all_features
        from beamng_sim.code_pipeline.tests_generation import RoadTestFactory
        from rilast.common.load_config import load_config
        from rilast.test_generators import abstract_test_generator
        from rilast.test_generators.lkas_test_generator import LKASTestGenerator
        class LatentGenerator:
            @property
            def size(self):
                return self.size
        class LatentLKASTestGenerator(LKASTestGenerator):
            def __init__(self, map_size):
                super().__init__(map_size)
                self.config = load_config("latent_lkas_test_generator")
            def start(self, alg, cross, mut):
                open(self.config["model_path"]).close()
                LatentGenerator().size = self.nDim
                problem = self.problem()
                assert problem.requires_kwargs
                random.seed(abstract_test_generator.get_random_seed())
                while True:
                    points = [(20.0 + 15.0 * i, 100.0 + random.random()) for i in range(self.nDim)]
                    test = RoadTestFactory.create_road_test(points)
                    try:
                        _, _, records = problem.executor.execute_test(test)
                        compute_all_features(test, records)
                    except Exception as error:
                        print(error)
        """,
}


def test_it_searches_with_the_benchs_executor_and_seed(tmp_path: Path) -> None:
    package = tmp_path / "RILaST" / "rilast"
    for name, text in FILES.items():
        file = package / f"{name}.py"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(dedent(text), encoding="utf-8")
    (package.parent / "model.pt").touch()
    pipeline = package.parent / "beamng_sim"
    shutil.copytree(Path(__file__).parent / "generators" / "clone", pipeline)
    for file in pipeline.rglob("*.py"):
        text = file.read_text("utf-8")
        for name in ("code_pipeline", "self_driving"):
            text = text.replace(f"from {name}", f"from beamng_sim.{name}")
        file.write_text(text, "utf-8")
    (pipeline / "code_pipeline" / "beamng_executor.py").write_text("class BeamngExecutor: ...\n")
    (pipeline / "code_pipeline" / "test_analysis.py").write_text(
        "def compute_all_features(test, records): assert records\n"
    )
    configuration = package / "test_generators" / "configs" / "latent_lkas_test_generator.yaml"
    configuration.parent.mkdir()
    configuration.write_text('{"nDim": 8, "model_path": "model.pt"}', encoding="utf-8")
    terms = Terms(simulator=EmbeddedSimulator(), driver=Planner(), simulations=3)
    roads = []
    for name in ("one", "again"):
        entrant = find_recipe("rilast-2025").entrant(package.parent)
        bench = Bench(entrants=(entrant,), terms=terms, repeats=1, folder=tmp_path / name)
        (end,) = bench.run(workers=1)
        assert end.ending == Ending(End.OVER), end
        with CampaignStore.open(bench.runs[0].folder) as store:
            roads.append([(test.outcome, test.moobd) for test in store.tests()])
    assert len(roads[0]) == 3
    assert roads[0] == roads[1]
