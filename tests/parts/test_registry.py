"""Registries of parts: names of installed packages, options, and where users' parts come from."""

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
    """Install a package with these entry points."""
    info = site / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(entries)


def test_a_part_of_an_installed_package_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = DRIVERS.entries()
    install(tmp_path, "careful-drivers", "[frenetic.drivers]\ncareful = careful:Driver\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    new = RegisteredPart("careful", "careful:Driver", "careful-drivers")
    assert [entry for entry in DRIVERS.entries() if entry not in before] == [new]
    assert "careful" not in [entry.name for entry in STRATEGIES.entries()]


def test_a_name_that_two_packages_claim_is_refused_with_their_names(site: Path) -> None:
    install(site, "other-drivers", "[frenetic.drivers]\nplanner = other:Driver\n")
    for look in (lambda: DRIVERS.load("stanley"), DRIVERS.entries):
        with pytest.raises(
            FreneticError, match=r"'planner': one is built in.* from other-drivers;"
        ):
            look()


def test_installed_entry_points_are_read_once(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    del site  # its folder is new, so nothing was read for it
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
def test_an_option_of_the_wrong_type_is_refused_with_the_right_type(
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


def test_a_part_that_takes_any_option_refuses_one_in_its_own_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(
        "class Own:\n    def __init__(self, **options): raise TypeError(f'too much: {options}')\n"
        "    def reset(self, setup): pass\n    def act(self, observation): pass\n"
    )
    with pytest.raises(FreneticError, match=r"too much: \{'size': 'large'\}"):
        DRIVERS.make("own.py:Own", size="large")


def test_a_users_objective_is_a_function(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("class Other: pass\ndef near(road, drive): return 0.0\n")
    with pytest.raises(FreneticError, match=r"no function 'far'\. It defines: near$"):
        OBJECTIVES.load("own.py:far")
    with pytest.raises(FreneticError, match=r"goes as package.module:Function"):
        OBJECTIVES.load("far")


FILE_WITH_DRIVERS: Final = """
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
def test_an_unknown_name_in_a_file_lists_only_what_the_file_defines(
    registry: Registry, word: str, tmp_path: Path
) -> None:
    file = tmp_path / "defines.py"
    file.write_text(FILE_WITH_DRIVERS)
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

OWN_DRIVER: Final = """
{imports}
class Own:
    def reset(self, setup): pass
    def act(self, observation): pass
"""
MARKING_MODULE: Final = "from pathlib import Path; Path({mark!r}).touch()"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The current folder; modules that are loaded from it are forgotten after the test."""
    monkeypatch.chdir(tmp_path)
    with own_modules():
        yield tmp_path


def write_drivers(folder: Path, **imports: str) -> None:
    """Write drivers: name of the file -> its imports."""
    for name, text in imports.items():
        (folder / f"{name}.py").write_text(OWN_DRIVER.format(imports=text))


def write_marking(file: Path) -> Path:
    """Write a module, or its bytecode, that makes a file when it is run; return that file."""
    mark = file.parent.parent / "mark"
    file.parent.mkdir(parents=True, exist_ok=True)
    source = file.with_suffix(".py")
    source.write_text(MARKING_MODULE.format(mark=str(mark)))
    if file.suffix == ".pyc":
        py_compile.compile(str(source), str(file), doraise=True)
        source.unlink()
    return mark


@pytest.mark.parametrize("spec", ["own.py:Own", "own:Own"])
def test_files_beside_a_users_part_replace_no_installed_module(spec: str, folder: Path) -> None:
    """Not even of modules that are imported later."""
    here = folder / "here"
    files = ("matplotlib.py", "glob.py", "colorsys.pyc", "shapely/__init__.py")
    marks = {write_marking(here / file) for file in files}
    write_drivers(here, own="")
    code = (
        f"from frenetic.parts.registry import STRATEGIES; STRATEGIES.load({spec!r});"
        " import colorsys, glob, matplotlib, shapely"
    )
    subprocess.run([sys.executable, "-P", "-c", code], cwd=here, check=True)
    assert not any(mark.exists() for mark in marks)


@pytest.mark.parametrize("spec", ["own.py:Own", "own:Own"])
@pytest.mark.parametrize(
    "file", ["colorsys.py", "colorsys.pyc", "colorsys/__init__.py", "junitparser.py"]
)
@pytest.mark.parametrize("module", ["", "helper", "package.helper"])
def test_a_local_module_that_python_shadows_is_refused_in_one_line(
    spec: str, file: str, module: str, folder: Path
) -> None:
    here = folder / "here"
    mark = write_marking(here / file)
    name = file.partition(".")[0].partition("/")[0]
    lazy = f"def load(): import {name}"
    write_drivers(here, own=f"import {module}" if module else lazy, helper=lazy)
    (here / "package").mkdir()
    (here / "package" / "__init__.py").write_text("from . import helper")
    write_drivers(here / "package", helper=lazy)
    with pytest.raises(FreneticError) as refused, chdir(here):
        DRIVERS.load(spec)
    text = str(refused.value)
    assert f" imports {name!r}: Python takes " in text
    assert text.endswith(f" for it, not {here / file}: rename that")
    assert not mark.exists()


def test_local_files_that_nothing_imports_may_have_names_of_python_modules(folder: Path) -> None:
    (folder / "json").mkdir()  # a folder of data
    write_marking(folder / "colorsys.py")
    write_drivers(folder, glob="import glob, json; assert glob.glob", own="import json")
    for spec in ("glob.py:Own", "own:Own"):
        DRIVERS.make(spec)


def test_an_installed_package_wins_over_a_folder_of_its_name(folder: Path, site: Path) -> None:
    install(site, "careful-drivers", "[frenetic.drivers]\ncareful = careful:Own\n")
    write_drivers(site, careful="")
    mark = write_marking(folder / "careful" / "__init__.py").parent / "mark"
    with pytest.raises(FreneticError, match=r"Python takes .*careful.py for the module 'careful'"):
        DRIVERS.load("careful:Own")
    assert DRIVERS.load("careful").__module__ == "careful"
    (folder / "careful" / "__init__.py").unlink()
    write_drivers(folder / "careful", mine="")
    assert DRIVERS.load("careful:Own") is DRIVERS.load("careful"), "a folder alone is no package"
    assert not mark.exists()


def test_a_class_in_a_file_of_data_is_refused(folder: Path) -> None:
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
    for current, gain in ((folder, 1), (there, 2)):
        write_drivers(
            current, alone="import gain; GAIN = gain.GAIN", module="from gain import GAIN"
        )
        (current / "gain.py").write_text(f"GAIN = {gain}\n")
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
    spec = "sub/own.py:Own"
    assert DRIVERS.absolute(spec, options, folder) == (f"{folder}/{spec}", absolute)
    assert DRIVERS.absolute("net.onnx", {}, folder) == (f"{folder}/net.onnx", {})
    assert DRIVERS.absolute("planner", {"law": "w.npz"}, folder) == (
        "planner",
        {"law": str(folder / "w.npz")},
    )
    with pytest.raises(
        FreneticError, match=f"'own:Own' is a module, which would be imported from {folder}"
    ):
        DRIVERS.absolute("own:Own", {}, folder)


def test_a_module_of_the_same_name_in_another_folder_is_refused_in_one_line(folder: Path) -> None:
    """Python would give the module that was loaded first."""
    there = folder / "there"
    there.mkdir()
    for current in (folder, there):
        write_drivers(current, own="", lazy="def load(): import own", uses="import own")
    DRIVERS.load("lazy.py:Own")
    with chdir(there):
        DRIVERS.load("lazy.py:Own")
        DRIVERS.load("uses.py:Own")
    assert Path(str(sys.modules["own"].__file__)).parent == there, "the module beside the driver"
    with pytest.raises(FreneticError, match=r"imports 'own': Python takes .*there/own.py for it"):
        DRIVERS.load("uses.py:Own")
    with chdir(there):
        assert DRIVERS.load("own:Own") is sys.modules["own"].Own
    with pytest.raises(FreneticError, match=r"Python takes .*there/own.py for the module 'own'"):
        DRIVERS.load("own:Own")
