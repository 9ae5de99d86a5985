"""How all tests run: on every core, and alike whatever the process is like that starts them."""

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

# As the command line does, before numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Likewise; what is imported lives as long as the process.
gc.set_threshold(50_000)

HERE = Path(__file__).parent
DURATIONS = HERE / "durations.txt"
APART = "test_docs.py"
"""File whose tests share nothing that takes long to make: any process may take any of them."""
CALLERS = (
    *("CLICOLOR", "CLICOLOR_FORCE", "COLORTERM", "COLUMNS", "FORCE_COLOR", "LINES", "NO_COLOR"),
    *("TERM", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "MATPLOTLIBRC", "MPLBACKEND", "PYTHONWARNINGS"),
    *("BNG_HOME", "FRENETIC_SEED", "FRENETIC_STRATEGY_OPTIONS"),
)
"""Variables by which a caller says what programs are to look like and to use."""


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
"""Reason to skip a test that is marked so."""
HEAVY_FILE = re.compile(r"^pytestmark = .*\bheavy\b", re.MULTILINE)
"""Line of a file all of whose tests are heavy."""


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("heavy") and not item.config.getoption("--all"):
        pytest.skip(HEAVY)


class TestFile(pytest.Module):
    """Test file; without `--all`, a heavy one whose packages are not installed is skipped."""

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
    """Two processes per core for all tests; none for chosen ones, which begin at once so.

    About half of the time a test waits: for a process that it starts, kills or lets time out.
    """
    chosen = {Path(name).resolve() for name in config.args}
    cores = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    return 2 * cores if chosen & {HERE, HERE.parent} else 0


def pytest_configure(config: pytest.Config) -> None:
    if hasattr(config, "workerinput"):
        return
    if config.getoption("numprocesses", None):
        # Kernels are compiled once, before the processes start that would all compile them.
        load = "from interpreters import load_kernels; load_kernels()"
        path = os.pathsep.join([str(HERE / "shared"), os.environ.get("PYTHONPATH", "")])
        environment = os.environ | {"PYTHONPATH": path}
        subprocess.run([sys.executable, "-c", load], env=environment, check=True)
    if config.getoption("--keep-durations"):
        config.pluginmanager.register(Durations())


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    from xdist.scheduler.loadscope import LoadScopeScheduling  # type: ignore[import-untyped]

    class ByFile(LoadScopeScheduling):  # type: ignore[misc]
        """A process takes a file at a time, as its tests share what takes long to make."""

        def _split_scope(self, nodeid: str) -> str:
            file = file_of(nodeid)
            return nodeid if file.endswith(APART) else file

    config.option.loadscopereorder = False  # they are in order
    return ByFile(config, log)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The longest files come first, and new ones, so that all processes end together."""
    if hasattr(config, "workerinput"):
        seconds = kept_durations()
        items.sort(key=lambda item: -seconds.get(file_of(item.nodeid), math.inf))


def pytest_collection_finish() -> None:
    """What is there now stays: the garbage collector need not look through it again and again."""
    gc.freeze()


class Durations:
    """Writes down how long the tests of each file took; files that did not run keep theirs."""

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
    """The s that the tests of each file took."""
    lines = DURATIONS.read_text(encoding="utf-8").splitlines()
    return {file: float(number) for number, file in map(str.split, lines)}


def file_of(nodeid: str) -> str:
    return nodeid.partition("::")[0]


# Alike for every caller


@pytest.fixture(scope="session", autouse=True)
def _whoever_calls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Neither the caller's variables and files nor the signals that it ignores reach a test.

    `nohup` ignores SIGHUP and a script's background job SIGINT, and processes inherit that.
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
            # The tests go on under nohup; what they start begins with the default.
            is_ctrl_c = number == signal.SIGINT
            signal.signal(number, signal.default_int_handler if is_ctrl_c else lambda *_: None)
        yield
        for number, handler in ignored.items():
            signal.signal(number, handler)


@pytest.fixture(scope="session")
def endurance(request: pytest.FixtureRequest) -> bool:
    """Whether a test is to run in full: `pytest --all -m endurance`; else in a short form."""
    return "endurance" in str(request.config.getoption("markexpr"))


@pytest.fixture
def agreements(request: pytest.FixtureRequest, endurance: bool) -> Agreements:
    """The agreements of the test's file."""
    return Agreements(FOLDER / f"{request.path.stem}.txt", anew=endurance)


@pytest.fixture(scope="module")
def new_process_server() -> None:
    """Lets the next process start a server of its own, which loads what its simulator asks for."""
    if sys.platform == "linux":
        from multiprocessing import forkserver

        forkserver._forkserver._stop()  # type: ignore[attr-defined]
