"""The process in which `frenetic bench` runs a generator of the official pipeline: a script.

It needs Python 3.9 and numpy alone and imports nothing of Frenetic, whose name a generator may have
for a package of its own. A generator finds the pipeline's modules and an executor whose time is
virtual. The modules come from the clone of the pipeline that holds the generator, which need
shapely and matplotlib; for a lone file there are stand-ins.

The process and the bench send each other JSON objects, a line each. The bench sends the terms
first, then an answer to each question, and ``{"over": true}`` when the budget is spent, asked or
not. The process sends ``ready``; the questions ``test`` (execute this road), ``valid`` and
``overlaps``; and at last ``end``. All that a generator prints goes to stderr.
"""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import itertools
import json
import logging
import os
import queue
import random
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn

import numpy as np

ORPHANED = 3
"""Exit code when the bench is gone."""
OVER = 123
"""Exit code by which the pipeline ends a generator whose budget is spent."""
MOST_POINTS = 10_000
"""Most road points sent to the bench; a road of more than 500 is invalid anyway."""
STAND_INS = Path(__file__).resolve().parent / "standins"
EXECUTORS = "code_pipeline.executors"
"""The pipeline's module of that name."""

_NAME = "hosted"  # of the executor in that module
_ROUNDING = 1e-12  # share of the budget that rounding may leave
_UNUSED = ("beamngpy", "cv2", "descartes", "tensorflow")


class Unused(MetaPathFinder, Loader):
    """Gives the pipeline what it imports to drive and draw, which nobody does here.

    Every name of such a module is an empty class, and every name of that. Installed packages come
    first.
    """

    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        """Return a module's spec, None for all that is used."""
        unused = name.partition(".")[0] in _UNUSED
        return ModuleSpec(name, self, is_package=True) if unused else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return the module."""
        module = ModuleType(spec.name)
        module.__getattr__ = _empty_class  # type: ignore[method-assign]
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing: it is whole."""


class _Empty(type):
    def __getattr__(cls, name: str) -> type:
        return _empty_class(name)


def _empty_class(name: str) -> type:
    if name.startswith("__"):  # what the import system asks for
        raise AttributeError(name)
    return _Empty(name, (), {"__init__": lambda *_, **__: None})


class BenchClient:
    """The other end, and its count of the virtual time; this process ends when it has gone."""

    def __init__(self) -> None:
        # Duplicates are not passed on to other programs.
        self._incoming, self._outgoing = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        os.dup2(2, 1)
        for stream in (sys.stdout, sys.stderr):
            # In every locale: a generator must not fail at its output.
            stream.reconfigure(  # type: ignore[union-attr]
                encoding="utf-8", errors="backslashreplace", line_buffering=True
            )
        self._received: queue.SimpleQueue[Any] = queue.SimpleQueue()
        threading.Thread(target=self._read, daemon=True).start()
        self.lock = threading.RLock()
        self._process = os.getpid()
        self.terms: dict[str, Any] = self._received.get()
        self.spent = 0.0
        self.is_over = False
        self.since = time.monotonic()
        """When the generator was last let go on."""
        self.running: tuple[Any, dict[str, Any]] | None = None
        """The test that is being executed, and what the bench has answered."""

    def __deepcopy__(self, memo: dict[int, Any]) -> BenchClient:
        """Return itself: budgets are copied with it."""
        return self

    def remaining(self) -> float:
        """Return virtual s, at least 0; a test is paid when it has been executed."""
        budget: float = self.terms["time_budget"]
        left = 0.0 if self.is_over else budget - self.spent
        return left if left > _ROUNDING * budget else 0.0

    def send(self, **message: Any) -> None:
        """Send a message."""
        try:
            self._outgoing.write(json.dumps(message).encode() + b"\n")
            # The buffer stays empty, since a process that the generator forks would inherit it.
            self._outgoing.flush()
        except OSError:
            leave()

    def ask(self, kind: str, **values: Any) -> dict[str, Any]:
        """Return the answer to a question.

        Raises:
            SystemExit: The budget is spent.
            RuntimeError: This is a process that the generator has forked.

        """
        if os.getpid() != self._process:  # where nobody would hear the answer
            raise RuntimeError("the bench answers only the process that it has started")
        with self.lock:
            answer: dict[str, Any] = {}
            if not self.is_over:
                self.send(kind=kind, **values)
                answer = self._received.get()
                self.is_over = bool(answer.get("over"))
            if self.is_over:
                raise SystemExit(OVER)
            return answer

    def seconds(self) -> float:
        """Return the s of wall time since the generator was last let go on."""
        since, self.since = self.since, time.monotonic()
        return self.since - since

    def _read(self) -> None:
        try:
            for line in self._incoming:
                self._received.put(json.loads(line))
        finally:
            leave()


