"""The plug-in of the competition's pipeline, with the command `frenetic ask-tell` behind it."""

from __future__ import annotations

import itertools
import json
import logging
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from old_python import too_new_in
from pids import until_gone
from stand_in import (
    Executor,
    Executor2021,
    Executor2022,
    ExecutorOfTwoBudgets,
    Record,
    RoadTest,
    answer_to,
    install,
    passed,
    run_2021,
    run_2022,
)

from frenetic import CampaignStore, Outcome, Road, Test, search
from frenetic.campaign.check import check_campaign
from frenetic.plugins import competition
from frenetic.plugins.competition import (
    Frenetic2021Generator,
    FreneticGenerator,
    Generator,
    RandomSearchGenerator,
)
from frenetic.search import Evaluation

FILE = Path(str(competition.__file__))
HERE = Path(__file__).parent

# Frenetic, which writes its process's id into a file.
COMMAND = """
import os, sys
from pathlib import Path

from frenetic.cli import main

Path("pid").write_text(str(os.getpid()))
sys.argv[0] = "frenetic"
main()
"""

Run = Callable[..., None]


@pytest.fixture(autouse=True)
def _in_the_pipeline(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> Iterator[None]:
    """Run a test in the pipeline, and check that the search's process has ended behind it."""
    caplog.set_level(logging.INFO)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "command.py").write_text(COMMAND, encoding="utf-8")
    monkeypatch.setenv("FRENETIC_COMMAND", f'"{sys.executable}" "{tmp_path / "command.py"}"')
    monkeypatch.setenv("FRENETIC_SEED", "5")
    monkeypatch.delenv("FRENETIC_STRATEGY_OPTIONS", raising=False)
    modules = dict(sys.modules)
    install(modules)
    for name in ("code_pipeline", "code_pipeline.tests_generation"):
        monkeypatch.setitem(sys.modules, name, modules[name])
    yield
    if sys.platform != "win32" and (tmp_path / "pid").is_file():
        until_gone([search_pid()])


def search_pid() -> int:
    return int(Path("pid").read_text(encoding="utf-8"))


def stored() -> list[Test]:
    """Return the tests of the only campaign."""
    (folder,) = Path("campaigns").iterdir()
    with CampaignStore.open(folder) as store:
        return list(store.tests(with_trajectory=True))


def warnings(log: pytest.LogCaptureFixture) -> list[str]:
    """Return the logged warnings and errors."""
    return [record.getMessage() for record in log.records if record.levelno >= logging.WARNING]


# --- the search --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("generator", "strategy", "executor", "run"),
    [
        (FreneticGenerator, search.Frenetic(seed=5), Executor2022, run_2022),
        pytest.param(
            Frenetic2021Generator,
            search.Frenetic2021(seed=5, max_redraws=0),
            Executor2021,
            run_2021,
            marks=pytest.mark.heavy,
        ),
        pytest.param(
            RandomSearchGenerator,
            search.RandomSearch(seed=5),
            ExecutorOfTwoBudgets,
            run_2022,
            marks=pytest.mark.heavy,
        ),
    ],
)
def test_a_generator_proposes_the_same_roads_as_its_strategy(
    generator: type[Generator],
    strategy: search.Strategy,
    executor: type[Executor],
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if generator is Frenetic2021Generator:  # as published: many of its roads are invalid
        monkeypatch.setenv("FRENETIC_STRATEGY_OPTIONS", "max_redraws=0")

    def answer(test: RoadTest) -> Any:
        return "FAIL" if test.id % 5 == 0 else "PASS", "", [Score(-0.1 * (test.id % 15))]

    pipeline = executor(tests=25, answer=answer)
    run(generator, pipeline)
    assert len(pipeline.tests) == 25
    for number, test in enumerate(pipeline.tests, 1):
        while True:
            candidate = strategy.ask()
            assert candidate is not None
            road, verdict = Road(candidate.curvatures, candidate.step).placed(200.0)
            if road is not None and verdict.valid:
                break
            share = (number - 1) / 25
            strategy.tell(Evaluation(candidate, Outcome.INVALID, None, share))
        assert np.allclose(test.road_points, road.road_points, rtol=0.0, atol=1e-6)
        outcome, _, (score,) = answer(test)
        strategy.tell(Evaluation(candidate, outcome, score.oob_distance, number / 25))


class Score:
    """A record without position and speed."""

    def __init__(self, oob_distance: float) -> None:
        self.oob_distance = oob_distance


@pytest.mark.heavy
def test_verdicts_and_traces_reach_the_search(caplog: pytest.LogCaptureFixture) -> None:
    def answer(test: RoadTest) -> Any:
        return answer_to(test, "FAIL", 1.5, 0.4, -1.25, 0.3) if test.id % 2 else passed(test)

    executor = Executor2022(tests=4, answer=answer)
    run_2022(FreneticGenerator, executor)
    tests = stored()
    assert [str(test.outcome) for test in tests] == ["FAIL", "PASS", "FAIL", "PASS"]
    assert [test.moobd for test in tests] == [-1.25, 0.5, -1.25, 0.5]
    assert [test.budget_spent for test in tests] == [0.25, 0.5, 0.75, 1.0]
    assert tests[0].reason == "Car drove out of the lane 1"
    for test, road_test in zip(tests, executor.tests, strict=True):
        assert test.trajectory is not None
        records = answer(road_test)[2]
        assert np.allclose(test.trajectory.x, [r.pos[0] for r in records], atol=1e-3)
        assert np.allclose(test.trajectory.y, [r.pos[1] for r in records], atol=1e-3)
        assert test.trajectory.speed.tolist() == [9.0] * len(records)
        assert test.trajectory.throttle.tolist() == [0.5] * len(records)
    steps = np.hypot(*np.diff(executor.tests[0].road_points, axis=0).T)  # to the third record
    assert tests[0].departure is not None
    assert tests[0].departure.side == "right"
    assert tests[0].departure.distance == pytest.approx(steps[:2].sum(), abs=0.3)
    assert tests[1].departure is None
    (folder,) = Path("campaigns").absolute().iterdir()
    assert not check_campaign(folder).findings
    assert f"campaign in {folder}" in caplog.text
    assert not warnings(caplog)


@pytest.mark.heavy
def test_a_users_strategy_takes_seed_options_and_map_from_its_surroundings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "mine.py").write_text(
        "from frenetic.search import Frenetic2021\nclass Mine(Frenetic2021): ...\n"
    )

    class Mine(Generator):
        strategy = "mine.py:Mine"

    monkeypatch.delenv("FRENETIC_SEED")
    monkeypatch.setenv("FRENETIC_STRATEGY_OPTIONS", "max_length=6 length_jitter=0")
    executor = Executor2022(tests=3)
    run_2022(Mine, executor, 500)
    assert {len(test.road_points) for test in executor.tests} == {26}
    (folder,) = Path("campaigns").iterdir()
    with CampaignStore.open(folder) as store:
        assert f"seed {store.config['seed']}, options max_length=6" in caplog.text
        assert store.config["map_size"] == 500


