"""The pipeline's Python is old, its packages are pinned, and numba is not among them."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from old_python import too_new, too_new_in
from stand_in import Executor2022, RoadTest, driven, enter, run_2022

from frenetic.competition import Frenetic

HERE = Path(__file__).parent

RUN = """
import importlib.abc
import json
import sys

ALLOWED = {*sys.stdlib_module_names, "frenetic", "numpy", "scipy", "stand_in"}


class NothingElse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        top = name.partition(".")[0]
        if top not in ALLOWED and not top.startswith("_"):
            raise ModuleNotFoundError(f"no {name} here", name=name)


sys.meta_path.insert(0, NothingElse())

import stand_in
from frenetic.competition import Frenetic

stand_in.install()
executor = stand_in.Executor2022(
    tests=15,
    answer=lambda test: stand_in.driven("FAIL" if test.id % 4 == 0 else "PASS", -0.1 * test.id),
)
stand_in.run_2022(Frenetic, executor)
modules = [vars(m).get("__file__") for n, m in sys.modules.items() if n.startswith("frenetic")]
print(json.dumps([[test.road_points for test in executor.tests], modules]))
"""


COLD = """
import gc
import sys
from types import SimpleNamespace

from frenetic.competition import Frenetic

from numba.core.dispatcher import Dispatcher
import stand_in

def forms():
    kernels = [k for k in gc.get_objects() if isinstance(k, Dispatcher)]
    return {(k.py_func.__qualname__, str(form)) for k in kernels for form in k.signatures}

def answer(test):
    has_failed = test.id % 3 == 1
    rows = [(x + 2.0, y, -28.0) for x, y in test.road_points]
    return "FAIL" if has_failed else "PASS", "", [
        SimpleNamespace(pos=row, vel=(1.0, 9.0, 0.0), is_oob=has_failed, oob_distance=-1.0)
        for row in rows
    ]

before = forms()
stand_in.install()
stand_in.run_2022(Frenetic, stand_in.Executor2022(tests=60, answer=answer))
print(len(before), sorted(forms() - before))
"""


def test_importing_compiles_all_before_the_clock_starts() -> None:
    done = subprocess.run(
        [sys.executable, "-c", COLD],
        check=True,
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(HERE)},  # with the kernels of the installed package
    )
    number, _, new = done.stdout.strip().partition(" ")
    assert int(number) > 10
    assert new == "[]"


@pytest.fixture(autouse=True)
def _in_the_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    enter(monkeypatch)


@pytest.fixture(scope="module")
def outcome() -> tuple[list[list[tuple[float, float]]], list[str]]:
    """The roads of a run with numpy and scipy only, and the files it took of Frenetic."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", RUN],
        capture_output=True,
        text=True,
        env=os.environ | {"PYTHONPATH": str(HERE), "FRENETIC_SEED": "5"},
    )
    assert done.returncode == 0, done.stderr
    roads, files = json.loads(done.stdout)
    return roads, files


def test_numpy_and_scipy_suffice_and_the_roads_are_the_same(
    outcome: tuple[list[list[tuple[float, float]]], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FRENETIC_SEED", "5")

    def answer(test: RoadTest) -> object:
        return driven("FAIL" if test.id % 4 == 0 else "PASS", -0.1 * test.id)

    executor = Executor2022(tests=15, answer=answer)
    run_2022(Frenetic, executor)
    roads = outcome[0]
    assert len(roads) == 15
    for plain, compiled in zip(roads, (test.road_points for test in executor.tests), strict=True):
        assert np.allclose(plain, compiled, atol=1e-6)


def test_python_3_9_can_run_what_the_plug_in_imports(
    outcome: tuple[list[list[tuple[float, float]]], list[str]],
) -> None:
    files = [Path(file) for file in outcome[1]]
    assert {"generator.py", "frenetic.py", "validity.py"} <= {file.name for file in files}
    for file in files:
        assert too_new_in(file) == [], file


@pytest.mark.parametrize(
    "line",
    [
        "from typing import Self",
        "import numpy.typing as npt",
        "Maybe = int | None",
        "pairs = zip(a, b, strict=True)",
        "def f(a):\n    @dataclass(slots=True)\n    class B: ...",
    ],
)
def test_what_python_3_9_lacks_is_noticed(line: str) -> None:
    assert too_new(line)