def leave() -> NoReturn:
    """End this process and, if it leads its group, all that the generator started there."""
    if sys.platform != "win32" and os.getpgrp() == os.getpid():
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(ORPHANED)


def points_of(test: Any) -> list[Any] | None:
    """Return the road points of a test as JSON, None if they are no numbers."""
    try:
        points = np.array(getattr(test, "road_points", None), dtype=np.float64)[:MOST_POINTS]
    except (TypeError, ValueError, OverflowError, IndexError):
        return None
    return points.tolist()  # type: ignore[no-any-return]


def make_executor(bench: BenchClient, *, is_2021: bool) -> Any:
    """Return an executor of the pipeline that is on the module path, with the bench behind it.

    Args:
        bench: the other end.
        is_2021: whether its remaining time is a number.

    """
    pipeline = importlib.import_module(EXECUTORS)
    record = importlib.import_module("self_driving.simulation_data").SimulationDataRecord
    size = len(record._fields)  # one less in 2021
    terms, numbers = bench.terms, itertools.count(1)
    drives = Path.cwd() / "simulations" / "beamng_executor"

    class HostedExecutor(pipeline.AbstractTestExecutor):  # type: ignore[misc, name-defined]
        """The pipeline's executor, whose tests the bench executes, one at a time."""

        def __reduce__(self) -> str:
            """Return its name in the pipeline's module: copies of it are itself."""
            return _NAME

        def execute_test(self, the_test: Any) -> tuple[str, str, Any]:
            """Return outcome, description and records of a test; an invalid one has no records.

            Raises:
                SystemExit: The budget is spent; the test was not run and does not count.

            """
            with bench.lock:
                seconds = bench.seconds()
                try:
                    answer = bench.ask("test", road_points=points_of(the_test), seconds=seconds)
                except SystemExit:
                    self.timeout_forced = True
                    raise
                finally:
                    bench.seconds()
                bench.running = the_test, answer
                try:
                    result: tuple[str, str, Any] = super().execute_test(the_test)
                finally:
                    bench.running, bench.spent = None, answer["spent"]
                times = {"test_generation_real_times": seconds}
                if answer["outcome"] != "INVALID":
                    times["test_execution_real_times"] = terms["seconds_per_test"]
                for name, value in times.items():  # in the place of the pipeline's
                    if noted := getattr(getattr(self, "stats", None), name, None):
                        noted[-1] = value
                return result

        def validate_test(self, the_test: Any) -> tuple[bool, str]:
            """Return whether a test is valid, and if not, why; costs nothing."""
            if bench.running is not None and bench.running[0] is the_test:
                answer = bench.running[1]
                invalid = answer["outcome"] == "INVALID"
                return not invalid, answer["description"] if invalid else ""
            answer = bench.ask("valid", road_points=points_of(the_test))
            return answer["valid"], answer["description"]

        def _execute(self, _: Any) -> tuple[str, str, list[Any]]:
            assert bench.running is not None
            answer = bench.running[1]
            # Some generators note the name of the latest drive's folder.
            (drives / f"sim_{next(numbers):05d}").mkdir(parents=True, exist_ok=True)
            records = [
                record(*(tuple(v) if isinstance(v, list) else v for v in row[:size]))
                for row in answer["records"]
            ]
            return answer["outcome"], answer["description"], records

        def is_over(self) -> bool:
            """Return whether nothing remains of the budget."""
            return bench.remaining() == 0.0

        def get_elapsed_time(self) -> float:
            """Return virtual s; the pipeline of 2021 asks for them."""
            return float(terms["time_budget"] - bench.remaining())

        def store_test(self, the_test: Any) -> None:
            """Do nothing: the bench keeps the tests."""

        def _close(self) -> None:
            """Do nothing: the bench ends the process."""

    HostedExecutor.__module__ = EXECUTORS
    known = inspect.signature(pipeline.AbstractTestExecutor).parameters  # 2021 knows no folder
    options = ("result_folder", "map_size", "time_budget")
    executor = HostedExecutor(**{name: terms[name] for name in options if name in known})
    budget: Any = executor.time_budget
    if hasattr(budget, "get_remaining_real_time"):  # a number in 2021
        budget.get_remaining_real_time = bench.remaining
        if is_2021:
            budget.get_remaining_time = bench.remaining
    for name in ("map_size", "oob_tolerance", "speed_limit"):
        setattr(executor, name, terms[name])
    setattr(pipeline, _NAME, executor)
    return executor


class GeneratorError(Exception):
    """A generator that cannot be imported or built."""


