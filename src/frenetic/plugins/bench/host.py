"""The process in which `frenetic bench` runs a generator of the official pipeline: a script.

The script needs Python 3.9 or newer and numpy alone. It imports nothing of Frenetic, since a
generator may have a package of that name. The generator gets the pipeline's modules and an executor
with a virtual clock. The modules come from the clone of the pipeline that holds the generator, and
need shapely and matplotlib; a lone file gets the stand-ins beside this script.

The process and the bench send each other JSON objects, a line each:

- The bench sends the terms first (`frenetic.plugins.bench.runs.assignment`). Then it answers each
  question, and sends ``{"over": true}`` when the budget is spent, even between two questions.
- The process sends objects with a ``kind``: first ``ready``, or ``end`` if the generator cannot be
  built; then the questions ``test`` (execute this road), ``valid`` and ``overlaps``; at last
  ``end``.

All that a generator prints goes to stderr.
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
BUDGET_SPENT = 123
"""Exit code by which the pipeline ends a generator whose budget is spent."""
MAX_POINTS = 10_000
"""Largest number of road points sent to the bench; a road of more than 500 is invalid anyway."""
STAND_INS = Path(__file__).resolve().parent / "standins"
"""Folder of modules that stand in for the pipeline's."""
EXECUTORS = "code_pipeline.executors"
"""Name of the pipeline's module with its executors."""

_EXECUTOR_NAME = "hosted"  # under which our executor stands in that module
_ROUNDING = 1e-12  # share of the budget that rounding errors may leave
_UNUSED_PACKAGES = ("beamngpy", "cv2", "descartes", "tensorflow")


class EmptyModules(MetaPathFinder, Loader):
    """An import hook: empty modules in place of packages with which the pipeline drives and draws.

    The bench neither drives nor draws in this process, so they need not be installed. Every
    attribute of an empty module is an empty class, and so is every attribute of such a class.
    Installed packages come first.
    """

    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        """Return the spec of a module of an unused package; None for any other module."""
        is_unused = name.partition(".")[0] in _UNUSED_PACKAGES
        return ModuleSpec(name, self, is_package=True) if is_unused else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return an empty module."""
        module = ModuleType(spec.name)
        module.__getattr__ = _empty_class  # type: ignore[method-assign]
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing: an empty module has no code to run."""


class _EmptyClassType(type):
    """Type of classes whose every attribute is an empty class."""

    def __getattr__(cls, name: str) -> type:
        return _empty_class(name)


def _empty_class(name: str) -> type:
    """Return a class that takes any arguments and does nothing.

    Raises:
        AttributeError: the name is one of those that the import system looks for, such as
            ``__path__``.
    """
    if name.startswith("__"):
        raise AttributeError(name)
    return _EmptyClassType(name, (), {"__init__": lambda *_, **__: None})


