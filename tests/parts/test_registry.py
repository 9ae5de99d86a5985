"""Names that other packages add, and where a user's own parts are loaded from."""

from __future__ import annotations

import importlib.metadata
import py_compile
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Final

import pytest
from user_modules import own_modules

from frenetic._support.entry_points import RegisteredPart
from frenetic.errors import FreneticError
from frenetic.parts.registry import DRIVERS, OBJECTIVES, SIMULATORS, STRATEGIES, Registry


@pytest.mark.parametrize(
    ("name", "is_own"),
    [
        ("planner", False),
        ("unknown", False),
        ("model.onnx", False),
        ("folder:with/model.onnx", False),
        ("frenetic.testing:DummyDriver", False),
        ("frenetic.py:Mine", True),
        ("mine.py:Mine", True),
        ("frenetics.drivers:Mine", True),
    ],
)
def test_a_users_part_is_neither_built_in_nor_a_model(name: str, is_own: bool) -> None:
    assert DRIVERS.is_own(name) is is_own


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of installed packages, still empty."""
    folder = tmp_path / "site-packages"
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
    new = RegisteredPart("careful", "careful:Driver", "careful-drivers")
    assert [entry for entry in DRIVERS.entries() if entry not in before] == [new]
    assert "careful" not in [entry.name for entry in STRATEGIES.entries()]


def test_a_name_that_is_taken_is_refused_with_who_claims_it(site: Path) -> None:
    install(site, "other-drivers", "[frenetic.drivers]\nplanner = other:Driver\n")
    for look in (lambda: DRIVERS.load("stanley"), DRIVERS.entries):
        with pytest.raises(
            FreneticError, match=r"'planner': one is built in.* from other-drivers;"
        ):
            look()


def test_installed_entry_points_are_read_once(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_users_objective_is_a_function(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_a_package_defines_the_classes_of_its_modules(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / "defining_package"
    package.mkdir()
    (package / "__init__.py").write_text("from frenetic import Planner\nfrom .part import Calm\n")
    (package / "part.py").write_text("class Calm: pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(FreneticError, match=r"'Clam'; did you mean 'Calm'\? It defines: Calm$"):
        DRIVERS.load("defining_package:Clam")


# Where a user's own parts are loaded from

OWN: Final = """
{imports}
class Own:
    def reset(self, setup): pass
    def act(self, observation): pass
"""
RUNS: Final = "from pathlib import Path; Path({mark!r}).touch()"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder; what is loaded from it is forgotten in the end."""
    monkeypatch.chdir(tmp_path)
    with own_modules():
        yield tmp_path


def write(folder: Path, **imports: str) -> None:
    """Writes drivers: name of the file -> what it imports."""
    for name, text in imports.items():
        (folder / f"{name}.py").write_text(OWN.format(imports=text))


def write_marking(file: Path) -> Path:
    """Writes a module, or its bytecode, that leaves a mark when it is run; that mark."""
    mark = file.parent.parent / "mark"
    file.parent.mkdir(parents=True, exist_ok=True)
    source = file.with_suffix(".py")
    source.write_text(RUNS.format(mark=str(mark)))
    if file.suffix == ".pyc":
        py_compile.compile(str(source), str(file), doraise=True)
        source.unlink()
    return mark


@pytest.mark.parametrize("spec", ["own.py:Own", "own:Own"])
def test_no_neighbour_of_a_users_part_is_taken_for_an_installed_module(
    spec: str, folder: Path
) -> None:
    """Whatever this package imports later."""
    place = folder / "here"
    files = ("matplotlib.py", "glob.py", "colorsys.pyc", "shapely/__init__.py")
    marks = {write_marking(place / file) for file in files}
    write(place, own="")
    code = (
        f"from frenetic.parts.registry import STRATEGIES; STRATEGIES.load({spec!r});"
        " import colorsys, glob, matplotlib, shapely"
    )
    subprocess.run([sys.executable, "-P", "-c", code], cwd=place, check=True)
    assert not any(mark.exists() for mark in marks)


@pytest.mark.parametrize("spec", ["own.py:Own", "own:Own"])
@pytest.mark.parametrize(
    "file", ["colorsys.py", "colorsys.pyc", "colorsys/__init__.py", "junitparser.py"]
)
@pytest.mark.parametrize("way", ["", "helper", "package.helper"])
def test_a_helper_that_another_module_shadows_is_one_line(
    spec: str, file: str, way: str, folder: Path
) -> None:
    place = folder / "here"
    mark = write_marking(place / file)
    name = file.partition(".")[0].partition("/")[0]
    lazy = f"def load(): import {name}"
    write(place, own=f"import {way}" if way else lazy, helper=lazy)
    (place / "package").mkdir()
    (place / "package" / "__init__.py").write_text("from . import helper")
    write(place / "package", helper=lazy)
    with pytest.raises(FreneticError) as refused, chdir(place):
        DRIVERS.load(spec)
    text = str(refused.value)
    assert f" imports {name!r}: Python takes " in text
    assert text.endswith(f" for it, not {place / file}: rename that")
    assert not mark.exists()


