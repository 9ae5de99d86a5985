"""Two versions of a part are told apart, whatever of it was changed."""

from __future__ import annotations

import compileall
import importlib
import os
import shutil
import subprocess
import sys
import textwrap
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from frenetic.drivers import Planner
from frenetic.drivers.loading import load_driver
from frenetic.fingerprint import differences, fingerprint_of, short_version
from frenetic.registry import DRIVERS, arguments_of
from frenetic.search import Frenetic
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.spec import describe

DRIVER = """
from frenetic.drivers.driver import Controls
import gains
from parts import lookahead

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
    "unused.py": "NOTHING = 0\n",
}


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with a driver and the modules that it imports; nothing of it stays imported."""
    before, path = set(sys.modules), list(sys.path)
    for name, content in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    forget(before)
    sys.path[:] = path


def forget(before: set[str]) -> None:
    for name in set(sys.modules) - before:
        if Path(getattr(sys.modules[name], "__file__", None) or "/").parts[:2] == ("/", "tmp"):
            del sys.modules[name]
    importlib.invalidate_caches()


def made(spec: str = "mpc.py:Mpc", **options: Any) -> dict[str, Any]:
    """The description of a driver that is loaded anew."""
    before = set(sys.modules)
    described = describe(load_driver(spec, options))
    forget(before)
    return described


def files(described: dict[str, Any]) -> set[str]:
    return set(described["fingerprint"]["files"])


def test_own_source_is_that_of_the_module_and_of_the_local_modules_that_it_imports(
    place: Path,
) -> None:
    described = made()
    assert files(described) == {*FILES} - {"unused.py"}
    assert "version" not in described["fingerprint"]
    assert described == made()


@pytest.mark.parametrize("name", FILES)
def test_an_edit_is_noticed_and_named(place: Path, name: str) -> None:
    before = made()
    (place / name).write_text(FILES[name] + "\nX = 1\n", encoding="utf-8")
    found = differences("driver", before, made())
    assert found.unknown == ()
    expected = () if name == "unused.py" else (f"driver Mpc: {name} was changed",)
    assert found.changed == expected
    assert (short_version(before) == short_version(made())) is (name == "unused.py")


def test_it_is_the_same_elsewhere_and_with_other_ends_of_lines(place: Path) -> None:
    before = made()
    other = place / "elsewhere"
    for name, content in FILES.items():
        (other / name).parent.mkdir(parents=True, exist_ok=True)
        (other / name).write_bytes(content.replace("\n", "\r\n").encode())
    sys.path[:] = [one for one in sys.path if one != str(place)]
    os.chdir("/")
    assert made(f"{other}/mpc.py:Mpc") == before


def test_arguments_are_recorded_with_their_defaults(place: Path) -> None:
    assert made()["options"] == {"comfort": 2.0, "model": None}
    other = made(comfort=3.0, horizon=9)
    assert other["options"] == {"comfort": 3.0, "model": None, "horizon": 9}
    assert differences("driver", made(), other).changed == (
        "driver Mpc: comfort is 3.0, it was 2.0",
        "driver Mpc: horizon is 9, it was not there",
    )


class Name:
    """A text whose place in a set is that of another process."""

    def __init__(self, text: str, place: int) -> None:
        self.text, self.place = text, place

    def __hash__(self) -> int:
        return self.place

    def __repr__(self) -> str:
        return repr(self.text)


@dataclass
class Settings:
    """A part's options in one."""

    names: object
    rate: float = 2.0


class Tagged:
    """A part with any option."""

    def __init__(self, tags: object) -> None:
        self.tags = tags


@pytest.mark.parametrize(
    "tags_of",
    [
        set,
        frozenset,
        lambda names: {"all": [set(names)]},
        lambda names: {frozenset(names), 1},
        lambda names: Settings(set(names)),
    ],
)
def test_a_set_is_described_alike_in_every_process(
    tags_of: Callable[[Iterable[Name]], object],
) -> None:
    here = [Name(text, place) for place, text in enumerate("abc")]
    there = [Name(text, -place) for place, text in enumerate("abc", 5)]
    assert [*map(repr, set(here))] != [*map(repr, set(there))]
    ours = describe(Tagged(tags_of(here)))
    assert ours == describe(Tagged(tags_of(there)))
    assert differences("driver", ours, describe(Tagged(tags_of(here[1:])))).changed


