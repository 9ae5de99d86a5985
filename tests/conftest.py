"""Run tests on every core, and independently of the process that starts them."""

from __future__ import annotations

import gc
import math
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from agreements import FOLDER, Agreements

# As the command line does: it has to be set before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# As the command line does, too: imported objects live as long as the process.
gc.set_threshold(50_000)

HERE = Path(__file__).parent
DURATIONS = HERE / "durations.txt"
APART = "test_docs.py"
"""File whose tests share no slow fixture: each test may run in any process."""
CALLERS = (
    *("CLICOLOR", "CLICOLOR_FORCE", "COLORTERM", "COLUMNS", "FORCE_COLOR", "LINES", "NO_COLOR"),
    *("TERM", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "MATPLOTLIBRC", "MPLBACKEND", "PYTHONWARNINGS"),
    *("BNG_HOME", "FRENETIC_SEED", "FRENETIC_STRATEGY_OPTIONS"),
)
"""Environment variables of a caller that change a program's look or parts."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="run heavy tests, too: needs .[test-all]")
    parser.addoption(
        "--keep-durations", action="store_true", help=f"write s per file to tests/{DURATIONS.name}"
    )
    parser.addoption(
        "--write-outputs", action="store_true", help="write what its code prints into each page"
    )


# Heavy tests

HEAVY = "heavy, run by pytest --all"
"""Reason to skip a test with the mark ``heavy``."""
HEAVY_FILE = re.compile(r"^pytestmark = .*\bheavy\b", re.MULTILINE)
"""Line of a file in which all tests are heavy."""


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("heavy") and not item.config.getoption("--all"):
        pytest.skip(HEAVY)


class TestFile(pytest.Module):
    """Test file; without `--all`, a heavy file whose packages are missing is skipped."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        try:
            return super().collect()
        except (ImportError, self.CollectError) as error:
            missing = error.__cause__
            is_heavy = HEAVY_FILE.search(self.path.read_text(encoding="utf-8"))
            if (
                self.config.getoption("--all")
                or not is_heavy
                or not isinstance(missing, ModuleNotFoundError)
            ):
                raise
            pytest.skip(f"{HEAVY}: {missing.name} is not installed", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    return TestFile.from_parent(parent, path=module_path)


# On every core


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return two processes per core for all tests, none for chosen tests, which start at once.

    Tests wait for about half of their time: for processes that they start, kill or let time out.
    """
    chosen = {Path(name).resolve() for name in config.args}
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    return 2 * cores if chosen & {HERE, HERE.parent} else 0


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        return
    if config.getoption("numprocesses", None):
        compile_once()
    if config.getoption("--keep-durations"):
        config.pluginmanager.register(Durations())


def compile_once() -> None:
    """Compile kernels and test files once, before the processes start that would all do it."""
    load = "from interpreters import load_kernels; load_kernels()"
    path = os.pathsep.join([str(HERE / "shared"), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": path}
    with subprocess.Popen([sys.executable, "-c", load], env=environment) as kernels:
        is_fresh = not any((HERE / "__pycache__").glob("test_*.pyc"))
        if is_fresh and not sys.dont_write_bytecode:
            collect = ("--collect-only", "-qq", "-n", "0", str(HERE))
            # If this fails, the tests say why.
            subprocess.run(
                [sys.executable, "-m", "pytest", *collect],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
    assert kernels.returncode == 0, "the kernels cannot be compiled"


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    from xdist.scheduler.loadscope import LoadScopeScheduling  # type: ignore[import-untyped]

    class ByFile(LoadScopeScheduling):  # type: ignore[misc]
        """Gives a process a file at a time, as tests of a file share slow fixtures."""

        def _split_scope(self, nodeid: str) -> str:
            file = file_of(nodeid)
            return nodeid if file.endswith(APART) else file

    config.option.loadscopereorder = False  # they are in order
    return ByFile(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort new files and the longest to the front, so that all processes end together."""
    if hasattr(config, "workerinput"):
        seconds = kept_durations()
        items.sort(key=lambda item: -seconds.get(file_of(item.nodeid), math.inf))


def pytest_collection_finish() -> None:
    """Exempt all present objects from garbage collection: they live as long as the process."""
    gc.freeze()


class Durations:
    """Writes how long the tests of each file took; files that did not run keep their time."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[file_of(report.nodeid)] += report.duration  # type: ignore[assignment]

    def pytest_sessionfinish(self) -> None:
        known = {file: s for file, s in kept_durations().items() if (HERE.parent / file).exists()}
        seconds = Counter(known | self.seconds)
        lines = [f"{s:6.1f} {file}\n" for file, s in seconds.most_common()]
        DURATIONS.write_text("".join(lines), encoding="utf-8")


def kept_durations() -> dict[str, float]:
    """Return the time that the tests of each file took, in s."""
    lines = DURATIONS.read_text(encoding="utf-8").splitlines()
    return {file: float(number) for number, file in map(str.split, lines)}


def file_of(nodeid: str) -> str:
    return nodeid.partition("::")[0]


# The same for every caller


@pytest.fixture(scope="session", autouse=True)
def _independent_of_caller(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hide the caller's variables, files and ignored signals from tests.

    `nohup` ignores SIGHUP, a script's background job SIGINT; processes inherit ignored signals.
    """
    ignored = {
        number: signal.SIG_IGN
        for number in signal.valid_signals()
        if signal.getsignal(number) is signal.SIG_IGN
        # Python itself ignores these, but not in the processes that it starts.
        and number not in (getattr(signal, "SIGPIPE", None), getattr(signal, "SIGXFSZ", None))
    }
    with pytest.MonkeyPatch.context() as patch:
        for name in CALLERS:
            patch.delenv(name, raising=False)
        patch.setenv("FRENETIC_HOME", str(tmp_path_factory.mktemp("home")))
        patch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)  # frenetic's
        for number in ignored:
            # Tests go on under nohup; processes that they start have the default handler.
            is_ctrl_c = number == signal.SIGINT
            signal.signal(number, signal.default_int_handler if is_ctrl_c else lambda *_: None)
        yield
        for number, handler in ignored.items():
            signal.signal(number, handler)


@pytest.fixture(scope="session")
def endurance(request: pytest.FixtureRequest) -> bool:
    """Whether tests run in full, by `pytest --all -m endurance`, or in a short form."""
    return "endurance" in str(request.config.getoption("markexpr"))


@pytest.fixture
def agreements(request: pytest.FixtureRequest, endurance: bool) -> Agreements:
    """The agreements of the test's file."""
    return Agreements(FOLDER / f"{request.path.stem}.txt", anew=endurance)


@pytest.fixture(scope="module")
def new_process_server() -> None:
    """Let the next process start its own server, which loads the modules of its simulator."""
    if sys.platform == "linux":
        from multiprocessing import forkserver

        forkserver._forkserver._stop()  # type: ignore[attr-defined]
