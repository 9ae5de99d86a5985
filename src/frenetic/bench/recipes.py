"""Recipes: published generators of the competition, with what a bench must know to run them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from frenetic.bench.entrants import Entrant
from frenetic.errors import FreneticError, UnknownNameError
from frenetic.registry import hint

_SBFT: Final = "sbft-cps-tool-competition/cps-tool-competition, branch tools24"
_SBST: Final = "se2p/tool-competition-av, pull request {}"
_FRENETIC: Final = ("pandas==1.3.5",)
_ADAPTERS: Final = Path(__file__).parent / "hosting" / "adapters"
_PICT: Final = "Microsoft's PICT as a program for this system: pict MODEL /o:N /r /e:SEEDS"


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """A published generator.

    All have run unmodified, on Python 3.9 with numpy 1.21.6, scipy 1.7.3, shapely 1.8.5 and
    matplotlib 3.5.3, beside their own packages, unless these and the note say otherwise.
    """

    name: str
    title: str
    """Name in tables."""
    source: str
    """GitHub repository and branch or pull request whose files the folder holds."""
    spec: str
    """``package.module:Class``."""
    adapter: str = ""
    """``file.py:Class`` of ours, beside the pipeline's modules, that gives it their interface."""
    path: str = "."
    """Folder on the module path, in that one."""
    copy: str | None = None
    """Folder that each run works in a copy of, likewise."""
    packages: tuple[str, ...] = ()
    """What it needs beside numpy, scipy, shapely and matplotlib, in the versions that ran."""
    files: Mapping[str, str] = field(default_factory=dict)
    """File that has to be added -> what it is."""
    seconds_per_test: float = 0.0
    """Least virtual time of a drive with which it runs, in s."""
    note: str = ""

    def entrant(
        self, folder: Path | str, *, python: Path | str | None = None, name: str | None = None
    ) -> Entrant:
        """The entrant of a bench.

        Args:
            folder: with the files of the source.
            python: its interpreter; by default the current one.
            name: in tables; by default the title.

        Raises:
            FreneticError: the folder lacks something.
        """
        folder = Path(folder)
        place = (folder / self.path).joinpath(*self.spec.partition(":")[0].split("."))
        if not place.with_suffix(".py").is_file():
            raise FreneticError(
                f"{str(folder)!r} does not hold {self.title}: {place.with_suffix('.py')} is not"
                f" there; its path must be a folder with the files of {self.source}"
            )
        for file, what in self.files.items():
            if not (folder / file).exists():
                raise FreneticError(f"{self.title} needs {str(folder / file)!r}: {what}")
        return Entrant(
            name=self.title if name is None else name,
            spec=str(_ADAPTERS / self.adapter) if self.adapter else self.spec,
            path=folder / self.path,
            copy=None if self.copy is None else folder / self.copy,
            python=None if python is None else Path(python),
        )

    @property
    def needs(self) -> str:
        """What has to be there beside its files, for people."""
        needs = [*self.packages, *(f"{file} ({what})" for file, what in self.files.items())]
        if self.seconds_per_test:
            needs.append(f"{self.seconds_per_test:g} s per test")
        return "; ".join(filter(None, (", ".join(needs), self.note)))

    def as_json(self) -> dict[str, Any]:
        """The recipe as a JSON object."""
        return {**vars(self), "packages": list(self.packages), "files": dict(self.files)}

    def check(self, seconds_per_test: float) -> None:
        """Checks the cost of a drive.

        Raises:
            FreneticError: the generator would wait for ever at its end.
        """
        if seconds_per_test < self.seconds_per_test:
            raise FreneticError(
                f"{self.title} asks for no test in its last {self.seconds_per_test:g} s, while the"
                f" virtual clock stands: make a test cost {self.seconds_per_test:g} s or more"
            )