@pytest.mark.parametrize(
    "tags",
    [
        {8, 1, 0},
        {(8, 0.5), (1, 2.0)},
        {"a"},
        frozenset({"a"}),
        frozenset({3, -1}),
        set(),
        Settings("a"),
        Settings(Settings({8, 1, 0})),
    ],
)
def test_sets_of_one_order_are_described_as_in_older_records(tags: object) -> None:
    assert describe(Tagged(tags))["options"] == {"tags": repr(tags)}


def test_files_in_a_set_are_read_in_one_order(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "model").write_text(name, encoding="utf-8")
    files = [str(tmp_path / name / "model") for name in ("one", "two")]
    as_list, as_set = describe(Tagged(files)), describe(Tagged(set(files)))
    assert as_list["fingerprint"] == as_set["fingerprint"]


def test_arguments_of_an_object_are_those_that_it_keeps() -> None:
    class Keeps:
        def __init__(self, gain: float, *, rate: float = 2.0, lost: int = 0) -> None:
            self.gain, self._rate = gain, rate

    assert arguments_of(Keeps(1.5)) == {"gain": 1.5, "rate": 2.0}
    described = describe(Keeps(1.5))
    assert described["options"] == {"gain": 1.5, "rate": 2.0}
    assert describe(EmbeddedSimulator(rules=Rules(speed_limit=50.0)))["options"].keys() == {  # type: ignore[union-attr]
        "vehicle",
        "wall_limit",
    }


def test_objects_that_are_arguments_are_told_apart(place: Path) -> None:
    class Holder:
        def __init__(self, gain: float) -> None:
            self.gain = gain

    def described(*values: object) -> list[Any]:
        return [made(x=value)["options"]["x"] for value in values]

    one, same, other = described(Holder(1.0), Holder(1.0), Holder(2.0))
    assert one == same != other
    import numpy as np

    weights = np.arange(5000.0)
    one, same, other = described(weights, weights.copy(), np.where(weights == 2000, 0, weights))
    assert one == same != other
    assert described(made) == [f"{__name__}:made"]


def test_a_file_that_is_an_argument_counts_with_its_content(place: Path) -> None:
    (place / "net.onnx").write_bytes(b"1" * 3_000_000)
    before = made(model="net.onnx")
    assert "model (net.onnx)" in files(before)
    (place / "net.onnx").write_bytes(b"1" * 2_999_999 + b"2")
    assert differences("driver", before, made(model="net.onnx")).changed == (
        "driver Mpc: model (net.onnx) was changed",
    )
    (place / "net.onnx").unlink()
    assert differences("driver", before, made(model="net.onnx")).changed == (
        "driver Mpc: model (net.onnx) is gone",
    )


def test_a_folder_that_is_an_argument_counts_with_its_files(place: Path) -> None:
    net = place / "net"
    net.mkdir()
    (net / "weights").write_text("1", encoding="utf-8")
    before = made(model=str(net))
    (net / "more").write_text("", encoding="utf-8")
    assert differences("driver", before, made(model=str(net))).changed == (
        "driver Mpc: model (net/) was changed",
    )


def test_layers_and_built_in_parts_have_declared_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    before = describe(load_driver("planner", delay=0.1))
    assert short_version(before) == "version 1"
    monkeypatch.setattr(Planner, "BEHAVIOUR", 2)
    assert differences("driver", before, describe(load_driver("planner", delay=0.1))).changed == (
        "driver Planner: it is version 2, it was version 1",
    )
    assert differences("driver", before, describe(load_driver("planner", delay=0.2))).changed == (
        "driver Delayed: seconds is 0.2, it was 0.1",
        "driver Planner: it is version 2, it was version 1",
    )


def test_a_class_of_ones_own_over_a_built_in_one_has_both() -> None:
    class Mine(Frenetic):
        pass

    fingerprint = fingerprint_of(Mine(seed=1))
    assert fingerprint.version == f"Frenetic version {Frenetic.BEHAVIOUR}"
    assert set(fingerprint.files) >= {f"{__name__}.py"}


