"""Versions of parts: an edit of a source, an argument or a file makes another version."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from user_modules import own_modules

from frenetic.drivers import Planner
from frenetic.drivers.loading import load_driver
from frenetic.parts.construction import arguments_of
from frenetic.parts.records import differences, short_version
from frenetic.parts.registry import DRIVERS
from frenetic.parts.versions import sources_named, version_of
from frenetic.search import Frenetic
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.spec.part_record import describe, sources_of

DRIVER = """
from frenetic.drivers.driver import Controls
import gains
from parts import lookahead
from folder.deep import law

class Mpc:
    def __init__(self, comfort=2.0, model=None, **more):
        self._comfort = comfort
    def reset(self, setup):
        import lazy
    def act(self, observation):
        return Controls(0.0)
"""
FILES = {
    "mpc.py": DRIVER,
    "gains.py": "GAIN = 1.0\n",
    "lazy.py": "import json\n",
    "parts/__init__.py": "",
    "parts/lookahead.py": "from . import inner\n",
    "parts/inner.py": "NEAR = 3\n",
    "parts/mpc.py": f"from . import inner\n{DRIVER}",
    "folder/deep/law.py": "LAW = 1\n",
    "folder/mpc.py": f"from .deep.law import LAW\n{DRIVER}",
    "unused.py": "NOTHING = 0\n",
}
MAIN = {"mpc.py", "parts/mpc.py", "folder/mpc.py"}
UNUSED = {
    "mpc.py:Mpc": {"unused.py", *MAIN} - {"mpc.py"},
    "mpc:Mpc": {"unused.py", *MAIN} - {"mpc.py"},
    "parts.mpc:Mpc": {"unused.py", *MAIN} - {"parts/mpc.py"},
    "folder.mpc:Mpc": {"unused.py", *MAIN} - {"folder/mpc.py"},
}
"""A driver in a file, a module, a package and a folder -> the files that it does not use."""


@pytest.fixture
def drivers_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with drivers and the modules that they import."""
    write(tmp_path, FILES)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder: Path, files: Mapping[str, str]) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content.encode())


def record_of(spec: str = "mpc.py:Mpc", **options: Any) -> dict[str, Any]:
    """Record of a driver that is loaded anew."""
    with own_modules():
        return describe(DRIVERS.make(spec, **options), DRIVERS.construction(spec, options, {}))


@pytest.mark.parametrize("spec", UNUSED)
def test_the_sources_are_the_file_and_its_local_imports(drivers_folder: Path, spec: str) -> None:
    used = {name: text for name, text in FILES.items() if name not in UNUSED[spec]}
    assert sources_named(spec) == used
    with own_modules():
        driver = load_driver(spec, delay=0.1)
        assert sources_of(driver) == used
    assert record_of(spec) == record_of(spec)


@pytest.mark.parametrize("spec", UNUSED)
def test_an_edit_of_a_source_makes_another_version(drivers_folder: Path, spec: str) -> None:
    for name in FILES:
        before = record_of(spec)
        write(drivers_folder, {name: FILES[name] + "# a comment\n"})
        after = record_of(spec)
        old, new = short_version(before), short_version(after)
        sentences = () if name in UNUSED[spec] else (f"driver Mpc: it is {new}, it was {old}",)
        assert differences("driver", before, after) == sentences
        assert old.startswith("source ")
        assert new.startswith("source ")


@pytest.mark.parametrize("spec", ["{}/mpc.py:Mpc", "mpc:Mpc", "parts.mpc:Mpc", "folder.mpc:Mpc"])
def test_a_version_is_the_same_in_another_folder_and_with_other_line_ends(
    drivers_folder: Path, monkeypatch: pytest.MonkeyPatch, spec: str
) -> None:
    before = record_of(spec.format(drivers_folder))
    other = drivers_folder.parent / f"{drivers_folder.name} elsewhere"
    write(other, {name: text.replace("\n", "\r\n") for name, text in FILES.items()})
    monkeypatch.chdir(other)
    assert record_of(spec.format(other)) == before


def test_arguments_are_recorded_with_their_defaults(drivers_folder: Path) -> None:
    assert record_of()["options"] == {"comfort": 2.0, "model": None}
    other = record_of(comfort=3.0, horizon=9)
    assert other["options"] == {"comfort": 3.0, "model": None, "horizon": 9}
    assert differences("driver", record_of(), other) == (
        "driver Mpc: comfort is 3.0, it was 2.0",
        "driver Mpc: horizon is 9, it was null",
    )


def test_the_content_of_a_file_argument_is_part_of_the_version(drivers_folder: Path) -> None:
    model = drivers_folder / "net.onnx"
    versions = []
    for content in (b"1" * 3_000_000, b"1" * 2_999_999 + b"2"):
        model.write_bytes(content)
        versions.append(short_version(record_of(model="net.onnx")))
        assert short_version(record_of(model=model)) == versions[-1]
    model.unlink()
    versions.append(short_version(record_of(model="net.onnx")))
    assert len(set(versions)) == 3
    assert ", files " in versions[0]
    assert versions[2] == short_version(record_of())


def test_the_source_of_an_arguments_class_is_part_of_the_version(drivers_folder: Path) -> None:
    def version() -> str:
        with own_modules():
            law = DRIVERS.make("unused.py:Law")
            return short_version(record_of(model=law))

    law = "class Law:\n    def reset(self, setup): pass\n    def act(self, o): return {}\n"
    write(drivers_folder, {"unused.py": law.format(0)})
    before = version()
    write(drivers_folder, {"unused.py": law.format(1)})
    assert before != version()