@contextmanager
def _reported(action: str) -> Iterator[None]:
    """Turn whatever a generator raises meanwhile into one line."""
    try:
        yield
    except BaseException as error:
        traceback.print_exc()
        why = f"{type(error).__name__}: {error}"
        if isinstance(error, SystemExit):
            why = f"it ends its process with exit code {error.code}"
        elif isinstance(error, ModuleNotFoundError):
            why += f"; install it for {sys.executable}, or give its folder as path"
            if str(error.name).partition(".")[0] in ("code_pipeline", "self_driving"):
                why = f"{error}; give the folder of a clone of the pipeline as pipeline"
        raise GeneratorError(f"{action} fails: {why}") from None


def build(bench: BenchClient) -> Any:
    """Return the generator, built as the pipeline of its year does it.

    Raises:
        GeneratorError: It cannot be imported or built.

    """
    terms = bench.terms
    module, name, clone = terms["module"], terms["class_name"], terms["pipeline"]
    is_file = module.endswith(".py")
    folders = [terms["path"]] if terms["path"] else []
    folders += [str(Path(module).parent)] if is_file else []
    # Python has put this script's folder first.
    sys.path[:1] = [*folders, "", clone] if clone else [str(STAND_INS), *folders, ""]
    if clone:
        sys.meta_path.append(Unused())
    os.environ["MPLBACKEND"] = "Agg"
    os.environ.setdefault("USERPROFILE", str(Path.home()))  # which the pipeline reads
    with _reported(f"importing the pipeline in {clone}"):
        importlib.import_module(EXECUTORS)
    random.seed(terms["seed"])
    np.random.seed(terms["seed"])  # noqa: NPY002 - what generators draw from
    top = Path(terms["path"] or "", module.partition(".")[0])
    if not is_file and top.is_dir() and not (top / "__init__.py").exists():
        # Python would take an installed package of that name first, such as ours.
        package = sys.modules[top.name] = ModuleType(top.name)
        package.__path__ = [str(top)]
    with _reported(f"importing {module}"):
        home = _load_file(Path(module)) if is_file else importlib.import_module(module)
    kind = getattr(home, name, None)
    if not callable(kind):
        classes = [k for k, v in inspect.getmembers(home, inspect.isclass) if hasattr(v, "start")]
        raise GeneratorError(
            f"{module} has no class {name!r}. Its classes with a method start:"
            f" {', '.join(classes) or 'none'}"
        )
    for loaded, its in list(sys.modules.items()):
        if loaded.endswith("self_driving.road_polygon"):
            its.RoadPolygon.is_valid = lambda road: not _overlaps(bench, road.road_points)
    with _reported(f"building {name}"):
        is_2021 = "time_budget" in inspect.signature(kind).parameters
        options = {"executor": make_executor(bench, is_2021=is_2021), "map_size": terms["map_size"]}
        if is_2021:
            options["time_budget"] = terms["time_budget"]
        generator = kind(**options)
    if not callable(getattr(generator, "start", None)):
        raise GeneratorError(f"{name} is no generator: it has no method start")
    return generator


def _overlaps(bench: BenchClient, road: Any) -> bool:
    """Whether a road overlaps itself; the pipeline's own answer is the same and takes up to 5 s."""
    left, right = ([[float(v) for v in at[:2]] for at in edge] for edge in (road.left, road.right))
    return bool(bench.ask("overlaps", left=left, right=right)["overlaps"])


def _load_file(file: Path) -> ModuleType:
    # Others of its folder may import it by its name, unless that is taken.
    name = f"generator_{file.stem}" if file.stem in sys.modules else file.stem
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def run(bench: BenchClient) -> tuple[str, str]:
    """Build and start a generator; return how it ends, an `End` of the bench, and a line."""
    try:
        generator = build(bench)
    except GeneratorError as error:
        return "crashed", str(error)
    bench.send(kind="ready")
    bench.seconds()
    try:
        generator.start()
    except SystemExit as error:
        if bench.remaining() > 0.0:
            return "exit", f"exit code {error.code}"
    except BaseException as error:
        traceback.print_exc()
        return "crashed", f"{type(error).__name__}: {error}"
    return ("returned" if bench.remaining() > 0.0 else "over"), ""


if __name__ == "__mp_main__":  # a process that a generator has spawned
    sys.meta_path.append(Unused())

if __name__ == "__main__":
    the_bench = BenchClient()
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr
    )
    end, detail = run(the_bench)
    logging.shutdown()
    for output in (sys.stdout, sys.stderr):
        output.flush()
    the_bench.send(kind="end", end=end, detail=detail, seconds=the_bench.seconds())
    os._exit(0)  # without waiting for the generator's threads