class BenchClient:
    """The connection to the bench, and the virtual clock; this process ends when the bench does.

    The connection takes over stdin and stdout: what a generator prints goes to stderr instead.
    """

    def __init__(self) -> None:
        # Other programs that the generator starts do not inherit the duplicates.
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
        """Lock for questions and tests: a generator may have threads."""
        self._process_id = os.getpid()
        self.terms: dict[str, Any] = self._received.get()
        """The bench's first message: generator, seed, budget and rules."""
        self.spent = 0.0
        """Virtual time of the tests that were executed, in s."""
        self.is_over = False
        """Whether the bench has said that the budget is spent."""
        self._clock_start = time.monotonic()
        self.running: tuple[Any, dict[str, Any]] | None = None
        """The test that is being executed, and the bench's answer to it."""

    def __deepcopy__(self, memo: dict[int, Any]) -> BenchClient:
        """Return this client itself: a copied budget holds a method of it."""
        return self

    def remaining(self) -> float:
        """Return the virtual time left, in s; a test costs its time once it has been executed."""
        budget: float = self.terms["time_budget"]
        left = 0.0 if self.is_over else budget - self.spent
        return left if left > _ROUNDING * budget else 0.0

    def send(self, **message: Any) -> None:
        """Send a message; end this process if the bench is gone."""
        try:
            self._outgoing.write(json.dumps(message).encode() + b"\n")
            # The buffer stays empty, since a process that the generator forks would inherit it.
            self._outgoing.flush()
        except OSError:
            end_process_group()

    def ask(self, kind: str, **values: Any) -> dict[str, Any]:
        """Return the answer to a question.

        Raises:
            SystemExit: The budget is spent.
            RuntimeError: This is a process that the generator has forked.

        """
        if os.getpid() != self._process_id:  # the answer would go to the process of the bench
            raise RuntimeError("the bench answers only the process that it has started")
        with self.lock:
            answer: dict[str, Any] = {}
            if not self.is_over:
                self.send(kind=kind, **values)
                answer = self._received.get()
                self.is_over = bool(answer.get("over"))
            if self.is_over:
                raise SystemExit(BUDGET_SPENT)
            return answer

    def restart_clock(self) -> float:
        """Return the wall time since the last call, in s."""
        start, self._clock_start = self._clock_start, time.monotonic()
        return self._clock_start - start

    def _read(self) -> None:
        """Queue the bench's messages; end this process after the last one."""
        try:
            for line in self._incoming:
                self._received.put(json.loads(line))
        finally:
            end_process_group()


def end_process_group() -> NoReturn:
    """End this process and, if it leads its group, all that the generator started there."""
    if sys.platform != "win32" and os.getpgrp() == os.getpid():
        os.killpg(os.getpgrp(), signal.SIGKILL)
    os._exit(ORPHANED)


def points_of(test: Any) -> list[Any] | None:
    """Return the road points of a test as JSON, at most `MAX_POINTS`; None if no numbers."""
    try:
        points = np.array(getattr(test, "road_points", None), dtype=np.float64)[:MAX_POINTS]
    except (TypeError, ValueError, OverflowError, IndexError):
        return None
    return points.tolist()  # type: ignore[no-any-return]


