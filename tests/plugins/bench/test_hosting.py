"""The process in which a bench runs a generator, tested with a small scripted bench."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from old_python import too_new_in
from pids import ending, until, until_gone

import frenetic
from frenetic.errors import RoadError
from frenetic.road import check_validity
from frenetic.road.validity import overlaps_itself

BENCH = Path(frenetic.__file__).parent / "plugins" / "bench"
MAIN = BENCH / "host.py"
GENERATORS = Path(__file__).parent / "generators"
PATIENCE = 120.0  # [s], after which a process is killed that should have ended long before

Message = dict[str, Any]


def record(timer: float, oob_distance: float) -> list[Any]:
    place, ahead = [10.0, 20.0, -28.0], [1.0, 0.0, 0.0]
    controls = [1.5, 2.5, 0.0, 0.0, 0.5, 0.5]
    return [timer, place, ahead, ahead, *controls, 9.0, 32, False, 0, 0.0, oob_distance, 0.25]


@dataclass
class Bench:
    """A scripted bench: refuses invalid roads, and lets every third valid road fail."""

    budget: float = 360.0
    seconds_per_test: float = 36.0
    executed: int = 0
    roads: list[Any] = field(default_factory=list)
    """Road points of the tests within the budget."""
    refused: int = 0
    """Number of tests that were refused because the budget was spent."""
    all_pass: bool = False

    def answer(self, message: Message) -> Message:
        if message["kind"] == "overlaps":
            left, right = (np.array(message[side]) for side in ("left", "right"))
            return {"overlaps": overlaps_itself(left, right)}
        road_points = message["road_points"]
        if message["kind"] == "valid":
            verdict = check_validity(road_points)
            return {"valid": verdict.valid, "description": verdict.message}
        assert message["seconds"] >= 0.0
        if (self.executed + 1) * self.seconds_per_test > self.budget + 1e-9:
            self.refused += 1
            return {"over": True}
        self.roads.append(road_points)
        try:
            verdict = check_validity(road_points)
            valid, reason = verdict.valid, verdict.message
        except RoadError as error:
            valid, reason = False, str(error)
        outcome, description, records = "INVALID", reason, []
        if valid:
            self.executed += 1
            failed = self.executed % 3 == 0 and not self.all_pass
            outcome = "FAIL" if failed else "PASS"
            description = "Car drove out of the lane to the left" if failed else "Successful test"
            records = [record(0.0, 2.0), record(0.05, -0.5 if failed else 1.0)]
        return {
            "outcome": outcome,
            "description": description,
            "records": records,
            "spent": self.executed * self.seconds_per_test,
        }


@dataclass
class Run:
    """Messages, log, exit code and folder of a generator's process."""

    messages: list[Message]
    log: str
    code: int
    folder: Path

    @property
    def end(self) -> Message:
        assert self.messages[-1]["kind"] == "end", (self.messages[-1], self.log)
        return self.messages[-1]

    def statistics(self) -> Any:
        return json.loads((self.folder / "statistics.json").read_text(encoding="utf-8"))


def assignment(spec: str, bench: Bench, folder: Path, **changes: Any) -> Message:
    module, _, name = spec.rpartition(":")
    return {
        "module": module,
        "class_name": name,
        "path": str(GENERATORS),
        "pipeline": None,
        "map_size": 200,
        "seed": 5,
        "time_budget": bench.budget,
        "seconds_per_test": bench.seconds_per_test,
        "oob_tolerance": 0.95,
        "speed_limit": 70.0,
        "result_folder": str(folder / "results"),
        **changes,
    }


@contextmanager
def started(folder: Path, command: Sequence[str | Path]) -> Iterator[subprocess.Popen[bytes]]:
    """Start a process whose stderr goes to ``log``; kill it after ``PATIENCE``."""
    with (
        (folder / "log").open("wb") as log,
        subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            env=os.environ | {"PYTHONHASHSEED": "5"},
        ) as process,
    ):
        watchdog = threading.Timer(PATIENCE, process.kill)
        watchdog.start()
        try:
            yield process
        finally:
            watchdog.cancel()
            process.kill()


def send(process: subprocess.Popen[bytes], message: Message) -> None:
    assert process.stdin is not None
    process.stdin.write(json.dumps(message).encode() + b"\n")
    process.stdin.flush()