# --- answers of an executor -----------------------------------------------------------------------


def raising(_: RoadTest) -> Any:
    raise RuntimeError("the simulator is gone")


ODD: dict[str, Callable[[RoadTest], Any]] = {
    "error": lambda _: ("ERROR", "Exhausted attempts", []),
    "error without data": lambda _: ("ERROR", "Exhausted attempts", None),
    "invalid": lambda _: ("INVALID", "The road is too sharp", []),
    "pass without data": lambda _: ("PASS", "Successful test", None),
    "fail without data": lambda _: ("FAIL", "Car is not moving fast enough", []),
    "no records": lambda _: ("PASS", "Successful test", 5),
    "records of something else": lambda _: ("PASS", "Successful test", [None, "x", 3]),
    "no distance": lambda _: ("FAIL", "", [Record(0.0, (0.0, 0.0, 0.0), None)]),
    "no finite distance": lambda _: ("FAIL", "", [Score(math.nan), Score(-math.inf)]),
    "an unknown outcome": lambda test: answer_to(test, "TIMEOUT", 1.0),
    "no outcome": lambda _: (None, None, None),
    "nothing": lambda _: None,
    "half an answer": lambda _: ("PASS", "Successful test"),
    "a negative time": lambda _: ("PASS", "", [Record(-1.0, (0.0, 0.0, 0.0), 1.0)]),
    "exception": raising,
}
MIXED: dict[str, Callable[[RoadTest], Any]] = {
    "records without a distance": lambda test: (
        "FAIL",
        "",
        [*answer_to(test, "FAIL", 2.0, -1.25)[2], Record(1.0, (0.0, 0.0, 0.0), None), object()],
    ),
}


@pytest.mark.heavy
def test_the_search_survives_malformed_answers(caplog: pytest.LogCaptureFixture) -> None:
    odd = [*ODD.values(), *MIXED.values()]

    def answer(test: RoadTest) -> Any:
        return odd[test.id - 1](test) if test.id <= len(odd) else passed(test)

    pipeline = Executor2022(tests=len(odd) + 5, answer=answer)
    run_2022(Frenetic2021Generator, pipeline)
    assert len(pipeline.tests) == len(odd) + 5
    tests = stored()
    driven_roads = [str(test.outcome) for test in tests if test.outcome.is_driven]
    expected = ["PASS", "FAIL", "PASS", "PASS", "FAIL", "FAIL", "PASS", "FAIL", *["PASS"] * 5]
    assert driven_roads == expected
    assert [test.moobd for test in tests if test.moobd is not None] == [-1.25, *[0.5] * 5]
    assert len(warnings(caplog)) == len(ODD)


@pytest.mark.heavy
def test_the_search_ends_after_100_exceptions_in_a_row(caplog: pytest.LogCaptureFixture) -> None:
    executor = Executor2022(tests=10**6, answer=raising)
    run_2022(RandomSearchGenerator, executor)
    assert len(executor.tests) == 100
    assert warnings(caplog)[-1].startswith("the executor raised 100 times in a row")