def make_executor(bench: BenchClient, *, is_2021: bool) -> Any:
    """Return an executor of the imported pipeline, whose tests the bench executes.

    Args:
        bench: connection to the bench.
        is_2021: whether the generator is built as in 2021; then its remaining time is a number.

    """
    pipeline = importlib.import_module(EXECUTORS)
    record = importlib.import_module("self_driving.simulation_data").SimulationDataRecord
    record_size = len(record._fields)  # the pipeline of 2021 lacks the last field
    terms, numbers = bench.terms, itertools.count(1)
    drives_folder = Path.cwd() / "simulations" / "beamng_executor"

    class HostedExecutor(pipeline.AbstractTestExecutor):  # type: ignore[misc, name-defined]
        """The pipeline's executor, whose tests the bench executes, one at a time."""

        def __reduce__(self) -> str:
            """Return the executor's name in the pipeline's module, so that copies are itself."""
            return _EXECUTOR_NAME

        def execute_test(self, the_test: Any) -> tuple[str, str, Any]:
            """Return outcome, description and records of a test; an invalid one has no records.

            Raises:
                SystemExit: The budget is spent; the test was not run and does not count.

            """
            with bench.lock:
                seconds = bench.restart_clock()
                try:
                    answer = bench.ask("test", road_points=points_of(the_test), seconds=seconds)
                except SystemExit:
                    self.timeout_forced = True
                    raise
                finally:
                    bench.restart_clock()  # the bench's time is not the generator's
                # The pipeline's `execute_test` calls `validate_test` and `_execute` below.
                bench.running = the_test, answer
                try:
                    result: tuple[str, str, Any] = super().execute_test(the_test)
                finally:
                    bench.running, bench.spent = None, answer["spent"]
                times = {"test_generation_real_times": seconds}
                if answer["outcome"] != "INVALID":
                    times["test_execution_real_times"] = terms["seconds_per_test"]
                for name, value in times.items():
                    if statistics := getattr(getattr(self, "stats", None), name, None):
                        statistics[-1] = value  # replaces the wall time that the pipeline measured
                return result

        def validate_test(self, the_test: Any) -> tuple[bool, str]:
            """Return whether a test is valid, and if not, why; costs nothing."""
            if bench.running is not None and bench.running[0] is the_test:
                answer = bench.running[1]
                is_valid = answer["outcome"] != "INVALID"
                return is_valid, "" if is_valid else answer["description"]
            answer = bench.ask("valid", road_points=points_of(the_test))
            return answer["valid"], answer["description"]

        def _execute(self, _: Any) -> tuple[str, str, list[Any]]:
            """Return the bench's outcome, description and records of the running test."""
            assert bench.running is not None
            answer = bench.running[1]
            # Some generators look for the folder of the latest drive.
            (drives_folder / f"sim_{next(numbers):05d}").mkdir(parents=True, exist_ok=True)
            records = [
                record(*(tuple(v) if isinstance(v, list) else v for v in row[:record_size]))
                for row in answer["records"]
            ]
            return answer["outcome"], answer["description"], records

        def is_over(self) -> bool:
            """Return whether the budget is spent."""
            return bench.remaining() == 0.0

        def get_elapsed_time(self) -> float:
            """Return the virtual time that has passed, in s; the pipeline of 2021 calls this."""
            return float(terms["time_budget"] - bench.remaining())

        def store_test(self, the_test: Any) -> None:
            """Do nothing: the bench keeps the tests."""

        def _close(self) -> None:
            """Do nothing: the bench ends the process."""

    HostedExecutor.__module__ = EXECUTORS
    known = inspect.signature(pipeline.AbstractTestExecutor).parameters  # in 2021 without a folder
    options = ("result_folder", "map_size", "time_budget")
    executor = HostedExecutor(**{name: terms[name] for name in options if name in known})
    budget: Any = executor.time_budget
    if hasattr(budget, "get_remaining_real_time"):  # a number in 2021
        budget.get_remaining_real_time = bench.remaining
        if is_2021:
            budget.get_remaining_time = bench.remaining
    for name in ("map_size", "oob_tolerance", "speed_limit"):
        setattr(executor, name, terms[name])
    setattr(pipeline, _EXECUTOR_NAME, executor)
    return executor


class GeneratorError(Exception):
    """The generator cannot be imported or built; the message is one line for the bench."""


@contextmanager
def _generator_errors(action: str) -> Iterator[None]:
    """Print the traceback of whatever is raised during an action, and raise one line instead.

    Raises:
        GeneratorError: the action raised, or ended the process.

    """
    try:
        yield
    except BaseException as error:
        traceback.print_exc()
        reason = f"{type(error).__name__}: {error}"
        if isinstance(error, SystemExit):
            reason = f"it ends its process with exit code {error.code}"
        elif isinstance(error, ModuleNotFoundError):
            reason += f"; install it for {sys.executable}, or give its folder as path"
            if str(error.name).partition(".")[0] in ("code_pipeline", "self_driving"):
                reason = f"{error}; give the folder of a clone of the pipeline as pipeline"
        raise GeneratorError(f"{action} fails: {reason}") from None


def build(bench: BenchClient) -> Any:
    """Return the generator, built as the pipeline of its year builds it.

    Raises:
        GeneratorError: the generator or its pipeline cannot be imported or built.

    """
    terms = bench.terms
    _import_pipeline(terms)
    random.seed(terms["seed"])
    np.random.seed(terms["seed"])  # noqa: NPY002 - what generators draw from
    generator_class = _generator_class(terms)
    for module_name, module in list(sys.modules.items()):
        if module_name.endswith("self_driving.road_polygon"):
            module.RoadPolygon.is_valid = lambda road: not _overlaps(bench, road.road_points)
    name = terms["class_name"]
    with _generator_errors(f"building {name}"):
        is_2021 = "time_budget" in inspect.signature(generator_class).parameters
        options = {"executor": make_executor(bench, is_2021=is_2021), "map_size": terms["map_size"]}
        if is_2021:
            options["time_budget"] = terms["time_budget"]
        generator = generator_class(**options)
    if not callable(getattr(generator, "start", None)):
        raise GeneratorError(f"{name} is no generator: it has no method start")
    return generator