def run(
    spec: str,
    folder: Path,
    *,
    bench: Bench | None = None,
    command: Sequence[str | Path] = (sys.executable, "-u", MAIN),
    stop: Callable[[Bench], bool] = lambda _: False,
    **changes: Any,
) -> Run:
    """Run a generator to its end, or until ``stop`` returns true after a test."""
    bench = bench or Bench()
    messages: list[Message] = []
    with started(folder, command) as process:
        assert process.stdout is not None
        send(process, assignment(spec, bench, folder, **changes))
        for line in process.stdout:
            messages.append(json.loads(line))
            if messages[-1]["kind"] in ("test", "valid", "overlaps"):
                send(process, bench.answer(messages[-1]))
                if stop(bench):
                    break
        else:
            process.wait()
        process.stdin.close()  # type: ignore[union-attr]
        code = process.wait()
    log = (folder / "log").read_text(encoding="utf-8")
    return Run(messages, log, code, folder)


# --- generators --------------------------------------------------------------------------------


def test_a_fifth_of_the_budget_lasts_for_a_fifth_of_the_tests(tmp_path: Path) -> None:
    bench = Bench(budget=7200.0)
    result = run("many:Phases", tmp_path, bench=bench)
    assert result.end["end"] == "over"
    assert (tmp_path / "first_phase.txt").read_text(encoding="utf-8") == "40"
    assert (bench.executed, bench.refused) == (200, 1)


@pytest.mark.parametrize(
    "spec", ["frenetic:Frenetic", f"{GENERATORS / 'own_frenetic' / 'frenetic.py'}:Frenetic"]
)
def test_a_generators_module_may_be_called_frenetic(spec: str, tmp_path: Path) -> None:
    bench = Bench()
    result = run(spec, tmp_path, bench=bench, path=str(GENERATORS / "own_frenetic"))
    assert result.end["end"] == "over", result.end
    assert bench.executed == 10


def test_a_generators_folder_may_be_called_frenetic(tmp_path: Path) -> None:
    folder = tmp_path / "tool" / "frenetic" / "generators"
    folder.mkdir(parents=True)
    (folder.parent / "points.py").write_text("POINTS = [(50.0, 20.0), (50.0, 90.0)]\n")
    (folder / "straight.py").write_text(
        "import pickle\n"
        "from code_pipeline.tests_generation import RoadTestFactory\n"
        "from frenetic.points import POINTS\n"
        "class Straight:\n"
        "    def __init__(self, executor=None, map_size=None):\n"
        "        self.executor = pickle.loads(pickle.dumps(executor))\n"
        "    def start(self):\n"
        "        test = RoadTestFactory.create_road_test(POINTS)\n"
        "        assert self.executor.validate_test(test) == (True, '')\n"
        "        assert self.executor.execute_test(test)[0] == 'PASS'\n",
        encoding="utf-8",
    )
    spec = "frenetic.generators.straight:Straight"
    result = run(spec, tmp_path, path=str(tmp_path / "tool"))
    assert result.end["end"] == "returned", result.end


def test_a_generators_spawned_processes_can_import_the_pipeline(tmp_path: Path) -> None:
    bench = Bench()
    result = run("parallel:Parallel", tmp_path, bench=bench)
    assert result.end["end"] == "returned", result.end
    assert bench.executed == 2


# --- in a clone of the pipeline ----------------------------------------------------------------

CLONE = GENERATORS / "clone"


def test_a_generator_runs_in_its_own_pipeline(tmp_path: Path) -> None:
    places: Message = {"path": str(CLONE / "tool"), "pipeline": str(CLONE)}
    result = run("winding:Winding", tmp_path, bench=Bench(all_pass=True), **places)
    assert result.end["end"] == "over", result.end
    statistics = result.statistics()
    assert statistics["outcomes"] == ["PASS"] * 10
    assert statistics["generation"] == {"time-budget": 0.0}
    assert statistics["test_execution_real_times"] == [36.0] * 10
    assert min(statistics["test_generation_real_times"]) >= 0.0
    assert not (tmp_path / "results").exists()  # the bench stores the tests
    drives = sorted(path.name for path in (tmp_path / "simulations/beamng_executor").iterdir())
    assert drives == [f"sim_{number:05d}" for number in range(1, 11)]