def test_a_neighbour_shadows_nothing_that_is_not_imported(folder: Path) -> None:
    (folder / "json").mkdir()  # of data
    write_marking(folder / "colorsys.py")
    write(folder, glob="import glob, json; assert glob.glob", own="import json")
    for spec in ("glob.py:Own", "own:Own"):
        DRIVERS.make(spec)


def test_a_folder_with_the_name_of_an_installed_package_does_not_win(
    folder: Path, site: Path
) -> None:
    install(site, "careful-drivers", "[frenetic.drivers]\ncareful = careful:Own\n")
    write(site, careful="")
    mark = write_marking(folder / "careful" / "__init__.py").parent / "mark"
    with pytest.raises(FreneticError, match=r"Python takes .*careful.py for the module 'careful'"):
        DRIVERS.load("careful:Own")
    assert DRIVERS.load("careful").__module__ == "careful"
    (folder / "careful" / "__init__.py").unlink()
    write(folder / "careful", mine="")
    assert DRIVERS.load("careful:Own") is DRIVERS.load("careful"), "a folder alone is no package"
    assert not mark.exists()


def test_a_file_of_data_has_no_attribute(folder: Path) -> None:
    mark = write_marking(folder / "here" / "model" / "onnx.py")
    (folder / "here" / "model" / "__init__.py").touch()
    (folder / "here" / "model.onnx").touch()
    for name in ("model.onnx", "model.ONNX"):
        words = f"has no class 'Own': name the file alone, {name}"
        with pytest.raises(FreneticError, match=words), chdir(folder / "here"):
            DRIVERS.load(f"{name}:Own")
    assert not mark.exists()


def test_a_part_comes_from_the_current_folder(folder: Path) -> None:
    there = folder / "there"
    there.mkdir()
    for place, gain in ((folder, 1), (there, 2)):
        write(place, alone="import gain; GAIN = gain.GAIN", module="from gain import GAIN")
        (place / "gain.py").write_text(f"GAIN = {gain}\n")
    with chdir(there):
        for spec in ("alone.py:Own", "module:Own"):
            loaded = DRIVERS.load(spec)
            assert sys.modules[loaded.__module__].GAIN == 2
            assert type(DRIVERS.make(spec)) is loaded
            assert type(DRIVERS.make_from(spec, {}, {})) is loaded
        with pytest.raises(FreneticError, match=r"there is no file 'own\.py'$"):
            DRIVERS.load("own.py:Own")


def test_files_of_a_part_from_another_folder_get_absolute_paths(folder: Path) -> None:
    (folder / "w.npz").touch()
    options = {"weights": "w.npz", "mode": "fast", "gain": 2}
    absolute = {**options, "weights": str(folder / "w.npz")}
    place = "sub/own.py:Own"
    assert DRIVERS.absolute(place, options, folder) == (f"{folder}/{place}", absolute)
    assert DRIVERS.absolute("net.onnx", {}, folder) == (f"{folder}/net.onnx", {})
    assert DRIVERS.absolute("planner", {"law": "w.npz"}, folder) == (
        "planner",
        {"law": str(folder / "w.npz")},
    )
    with pytest.raises(
        FreneticError, match=f"'own:Own' is a module, which would be imported from {folder}"
    ):
        DRIVERS.absolute("own:Own", {}, folder)


def test_a_module_that_another_folder_has_too_is_one_line(folder: Path) -> None:
    """Python would give the other one."""
    there = folder / "there"
    there.mkdir()
    for place in (folder, there):
        write(place, own="", lazy="def load(): import own", uses="import own")
    DRIVERS.load("lazy.py:Own")
    with chdir(there):
        DRIVERS.load("lazy.py:Own")
        DRIVERS.load("uses.py:Own")
    assert Path(str(sys.modules["own"].__file__)).parent == there, "its own neighbour"
    with pytest.raises(FreneticError, match=r"imports 'own': Python takes .*there/own.py for it"):
        DRIVERS.load("uses.py:Own")
    with chdir(there):
        assert DRIVERS.load("own:Own") is sys.modules["own"].Own
    with pytest.raises(FreneticError, match=r"Python takes .*there/own.py for the module 'own'"):
        DRIVERS.load("own:Own")
