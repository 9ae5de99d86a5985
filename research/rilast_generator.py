"""RILaST behind the interface of the competition's pipeline, see field.md.

RILaST (GitHub: swat-lab-optimization/RILaST) is a program, not a generator of the competition: a
genetic algorithm in the latent space of an autoencoder that was trained on roads of much curvature.
Here RILaST's ``LatentLKASTestGenerator`` searches with RILaST's model, dataset and configuration,
and with the settings of RILaST's README (``ga``, ``sbx``, ``pm``). RILaST contains the pipeline, in
its folder ``beamng_sim``.

No file of RILaST is changed; in RILaST's process this module replaces its executor by the bench's
executor, its seed from the clock by the bench's seed, and its Windows paths by paths of this
system.

No commit of RILaST's repository runs as it is. The latest, f92df1c, has four defects, which this
module mends in the process: it imports a missing module, which it does not use; it reads ``nDim``
before it sets ``nDim``; it assigns to a property; its problem needs the algorithm as an argument,
which pymoo passes only on request. Aerialist, which only drones need, is left out.
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
"""Module that RILaST imports but does not use for roads -> the class that RILaST imports."""
FILES = ("dataset_path", "model_path")
"""Entries of RILaST's configuration that are paths of files."""


class RILaST:
    """A generator of the pipeline of 2022 to 2024.

    Args:
        executor: the pipeline's executor. It ends the process when the budget is spent.
        map_size: side of the square map, in m.
    """

    def __init__(self, executor: Any = None, map_size: int = 200) -> None:
        for name, class_name in UNUSED.items():
            sys.modules[name] = ModuleType(name)
            setattr(sys.modules[name], class_name, type(class_name, (), {}))
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
        """Search until the executor ends the process."""
        self._generator.start(alg="ga", cross="sbx", mut="pm")


def _rilast(name: str) -> Any:
    return importlib.import_module(f"rilast.{name}")


def _configuration(name: str, loader: Any) -> dict[str, Any]:
    """Return RILaST's configuration of a test generator, with absolute paths."""
    package = Path(loader.__file__).parents[1]
    file = package / "test_generators" / "configs" / f"{name}.yaml"
    values: dict[str, Any] = loader.yaml.safe_load(file.read_text(encoding="utf-8"))
    return values | {key: str(package.parent / values[key]) for key in FILES if key in values}


def _seed() -> int:
    """Return a seed that follows from the bench's seed."""
    return random.randrange(2**31)  # noqa: S311 - a search, no secret


def _with_algorithm(problem: Any) -> Any:
    """Return the problem, marked so that pymoo passes the algorithm to it."""
    problem.requires_kwargs = True
    return problem
