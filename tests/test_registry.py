"""Names that other packages add."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from typing import Final

import pytest

from frenetic._support.entry_points import Entry
from frenetic.errors import FreneticError
from frenetic.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES, Registry


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages, still empty."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(str(folder))
    return folder


def install(site: Path, name: str, entries: str) -> None:
    """Installs a package with these entry points."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entries)


def test_an_installed_package_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = DRIVERS.entries()
    install(tmp_path, "careful-drivers", "[frenetic.drivers]\ncareful = careful:Driver\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    new = Entry("careful", "careful:Driver", "careful-drivers")
    assert [entry for entry in DRIVERS.entries() if entry not in before] == [new]
    assert "careful" not in [entry.name for entry in STRATEGIES.entries()]


def test_a_name_that_is_taken_is_refused_with_who_claims_it(site: Path) -> None:
    install(site, "other-drivers", "[frenetic.drivers]\nplanner = other:Driver\n")
    for look in (lambda: DRIVERS.load("stanley"), DRIVERS.entries):
        with pytest.raises(
            FreneticError, match=r"'planner': one is built in.* from other-drivers;"
        ):
            look()


def test_what_is_installed_is_read_once(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del site  # new, so that nothing was read for it
    DRIVERS.load("stanley")
    monkeypatch.setattr(importlib.metadata, "entry_points", None)
    DRIVERS.load("planner")


@pytest.mark.parametrize(
    ("registry", "spec", "option", "message"),
    [
        (STRATEGIES, "frenetic", {"likely": "False"}, "likely is 'False': true or false"),
        (STRATEGIES, "frenetic", {"likely": 7}, "likely is 7: true or false"),
        (STRATEGIES, "frenetic-2021", {"random_budget": "abc"}, "random_budget is 'abc': a number"),
        (STRATEGIES, "random", {"is_valid": "abc"}, "is_valid is 'abc': a function"),
        (DRIVERS, "own.py:Own", {"gain": "abc"}, "gain is 'abc': a number"),
    ],
)
def test_an_option_of_the_wrong_kind_is_named_with_what_is_needed(
    registry: Registry,
    spec: str,
    option: dict[str, object],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(
        "class Own:\n    def __init__(self, gain: float = 1.0, mode='fast'): 2.0 * gain + 1.0\n"
        "    def reset(self, setup): pass\n    def act(self, observation): pass\n"
    )
    with pytest.raises(FreneticError, match=message):
        registry.make_from(spec, option, {"seed": 1} if registry is STRATEGIES else {})
    DRIVERS.make("own.py:Own", gain=2, mode="slow")


def test_an_objective_of_ones_own_is_a_function(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("class Other: pass\ndef near(road, drive): return 0.0\n")
    with pytest.raises(FreneticError, match=r"no function 'far'\. It defines: near$"):
        OBJECTIVES.load("own.py:far")
    with pytest.raises(FreneticError, match=r"goes as package.module:Function"):
        OBJECTIVES.load("far")


DEFINES: Final = """
from dataclasses import dataclass
from math import sin

from frenetic import EmbeddedSimulator, Planner

LIMIT = 3.0


class Careful(Planner):
    pass


def hasty():
    return Planner(aggression=1.5)


def _helper():
    pass
"""


@pytest.mark.parametrize("registry", [DRIVERS, STRATEGIES, SIMULATORS, OBJECTIVES])
@pytest.mark.parametrize("word", ["Carefull", "Planer", "LIMIT", "sinn"])
def test_an_unknown_name_in_a_file_lists_what_the_file_defines_and_not_what_it_imports(
    registry: Registry, word: str, tmp_path: Path
) -> None:
    file = tmp_path / "defines.py"
    file.write_text(DEFINES)
    with pytest.raises(FreneticError) as refused:
        registry.load(f"{file}:{word}")
    names = "hasty" if registry is OBJECTIVES else "Careful, hasty"
    is_close = word == "Carefull" and registry is not OBJECTIVES
    close = "; did you mean 'Careful'?" if is_close else "."
    assert str(refused.value).endswith(f"{word!r}{close} It defines: {names}")


def test_a_package_defines_what_its_modules_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "defining_package"
    package.mkdir()
    (package / "__init__.py").write_text("from frenetic import Planner\nfrom .part import Calm\n")
    (package / "part.py").write_text("class Calm: pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(FreneticError, match=r"'Clam'; did you mean 'Calm'\? It defines: Calm$"):
        DRIVERS.load("defining_package:Clam")
