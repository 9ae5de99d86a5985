"""Recipes of published generators, tested on small generators in their places."""

from __future__ import annotations

from pathlib import Path

import pytest

from frenetic.campaign import RoadTester
from frenetic.drivers import Planner
from frenetic.errors import FreneticError
from frenetic.plugins.bench import RECIPES, Bench, End, RunTerms
from frenetic.plugins.bench.recipes import Recipe, find_recipe
from frenetic.simulators import EmbeddedSimulator

STRAIGHT = """
from pathlib import Path
from code_pipeline.tests_generation import RoadTestFactory

class {name}:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        # Like its original: it opens a file of the repository and keeps the last 40 s free.
        assert Path("rigaa-sbft2023/src/models/rl_model.zip").read_bytes() == b"model"
        x = 20.0
        while not self.executor.is_over():
            if self.executor.get_remaining_time()["time-budget"] >= 40:
                x += 10.0
                self.executor.execute_test(RoadTestFactory.create_road_test([(x, 20), (x, 90)]))
"""


def checkout(recipe: Recipe, folder: Path) -> Path:
    """Write a generator at the recipe's place in a folder; return the folder."""
    module, _, name = recipe.spec.partition(":")
    file = (folder / recipe.path).joinpath(*module.split(".")).with_suffix(".py")
    file.parent.mkdir(parents=True)
    file.write_text(STRAIGHT.format(name=name), encoding="utf-8")
    for needed in recipe.files:
        (folder / needed).touch()
    return folder


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_makes_an_entrant_of_its_files(name: str, tmp_path: Path) -> None:
    recipe = find_recipe(name)
    with pytest.raises(FreneticError, match=r"is not there; its path must be a folder with the"):
        recipe.entrant(tmp_path)
    folder = checkout(recipe, tmp_path)
    entrant = recipe.entrant(folder)
    assert entrant.name == recipe.title
    assert entrant.source() is not None  # the entrant's file was located
    assert entrant.copy is None or entrant.path is not None
    for needed, description in recipe.files.items():
        (folder / needed).unlink()
        with pytest.raises(FreneticError) as caught:
            recipe.entrant(folder)
        assert description in str(caught.value)
        (folder / needed).touch()


def test_a_generator_that_keeps_40_s_free_needs_tests_of_40_s_or_more(tmp_path: Path) -> None:
    recipe = find_recipe("rigaa-2023")
    folder = checkout(recipe, tmp_path / "files")
    (folder / "rigaa-sbft2023" / "src" / "models").mkdir()
    (folder / "rigaa-sbft2023" / "src" / "models" / "rl_model.zip").write_bytes(b"model")
    with pytest.raises(FreneticError, match="make a test cost 40 s or more"):
        recipe.require_enough_seconds(36.0)
    recipe.require_enough_seconds(40.0)
    bench = Bench(
        entrants=(recipe.entrant(folder),),
        terms=RunTerms(
            RoadTester(EmbeddedSimulator(), Planner()), simulations=3, seconds_per_test=40.0
        ),
        repeats=1,
        folder=tmp_path / "bench",
    )
    (end,) = bench.run()
    assert end.ending is not None
    assert (end.ending.end, end.ending.detail) == (End.OVER, "")