def _import_pipeline(terms: dict[str, Any]) -> None:
    """Set the module path, and import the pipeline's executors or their stand-ins."""
    clone = terms["pipeline"]
    folders = [terms["path"]] if terms["path"] else []
    if terms["module"].endswith(".py"):
        folders.append(str(Path(terms["module"]).parent))
    # The first entry is this script's folder, which Python has put there.
    sys.path[:1] = [*folders, "", clone] if clone else [str(STAND_INS), *folders, ""]
    if clone:
        sys.meta_path.append(EmptyModules())
    os.environ["MPLBACKEND"] = "Agg"  # matplotlib without a display
    os.environ.setdefault("USERPROFILE", str(Path.home()))  # which the pipeline reads
    with _generator_errors(f"importing the pipeline in {clone}"):
        importlib.import_module(EXECUTORS)


def _generator_class(terms: dict[str, Any]) -> Any:
    """Import a generator's module and return its class.

    Raises:
        GeneratorError: the module cannot be imported, or lacks the class.

    """
    module_name, class_name = terms["module"], terms["class_name"]
    is_file = module_name.endswith(".py")
    top = Path(terms["path"] or "", module_name.partition(".")[0])
    if not is_file and top.is_dir() and not (top / "__init__.py").exists():
        # Python would prefer an installed package, such as ours, to a folder without __init__.py.
        package = sys.modules[top.name] = ModuleType(top.name)
        package.__path__ = [str(top)]
    with _generator_errors(f"importing {module_name}"):
        module = _load_file(Path(module_name)) if is_file else importlib.import_module(module_name)
    generator_class = getattr(module, class_name, None)
    if not callable(generator_class):
        classes = [
            name
            for name, member in inspect.getmembers(module, inspect.isclass)
            if hasattr(member, "start")
        ]
        raise GeneratorError(
            f"{module_name} has no class {class_name!r}. Its classes with a method start:"
            f" {', '.join(classes) or 'none'}"
        )
    return generator_class


def _overlaps(bench: BenchClient, road: Any) -> bool:
    """Return whether a road overlaps itself.

    The pipeline's own check gives the same answer and takes up to 5 s.
    """
    left, right = (
        [[float(coordinate) for coordinate in point[:2]] for point in edge]
        for edge in (road.left, road.right)
    )
    return bool(bench.ask("overlaps", left=left, right=right)["overlaps"])


def _load_file(file: Path) -> ModuleType:
    """Return the module of a file."""
    # Other modules of its folder may import it by its name, unless that is taken.
    name = f"generator_{file.stem}" if file.stem in sys.modules else file.stem
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def run(bench: BenchClient) -> tuple[str, str]:
    """Build and start a generator; return how it ends, and the reason in one line.

    The end is a value of `frenetic.plugins.bench.strategy.End`.
    """
    try:
        generator = build(bench)
    except GeneratorError as error:
        return "crashed", str(error)
    bench.send(kind="ready")
    bench.restart_clock()  # building costs a generator nothing
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
    sys.meta_path.append(EmptyModules())

if __name__ == "__main__":
    the_bench = BenchClient()
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr
    )
    end, detail = run(the_bench)
    logging.shutdown()
    for output in (sys.stdout, sys.stderr):
        output.flush()
    the_bench.send(kind="end", end=end, detail=detail, seconds=the_bench.restart_clock())
    os._exit(0)  # without waiting for the generator's threads