RECIPES: Final[Mapping[str, Recipe]] = MappingProxyType(
    {
        recipe.name: recipe
        for recipe in (
            Recipe(
                name="frenetic-sbst21",
                title="Frenetic (authors) 2021",
                source="ERATOMMSD/frenetic-sbst21",
                spec="src.generators.random_frenet_generator:Frenetic",
                packages=_FRENETIC,
            ),
            Recipe(
                name="swat-2021",
                title="Swat 2021",
                source=_SBST.format(73),
                spec="swat_gen.swat_generator:SwatTestGenerator",
            ),
            Recipe(
                name="deeper-2021",
                title="Deeper 2021",
                source=_SBST.format(72),
                spec="Deeper_test_generator.deeper_test_generator:DeeperTestGenerator",
                copy=".",
                packages=("deap",),
            ),
            Recipe(
                name="deepjanus-seeds",
                title="DeepJanus seeds",
                source=_SBFT,
                spec="sample_test_generators.deepjanus_seed_generator:JanusGenerator",
                note="a sample of the pipeline, in every edition",
            ),
            Recipe(
                name="adafrenetic-2022",
                title="AdaFrenetic 2022",
                source=_SBST.format(105),
                spec="src.generators.adaptive_random_frenet_generator:AdaFrenetic",
                packages=_FRENETIC,
            ),
            Recipe(
                name="freneticv-2022",
                title="FreneticV 2022",
                source=_SBST.format(107),
                spec="frenetic.generators.frenetic_generator:FreneticV",
                packages=_FRENETIC,
            ),
            Recipe(
                name="ambiegen-2022",
                title="AmbieGen 2022",
                source=_SBST.format(108),
                spec="ambiegen.ambiegen_generator:AmbieGenTestGenerator",
                copy=".",
                packages=("pymoo==0.4.2.2",),
            ),
            Recipe(
                name="genrl-2022",
                title="GenRL 2022",
                source=_SBST.format(110),
                spec="genrl_sbst2022.genrl_test_generator:GenrlTestGenerator",
                packages=("stable-baselines3==1.6.2", "gym==0.21.0", "torch==1.12.1"),
            ),
            Recipe(
                name="crag-2023",
                title="CRAG 2023",
                source=_SBFT,
                spec="src.crag:CRAG",
                path="crag-sbft2023",
                copy="crag-sbft2023",
                files={"crag-sbft2023/src/pict": _PICT},
                note="PICT draws from the clock: a seed does not repeat it",
            ),
            Recipe(
                name="rigaa-2023",
                title="RIGAA 2023",
                source=_SBFT,
                spec="src.rigaa_generator:RIGAATestGenerator",
                path="rigaa-sbft2023",
                copy=".",
                packages=(
                    *("pymoo==0.6.0.1", "stable-baselines3==1.6.2", "gym==0.21.0"),
                    *("torch==1.12.1", "descartes==1.1.0"),
                ),
                seconds_per_test=40.0,
            ),
            Recipe(
                name="roadsign-2023",
                title="RoadSign 2023",
                source=_SBFT,
                spec="src.roadsign_generator:RoadSignGenerator",
                path="roadsign-sbft2023",
                packages=("pymoo==0.6.0.1",),
            ),
            Recipe(
                name="spirale-2023",
                title="Spirale 2023",
                source=_SBFT,
                spec="src.main:Roadtition",
                path="spirale-sbft2023",
            ),
            Recipe(
                name="wogan-2023",
                title="WOGAN 2023",
                source=_SBFT,
                spec="src.wogan:WOGAN",
                path="wogan-sbft2023",
                packages=("torch==1.12.1", "joblib==1.1.0"),
            ),
            Recipe(
                name="ambiegenvae-2024",
                title="AmbieGenVAE 2024",
                source=_SBFT,
                spec="ambiegenvae.ambiegenvae_generator:AmbiegenVAEGenerator",
                copy=".",
                packages=("pymoo==0.6.1", "torch==1.12.1", "torchvision==0.13.1", "tqdm"),
                files={
                    "ambiegenvae\\vae_dataset.npy": "a copy of ambiegenvae/vae_dataset.npy of that"
                    " name, since it opens it with Windows' separator",
                    "ambiegenvae\\VAE_models": "a copy of the folder ambiegenvae/VAE_models of"
                    " that name, since it opens it with Windows' separator",
                },
            ),
            Recipe(
                name="crag-2024",
                title="CRAG 2024",
                source=_SBFT,
                spec="src.crag:CRAG",
                path="crag-sbft2024",
                copy="crag-sbft2024",
                files={"crag-sbft2024/src/pict": _PICT},
                note="PICT draws from the clock: a seed does not repeat it",
            ),
            Recipe(
                name="optangle-2024",
                title="OptAngle 2024",
                source=_SBFT,
                spec="optangle.src.optangle:OptAngleGenerator",
                packages=("pymoo==0.6.1",),
            ),
            Recipe(
                name="rilast-2025",
                title="RILaST 2025",
                source="swat-lab-optimization/RILaST",
                spec="rilast.test_generators.latent_lkas_test_generator:LatentLKASTestGenerator",
                adapter="rilast_generator.py:RILaST",
                packages=(
                    *("numpy==1.23.2", "scipy==1.11.3", "shapely==1.8.4", "matplotlib==3.8.4"),
                    *("pymoo==0.6.1.1", "torch==2.5.1", "torchvision==0.20.1", "descartes==1.1.0"),
                    *("tqdm", "similaritymeasures", "PyYAML"),
                ),
                note="Python 3.10; it does not run as published: what is mended in its process"
                " stands in frenetic/bench/hosting/adapters/rilast_generator.py",
            ),
        )
    }
)
"""Name -> recipe, by year."""


def find_recipe(name: str) -> Recipe:
    """The recipe of a name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in RECIPES:
        raise UnknownNameError(
            f"there is no published generator {name!r}{hint(name, RECIPES)} There are"
            f" {', '.join(RECIPES)}; any other is package.module:Class or path/to/file.py:Class"
        )
    return RECIPES[name]
