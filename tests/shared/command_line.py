"""Fixtures that run command lines, and campaigns for them."""

from __future__ import annotations

import json
import logging
import os
import pkgutil
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

import pytest
from user_modules import own_modules

from frenetic.cli import main


@dataclass(frozen=True)
class Answer:
    """Exit code and output of a command line."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    def refuses(self, *words: str) -> bool:
        """Return whether the command refused: exit code 2, one line on stderr with these words."""
        lines = [line for line in self.err.splitlines() if line.startswith("frenetic: ")]
        return (
            (self.code, self.out, len(lines)) == (2, "", 1)
            and "Traceback" not in self.err
            and all(word in lines[0] for word in words)
        )


Frenetic = Callable[..., Answer]

DRAWINGS = (
    "frenetic.report.picture.draw_drive",
    "frenetic.report.picture.draw_gallery",
)
"""Functions that draw pictures into files."""


STOPPING = """
import os
import signal
from pathlib import Path

from frenetic import Planner


class Stopping(Planner):
    drives = 0

    def reset(self, setup):
        Stopping.drives += 1
        if Path({file!r}).read_text() == str(Stopping.drives):
            os.kill({pid}, signal.SIGINT)  # its own process does not hear Ctrl-C
        super().reset(setup)

    def act(self, observation):
        return super().act(observation)
"""


@contextmanager
def empty_pictures(*drawn: str) -> Iterator[None]:
    """Draw only the pictures of these names, and leave the others empty: this saves time."""

    def leave_empty(draw: Callable[..., None], *arguments: Any, **options: Any) -> None:
        path = next(value for value in arguments if isinstance(value, Path))
        draw(*arguments, **options) if path.name in drawn else path.touch()

    with pytest.MonkeyPatch.context() as patch:
        for name in DRAWINGS:
            patch.setattr(name, partial(leave_empty, pkgutil.resolve_name(name)))
        yield


@contextmanager
def unchanged_logging() -> Iterator[None]:
    """Undo what `frenetic --debug` changes in Python's logging."""
    root, library = logging.getLogger(), logging.getLogger("frenetic")
    handlers, levels = root.handlers[:], (root.level, library.level)
    try:
        yield
    finally:
        root.handlers[:] = handlers
        root.setLevel(levels[0])
        library.setLevel(levels[1])


@pytest.fixture
def drawn() -> None:
    """Lets `frenetic` draw pictures; without this fixture they are empty files."""


@pytest.fixture
def frenetic(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
) -> Frenetic:
    """Runs a command line in an empty folder."""
    monkeypatch.chdir(tmp_path)
    pictures = nullcontext if "drawn" in request.fixturenames else empty_pictures

    def call(*arguments: str) -> Answer:
        capsys.readouterr()
        with pictures(), own_modules(), unchanged_logging(), pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return Answer(stop.value.code, captured.out, captured.err)

    return call


@pytest.fixture
def stopping_driver(tmp_path: Path) -> Callable[[int], str]:
    """Makes a driver that presses Ctrl-C in the drive with a number; 0 means in no drive."""
    file = tmp_path / "stop"
    code = STOPPING.format(file=str(file), pid=os.getpid())

    def driver(stop: int) -> str:
        file.write_text(str(stop))
        Path("stopping.py").write_text(code)
        return "stopping.py:Stopping"

    return driver


@pytest.fixture(scope="session")
def prepare() -> Callable[..., None]:
    """Runs a command line that has to succeed, for fixtures that several tests share."""

    def call(*arguments: str) -> None:
        quiet = redirect_stdout(StringIO())
        with empty_pictures(), quiet, own_modules(), pytest.raises(SystemExit) as stop:
            main(list(arguments))
        assert stop.value.code == 0

    return call


@pytest.fixture(scope="session")
def searched(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign with a few failures; no test changes it."""
    folder = tmp_path_factory.mktemp("searched") / "c"
    search = ("run", "--simulations", "60", "--seed", "3", "--workers", "1", "--with", "delay=0.05")
    prepare(*search, "--out", str(folder))
    return folder


@pytest.fixture
def copied(searched: Path, tmp_path: Path) -> str:
    """A copy of the campaign `searched` in the folder of the command line."""
    shutil.copytree(searched, tmp_path / "c", ignore=shutil.ignore_patterns("failures"))
    return "c"
