"""Running command lines, and campaigns to run them on."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from frenetic.cli import main


@dataclass(frozen=True)
class Answer:
    """What a command line came to."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    def refuses(self, *words: str) -> bool:
        """A mistake: exit code 2, nothing on stdout, one line on stderr with these words."""
        lines = [line for line in self.err.splitlines() if line.startswith("frenetic: ")]
        return (
            (self.code, self.out, len(lines)) == (2, "", 1)
            and "Traceback" not in self.err
            and all(word in lines[0] for word in words)
        )


Frenetic = Callable[..., Answer]


@pytest.fixture
def frenetic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Frenetic:
    """Runs a command line in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Answer:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(list(arguments))
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return Answer(stop.value.code, captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with a few failures; not to be written to."""
    folder = tmp_path_factory.mktemp("searched") / "c"
    search = ("run", "--simulations", "60", "--seed", "3", "--workers", "1", "--json")
    with pytest.raises(SystemExit) as stop:
        main([*search, "--out", str(folder), "--delay", "0.05"])
    assert stop.value.code == 0
    return folder


@pytest.fixture
def campaign(searched: Path, tmp_path: Path) -> str:
    """A copy of it in the folder of the command line."""
    shutil.copytree(searched, tmp_path / "c", ignore=shutil.ignore_patterns("failures"))
    return "c"