def test_an_installed_part_has_the_version_of_its_distribution(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = place / "lib" / "site-packages"
    shutil.copytree(place / "parts", site / "parts")
    (site / "parts" / "mpc.py").write_text(DRIVER.replace("import gains", ""), encoding="utf-8")
    shutil.rmtree(place / "parts")
    info = site / "my_drivers-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: my-drivers\nVersion: 1.2\n", encoding="utf-8")
    (info / "top_level.txt").write_text("parts\n", encoding="utf-8")
    (info / "RECORD").write_text("parts/__init__.py,,\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(site))
    assert made("parts.mpc:Mpc")["fingerprint"].keys() == {"digest", "version"}
    assert short_version(made("parts.mpc:Mpc")) == "my-drivers 1.2"


def test_modules_without_source_and_in_archives_count_with_their_bytes(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compileall.compile_file(str(place / "gains.py"), legacy=True, quiet=2)
    (place / "gains.py").unlink()
    with zipfile.ZipFile(place / "parts.zip", "w") as archive:
        for path in sorted((place / "parts").glob("*.py")):
            archive.write(path, f"parts/{path.name}")
    shutil.rmtree(place / "parts")
    monkeypatch.syspath_prepend(str(place / "parts.zip"))
    assert files(made()) >= {"gains.pyc", "parts/inner.py"}
    assert "trouble" not in made()["fingerprint"]


def script(code: str, place: Path) -> list[str]:
    """Output lines of a Python that has no file for its code."""
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=place, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


NOTEBOOK = """
import linecache, sys
source = '''
GAIN = 1.0
def gain():
    return GAIN
class Cell:
    def reset(self, setup): pass
    def act(self, observation): return gain()
def other(): pass
'''
for change in (("", ""), ("GAIN = 1.0", "GAIN = 2.0"), ("return GAIN", "return -GAIN"),
               ("def other(): pass", "def other(): return 1")):
    text = source.replace(*change)
    linecache.cache["<cell>"] = len(text), None, text.splitlines(True), "<cell>"
    exec(compile(text, "<cell>", "exec"))
    if sys.version_info < (3, 13):
        import __main__
        __main__.__file__ = "<cell>"
    from frenetic.fingerprint import fingerprint_of
    print(sorted(fingerprint_of(Cell()).files), fingerprint_of(Cell()).digest)
"""


def test_a_class_of_a_notebook_counts_with_what_it_uses_there(place: Path) -> None:
    first, other_number, other_function, unused = script(NOTEBOOK, place)
    assert first.startswith("['__main__.Cell', '__main__.GAIN', '__main__.gain']")
    assert len({first, other_number, other_function}) == 3
    assert unused == first


def test_without_a_source_there_is_none_and_that_is_said(place: Path) -> None:
    code = """
    class Cell:
        def act(self, observation): pass
    from frenetic.spec import describe
    print(describe(Cell())["fingerprint"]["trouble"])
    """
    assert script(textwrap.dedent(code), place) == ["the source of Cell is not available"]
    unknown = {"class": "a:Cell", "fingerprint": {"digest": "1", "trouble": "no source"}}
    assert differences("driver", unknown, unknown).unknown == ("driver Cell: no source",)


class Angry:
    """Raises wherever it can."""

    options = property(lambda self: 1 / 0)

    def __init__(self, gain: float = 1.0) -> None:
        pass

    def __getattribute__(self, name: str) -> Any:
        if name in ("gain", "_gain"):
            raise RuntimeError(name)
        return object.__getattribute__(self, name)

    def reset(self, setup: object) -> None:
        pass

    def act(self, observation: object) -> None:
        pass

    def __repr__(self) -> str:
        raise RuntimeError("repr")


@pytest.mark.parametrize(
    ("name", "breaking"),
    [
        ("gains.py", lambda place: (place / "gains.py").unlink()),
        ("lazy.py", lambda place: (place / "lazy.py").write_bytes(b"\xff\x00 = (")),
        ("lazy.py", lambda place: (place / "lazy.py").write_text("(" * 5000, encoding="utf-8")),
    ],
)
def test_taking_one_never_raises(
    place: Path, name: str, breaking: Callable[[Path], object]
) -> None:
    driver = DRIVERS.make("mpc.py:Mpc")
    breaking(place)
    described: Any = describe(driver)
    assert described["class"] == "mpc.py:Mpc"
    assert described["fingerprint"]["trouble"].startswith(f"{name} cannot be read: ")
    assert "mpc.py" in described["fingerprint"]["files"]
    assert describe(Angry())["class"] == f"{__name__}:Angry"
    odd: list[Any] = [Angry(), "\x00", "a" * 100_000, Path("/proc/self/mem"), [[[[]]]], {1: {2: 3}}]
    for value in odd:
        assert describe(DRIVERS.make("mpc.py:Mpc", x=value))["class"] == "mpc.py:Mpc"


def test_records_of_older_versions_are_compared_by_what_they_hold(place: Path) -> None:
    now = made()
    old = {"class": now["class"]}
    found = differences("driver", old, now)
    assert found.changed == ()
    assert found.unknown == ("driver Mpc: the campaign has no fingerprint of it",)
    other = differences("driver", {"class": "mpc.py:Pid"}, now)
    assert other.changed == ("driver is Mpc, it was Pid",)