@pytest.mark.heavy
def test_the_search_survives_an_unreadable_clock(caplog: pytest.LogCaptureFixture) -> None:
    class Clockless(Executor2022):
        readings = itertools.chain([None, "soon", {}, {"time-budget": None}, math.nan])
        looks = itertools.count()

        def get_remaining_time(self) -> Any:
            try:
                return next(self.readings)
            except StopIteration:
                return super().get_remaining_time()

        def is_over(self) -> bool:
            if next(self.looks) % 3 == 1:
                raise OSError("busy")
            return super().is_over()

    executor = Clockless(tests=8)
    executor.time_budget = type("Budget", (), {"time_budget": 240.0})()  # type: ignore[attr-defined]
    run_2022(RandomSearchGenerator, executor)
    # The first reading comes before the first test.
    assert [test.budget_spent for test in stored()] == [0, 0, 0, 0, 0.625, 0.75, 0.875, 1]
    silent = [line for line in warnings(caplog) if "does not say what time remains" in line]
    assert len(silent) == 1


@pytest.mark.heavy
def test_an_executors_exit_ends_the_generator(caplog: pytest.LogCaptureFixture) -> None:
    executor = Executor2022(
        tests=9, answer=lambda test: sys.exit(123) if test.id == 7 else passed(test)
    )
    with pytest.raises(SystemExit) as ended:
        run_2022(FreneticGenerator, executor)
    assert ended.value.code == 123
    assert caplog.records[-1].getMessage() == "FreneticGenerator ends after 6 PASS"
    assert len(stored()) == 6


@pytest.mark.skipif(sys.platform == "win32", reason="nothing is killed there")
def test_a_search_that_is_killed_ends_in_one_line() -> None:
    def answer(test: RoadTest) -> Any:
        if test.id == 3:
            os.kill(search_pid(), signal.SIGKILL)
            until_gone([search_pid()])
        return passed(test)

    with pytest.raises(RuntimeError, match=r"^the search has ended: .* ask-tell") as ended:
        run_2022(RandomSearchGenerator, Executor2022(tests=9, answer=answer))
    assert "\n" not in str(ended.value)


# --- mistakes, and the command's place ---------------------------------------------------------


@pytest.mark.parametrize(
    ("variable", "value", "message"),
    [
        ("FRENETIC_SEED", "many", "seed is 'many': a whole number is needed"),
        ("FRENETIC_STRATEGY_OPTIONS", "treshold=-0.3", "did you mean 'threshold'?"),
        ("FRENETIC_STRATEGY_OPTIONS", "threshold='-0.3", "No closing quotation"),
        ("FRENETIC_COMMAND", "no-such-frenetic", "set FRENETIC_COMMAND"),
        ("FRENETIC_COMMAND", f'"{sys.executable}" -V', "it said nothing"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    variable: str, value: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(RuntimeError) as raised:
        run_2022(Frenetic2021Generator, Executor2022(tests=1))
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_generator_outside_the_pipeline_is_an_error_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "code_pipeline.tests_generation", None)
    with pytest.raises(RuntimeError, match=r"run by the pipeline's competition\.py"):
        run_2022(FreneticGenerator, Executor2022(tests=1))


@pytest.mark.heavy
@pytest.mark.skipif(sys.platform == "win32", reason="its programs are no scripts")
def test_the_command_is_found_on_the_path_or_in_this_interpreter(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FRENETIC_COMMAND")
    monkeypatch.setenv("PATH", str(tmp_path))
    executor = Executor2022(tests=1)
    run_2022(RandomSearchGenerator, executor)
    assert len(executor.tests) == 1
    (tmp_path / "frenetic").write_text("#!/bin/sh\necho another one >&2\n")
    (tmp_path / "frenetic").chmod(0o755)
    with pytest.raises(RuntimeError, match="the search has ended: another one"):
        run_2022(RandomSearchGenerator, Executor2022(tests=1))


ALONE = """
import importlib.util
import json
import sys

def load(name, file):
    spec = importlib.util.spec_from_file_location(name, file)
    sys.modules[name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

plug_in, stand_in = load("ours", sys.argv[1]), load("stand_in", sys.argv[2])
stand_in.install()
executor = stand_in.Executor2022(tests=3)
stand_in.run_2022(plug_in.FreneticGenerator, executor)
others = [file for module in sys.modules.values() if (file := getattr(module, "__file__", None))]
print(json.dumps([len(executor.tests), [file for file in others if "site-packages" in file]]))
"""


@pytest.mark.parametrize("python", [sys.executable, "python3.9"])
def test_a_copy_of_the_file_needs_only_the_standard_library(python: str, tmp_path: Path) -> None:
    try:
        subprocess.run([python, "-V"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip(f"{python} is not installed")
    copy = tmp_path / "frenetic_plug_in.py"
    copy.write_bytes(FILE.read_bytes())
    process = subprocess.run(
        [python, "-I", "-S", "-c", ALONE, str(copy), str(HERE / "stand_in.py")],
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    assert json.loads(process.stdout) == [3, []]


def test_python_3_9_can_run_the_plug_in() -> None:
    assert too_new_in(FILE) == []
    assert too_new_in(HERE / "stand_in.py") == []