def test_an_error_names_the_library_that_a_pipeline_lacks(tmp_path: Path) -> None:
    shutil.copytree(CLONE, tmp_path / "clone")
    executors = tmp_path / "clone" / "code_pipeline" / "executors.py"
    executors.write_text("import no_such_thing")
    places: Message = {"path": str(tmp_path / "clone/tool"), "pipeline": str(tmp_path / "clone")}
    result = run("winding:Winding", tmp_path, **places)
    assert "importing the pipeline in" in result.end["detail"]
    assert "No module named 'no_such_thing'; install it for" in result.end["detail"]


SPENDING = """
import os
from code_pipeline.tests_generation import RoadTestFactory

class Spending:
    def __init__(self, executor=None, map_size=None):
        self.executor = executor

    def start(self):
        ask, test = self.executor, RoadTestFactory.create_road_test([(50.0, 20.0), (50.0, 90.0)])
        left = [ask.get_remaining_time()["time-budget"]]
        while not ask.is_over():
            result = ask.execute_test(test)
            left.append(ask.time_budget.get_remaining_real_time())
            assert ask.get_elapsed_time() == 0.9 - left[-1]
        assert [round(s, 9) for s in left] == [0.9, 0.6, 0.3, 0.0]
        assert (test.test_outcome, test.description, test.execution_data) == result
        assert result[2][0].pos == (10.0, 20.0, -28.0)
        assert (ask.oob_tolerance, ask.map_size, ask.speed_limit) == (0.95, 200, 70.0)
        pid = os.fork()
        if not pid:
            try:
                ask.validate_test(test)
            except RuntimeError:
                os._exit(7)
        assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 7
        for _ in range(2):
            try:
                ask.execute_test(test)
            except SystemExit as error:
                assert error.code == 123 and ask.is_force_timeout()
        open("done", "w").close()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="it forks")
def test_a_budget_of_three_tests_allows_exactly_three(tmp_path: Path) -> None:
    (tmp_path / "spending.py").write_text(SPENDING, encoding="utf-8")
    bench = Bench(budget=0.9, seconds_per_test=0.3)  # in floats, 0.9 is not 3 * 0.3
    result = run("spending:Spending", tmp_path, bench=bench, path=str(tmp_path))
    assert result.end["end"] == "over", (result.end, result.log)
    assert (bench.executed, bench.refused) == (3, 1)
    assert (tmp_path / "done").is_file()


# --- generators that cannot be started ---------------------------------------------------------

START = "class Mine:\n    def start(self): ..."


@pytest.mark.parametrize(
    ("spec", "source", "message"),
    [
        ("nowhere:Some", "", "No module named 'nowhere'; install it for"),
        ("{path}/nowhere.py:Some", "", "importing {path}/nowhere.py fails: FileNotFoundError"),
        ("mine:Mine", "import no_such_thing", "No module named 'no_such_thing'; install it for"),
        ("mine:Mine", "import code_pipeline.visualization", "a clone of the pipeline as pipeline"),
        ("mine:Mine", "import sys\nsys.exit(2)", "it ends its process with exit code 2"),
        ("mine:Mine", "def", "importing mine fails: SyntaxError"),
        ("mine:Mime", START, "mine has no class 'Mime'. Its classes with a method start: Mine"),
        ("mine:Mine", "Mine = 5", "Its classes with a method start: none"),
        ("mine:Mine", "def Mine(**_): return 5", "Mine is no generator: it has no method start"),
        ("mine:Mine", START, "building Mine fails: TypeError"),
    ],
)
def test_a_generator_that_cannot_be_started_says_why(
    spec: str, source: str, message: str, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(source, encoding="utf-8")
    result = run(spec.replace("{path}", str(tmp_path)), tmp_path, path=str(tmp_path))
    assert [message["kind"] for message in result.messages] == ["end"]
    assert result.end["end"] == "crashed"
    assert message.replace("{path}", str(tmp_path)) in result.end["detail"]
    assert "\n" not in result.end["detail"]


# --- the process -------------------------------------------------------------------------------

MEDDLER = """
import os, sys