@pytest.mark.parametrize("tags_of", [frozenset, lambda names: {"all": [set(names)]}])
def test_a_set_is_recorded_in_sorted_order(
    tags_of: Callable[[Iterable[str]], object],
) -> None:
    @dataclass
    class Tagged:
        tags: object

    tags = describe(Tagged(tags_of("cab")))["options"]
    assert tags in ({"tags": ["a", "b", "c"]}, {"tags": {"all": [["a", "b", "c"]]}})


def test_arguments_of_an_object_are_its_attributes() -> None:
    class Keeps:
        def __init__(self, gain: float, *, rate: float = 2.0, lost: int = 0) -> None:
            self.gain, self._rate = gain, rate

    assert arguments_of(Keeps(1.5)) == {"gain": 1.5, "rate": 2.0}
    assert describe(Keeps(1.5))["options"] == {"gain": 1.5, "rate": 2.0}
    assert describe(EmbeddedSimulator(rules=Rules(speed_limit=50.0)))["options"].keys() == {  # type: ignore[union-attr]
        "vehicle",
        "wall_limit",
    }


def test_different_objects_as_arguments_make_different_records(drivers_folder: Path) -> None:
    class Holder:
        def __init__(self, gain: float) -> None:
            self.gain = gain

    def described(*values: object) -> list[Any]:
        return [record_of(x=value)["options"]["x"] for value in values]

    first, same, other = described(Holder(1.0), Holder(1.0), Holder(2.0))
    assert first == same != other
    weights = np.arange(5000.0)
    first, same, other = described(weights, weights.copy(), np.where(weights == 2000, 0, weights))
    assert first == same != other
    assert described(record_of) == [f"{__name__}:record_of"]


def test_wrappers_and_own_parts_have_declared_versions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = describe(load_driver("planner", delay=0.1))
    version = Planner.BEHAVIOUR
    assert (short_version(before), sources_of(Planner())) == ("version 1", {})
    monkeypatch.setattr(Planner, "BEHAVIOUR", version + 1)
    assert differences("driver", before, describe(load_driver("planner", delay=0.2))) == (
        "driver Delayed: seconds is 0.2, it was 0.1",
        f"driver planner: it is version {version + 1}, it was version {version}",
    )
    assert differences("driver", before, describe(load_driver("stanley"))) == (
        "driver is stanley, it was Delayed",
    )


def test_a_users_class_over_a_built_in_one_has_both_versions() -> None:
    class Mine(Frenetic):
        pass

    version = version_of(Mine(seed=1))
    assert version.text.startswith("source ")
    assert version.text.endswith(f", Frenetic version {Frenetic.BEHAVIOUR}")
    assert f"{Path(__file__).name}" in version.sources


def test_an_installed_part_has_the_version_of_its_distribution(
    drivers_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = drivers_folder / "lib" / "site-packages"
    info = site / "my_drivers-1.2.dist-info"
    write(
        site,
        {
            "fast/__init__.py": "",
            "fast/mpc.py": DRIVER.replace("import gains", "").replace("from ", "# "),
            f"{info.name}/METADATA": "Name: my-drivers\nVersion: 1.2\n",
            f"{info.name}/top_level.txt": "fast\n",
            f"{info.name}/RECORD": "fast/__init__.py,,\n",
        },
    )
    monkeypatch.syspath_prepend(str(site))
    assert short_version(record_of("fast.mpc:Mpc")) == "my-drivers 1.2"
    assert sources_named("fast.mpc:Mpc") == {}


NOTEBOOK = """
import linecache
source = '''
class Cell:
    def reset(self, setup): pass
    def act(self, observation): return 1
'''
for text in (source, source, source.replace("return 1", "return 2")):
    linecache.cache["<cell>"] = len(text), None, text.splitlines(True), "<cell>"
    exec(compile(text, "<cell>", "exec"))
    import __main__
    __main__.__file__ = "<cell>"
    from frenetic.parts.versions import version_of
    print(version_of(Cell()).text)
linecache.clearcache()
del __main__.__file__
print(version_of(Cell()).text)
"""


def test_a_class_of_a_notebook_has_the_version_of_its_source(drivers_folder: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK],
        cwd=drivers_folder,
        capture_output=True,
        text=True,
        check=True,
    )
    first, same, other, without = done.stdout.splitlines()
    assert first == same != other
    assert other.startswith("source ")
    assert without.startswith("unknown (")


class AlwaysRaises:
    """Raises wherever it can."""

    options = property(lambda self: 1 / 0)

    def __init__(self, gain: float = 1.0) -> None:
        pass

    def __getattribute__(self, name: str) -> Any:
        if name in ("gain", "_gain"):
            raise RuntimeError(name)
        return object.__getattribute__(self, name)

    def __repr__(self) -> str:
        raise RuntimeError("repr")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("gains.py", None),
        ("lazy.py", b"\xff\x00 = ("),
        ("lazy.py", b"(" * 5000),
        ("mpc.py", b"("),
    ],
)
def test_taking_a_version_never_raises(
    drivers_folder: Path, name: str, content: bytes | None
) -> None:
    with own_modules():
        driver = DRIVERS.make("mpc.py:Mpc")
        if content is None:
            (drivers_folder / name).unlink()
        else:
            (drivers_folder / name).write_bytes(content)
        assert describe(driver)["class"] == "mpc.py:Mpc"
        assert describe(driver)["version"]


@pytest.mark.parametrize(
    "value", [AlwaysRaises(), "\x00", "a" * 100_000, Path(os.devnull), [[[[]]]], {1: {2: 3}}]
)
def test_any_argument_can_be_recorded(drivers_folder: Path, value: object) -> None:
    assert record_of(x=value)["class"] == "mpc.py:Mpc"
    assert describe(AlwaysRaises())["class"] == f"{__name__}:AlwaysRaises"
