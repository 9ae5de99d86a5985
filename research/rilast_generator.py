"""RILaST behind the interface of the competition's pipeline, see field.md.

RILaST (GitHub: swat-lab-optimization/RILaST) is no generator of the competition but a program of
its own: a genetic algorithm in the latent space of an autoencoder that was trained on roads of much
curvature. Here its ``LatentLKASTestGenerator`` searches with its own model, dataset and
configuration and the settings of its README (``ga``, ``sbx``, ``pm``). None of its files is
changed. In its process, the bench's executor stands for its own, the bench's seed for the clock's,
and this system's paths for those of Windows. It has the pipeline in its folder ``beamng_sim``.

No commit of its repository runs as it is. The latest, f92df1c, lacks a module that it imports and
does not use, reads ``nDim`` before it sets it, assigns to a property, and expects its algorithm as
an argument that pymoo leaves out unless it is told to pass it: that much is mended here, also in
its process. Aerialist, which it needs for drones only, is left out.
"""

from __future__ import annotations

import importlib
import random
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

UNUSED = {
    "aerialist.px4.obstacle": "Obstacle",
    "aerialist.px4.drone_test": "DroneTest",
    "rilast.problems.lkas_vae_problem": "LKASVAEProblem",
}
FILES = ("dataset_path", "model_path")


class RILaST:
    """A generator of the pipeline of 2022 to 2024.

    Args:
        executor: of the pipeline. It ends the process when the budget is spent.
        map_size: m, side of the square map.
    """

    def __init__(self, executor: Any = None, map_size: int = 200) -> None:
        for name, unused in UNUSED.items():
            sys.modules[name] = ModuleType(name)
            setattr(sys.modules[name], unused, type(unused, (), {}))
        configurations = _rilast("common.load_config")
        configurations.load_config = lambda name: _configuration(name, configurations)
        _rilast("test_generators.abstract_test_generator").get_random_seed = _seed
        problem = _rilast("problems.lkas_problem").LKASProblem
        plain = _rilast("test_generators.lkas_test_generator")
        plain.BeamngExecutor = lambda *_, **__: executor
        plain.LKASProblem = lambda **options: _with_algorithm(problem(**options))
        latent = _rilast("test_generators.latent_lkas_test_generator")
        latent.LatentGenerator.size = None
        self._generator = latent.LatentLKASTestGenerator(map_size=map_size)
        self._generator.nDim = self._generator.config["nDim"]

    def start(self) -> None:
        """Searches until the executor ends it."""
        self._generator.start(alg="ga", cross="sbx", mut="pm")


def _rilast(name: str) -> Any:
    return importlib.import_module(f"rilast.{name}")


def _configuration(name: str, loader: Any) -> dict[str, Any]:
    """RILaST's configuration of a test generator, with files that any folder finds."""
    package = Path(loader.__file__).parents[1]
    file = package / "test_generators" / "configs" / f"{name}.yaml"
    values: dict[str, Any] = loader.yaml.safe_load(file.read_text(encoding="utf-8"))
    return values | {key: str(package.parent / values[key]) for key in FILES if key in values}


def _seed() -> int:
    """A seed that the bench's seed repeats."""
    return random.randrange(2**31)  # noqa: S311 - a search, no secret


def _with_algorithm(problem: Any) -> Any:
    """A problem that pymoo tells its algorithm."""
    problem.requires_kwargs = True
    return problem