print("at import")

class Meddler:
    def __init__(self, executor, map_size):
        print("to stdout"); sys.stdout.write("half a line")
        os.write(1, b"to descriptor 1\\n")
        os.system("echo from another program")
        assert sys.stdin.read() == ""
        assert not any(entry.endswith("bench") for entry in sys.path)
        print("\\N{GREEK SMALL LETTER KAPPA} \\udc80")

    def start(self):
        import host
        assert host.IS_GENERATORS
"""


def test_nothing_that_a_generator_prints_disturbs_the_bench(tmp_path: Path) -> None:
    (tmp_path / "meddler.py").write_text(MEDDLER, encoding="utf-8")
    # The working directory is on the module path, the folder of our own host.py is not.
    (tmp_path / "host.py").write_text("IS_GENERATORS = True", encoding="utf-8")
    result = run("meddler:Meddler", tmp_path, path=None)
    assert [message["kind"] for message in result.messages] == ["ready", "end"]
    assert result.end["end"] == "returned", result.end
    for text in (
        "at import",
        "half a line",
        "to descriptor 1",
        "from another program",
        "κ \\udc80",
    ):
        assert text in result.log


def test_the_process_ends_when_it_gets_no_task(tmp_path: Path) -> None:
    with started(tmp_path, (sys.executable, "-u", MAIN)) as process:
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait() == 3


ABANDONING = """
import subprocess, sys
process = subprocess.Popen(
    [sys.executable, "-u", MAIN], cwd=FOLDER, stdin=subprocess.PIPE, start_new_session=True
)
process.stdin.write(sys.stdin.buffer.readline())
process.stdin.flush()
print(process.pid, flush=True)
sys.stdin.buffer.read()
process.stdin.close()
process.wait()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no process groups")
@pytest.mark.parametrize("is_killed", [False, True])
def test_a_generator_and_its_processes_end_with_the_bench(is_killed: bool, tmp_path: Path) -> None:
    script = ABANDONING.replace("MAIN", repr(str(MAIN))).replace("FOLDER", repr(str(tmp_path)))
    pids: list[int] = []
    with ending(lambda: pids), started(tmp_path, (sys.executable, "-u", "-c", script)) as bench:
        assert bench.stdin is not None
        assert bench.stdout is not None
        send(bench, assignment("many:Sleeping", Bench(), tmp_path))
        pids.append(int(bench.stdout.readline()))
        helper = tmp_path / "helper"
        until(lambda: helper.is_file() and helper.read_text("utf-8"), "a helper is started")
        pids.append(int(helper.read_text("utf-8")))
        if is_killed:
            bench.kill()
        else:
            bench.stdin.close()
        until_gone(pids)


# --- an older Python ---------------------------------------------------------------------------

IMPORT_GUARD = """
import importlib.abc
import sys

ALLOWED = {*sys.stdlib_module_names, "code_pipeline", "numpy", "random_roads", "roads",
           "self_driving"}


class ImportGuard(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        top = name.partition(".")[0]
        if top not in ALLOWED and not top.startswith("_"):
            raise ModuleNotFoundError(f"no {name} here", name=name)


sys.meta_path.insert(0, ImportGuard())
"""
NUMPY_ONLY = f"""{IMPORT_GUARD}
import runpy

sys.argv = [MAIN]
runpy.run_path(MAIN, run_name="__main__")
"""


def numpy_only_command() -> Sequence[str | Path]:
    """Return the command that runs the process with numpy as the only library."""
    return (sys.executable, "-u", "-c", NUMPY_ONLY.replace("MAIN", repr(str(MAIN))))


def test_a_generators_process_needs_numpy_alone(tmp_path: Path) -> None:
    bench, full_bench = Bench(), Bench()
    result = run("random_roads:RandomRoads", tmp_path, bench=bench, command=numpy_only_command())
    assert result.end["end"] == "over", result.end
    (tmp_path / "full").mkdir()
    run("random_roads:RandomRoads", tmp_path / "full", bench=full_bench)
    assert bench.roads == full_bench.roads


def test_python_3_9_can_run_host_and_stand_ins() -> None:
    for file in (MAIN, *(BENCH / "standins").rglob("*.py")):
        assert too_new_in(file) == [], file
