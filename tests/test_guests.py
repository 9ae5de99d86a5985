"""The core without its guests, and a stranger's package beside it."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

GUESTS = ("beamng", "bench", "metadrive", "twin", "vision")
STRANGER = Path(__file__).parent / "stranger"

WITHOUT = """
import sys

class Gone:
    def find_spec(self, name, path=None, target=None):
        if name == {guest!r} or name.startswith({guest!r} + "."):
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Gone())
from frenetic._support import entry_points
found = entry_points._installed

def others(*key):
    return tuple(entry for entry in found(*key) if not entry.target.startswith({guest!r}))

entry_points._installed = others
from frenetic.cli import main
for line in {lines!r}:
    try:
        main(line.split(" "))
    except SystemExit as end:
        assert not end.code, line
"""
LINES = (
    "run --simulations 12 --seed 7 --workers 1 --out first",
    "show first",
    "check first",
    "rerun first --top 1 --workers 1",
    "minimise first --max-drives 30",
    "--help",
    "run --help",
    "list",
)


@pytest.mark.parametrize("guest", GUESTS)
def test_the_core_works_without_a_guest(guest: str, tmp_path: Path) -> None:
    code = WITHOUT.format(guest=f"frenetic.{guest}", lines=LINES)
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "first" / "report.html").is_file()


def wheel_of(package: Path, folder: Path) -> Path:
    """A wheel of a package of Python files and its ``entry_points.txt``."""
    wheel = folder / "lane_lab-1.0-py3-none-any.whl"
    info = "lane_lab-1.0.dist-info"
    with zipfile.ZipFile(wheel, "w") as archive:
        for file in sorted((package / "lane_lab").glob("*.py")):
            archive.write(file, f"lane_lab/{file.name}")
        archive.write(package / "entry_points.txt", f"{info}/entry_points.txt")
        archive.writestr(
            f"{info}/METADATA", "Metadata-Version: 2.1\nName: lane-lab\nVersion: 1.0\n"
        )
        archive.writestr(
            f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
        )
        archive.writestr(f"{info}/RECORD", "")
    return wheel


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder into which pip has installed the stranger's package."""
    folder = tmp_path_factory.mktemp("stranger")
    wheel = wheel_of(STRANGER, folder)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(wheel)], check=True)
    return folder / "site"


def run_beside(site: Path, folder: Path, *arguments: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "frenetic", *arguments]
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_strangers_parts_work_like_the_built_in_ones(installed: Path, tmp_path: Path) -> None:
    listed = run_beside(installed, tmp_path, "list")
    for words in (["hasty", "lane-lab"], ["zigzag", "lane-lab"], ["rails", "lane-lab"], ["wind"]):
        assert any(line.split()[: len(words)] == words for line in listed.splitlines()), words
    parts = "--driver hasty,speed=60 --strategy zigzag --simulator rails --with wind=0.2"
    search = f"run {parts} --simulations 6 --seed 1 --workers 2 --out night"
    run_beside(installed, tmp_path, *search.split(" "))
    shown = run_beside(installed, tmp_path, "show", "night")
    assert "hasty with wind 0.2" in (tmp_path / "night" / "report.html").read_text("utf-8")
    assert "6" in shown
    assert "lane-lab counts" in run_beside(installed, tmp_path, "--help")
    assert run_beside(installed, tmp_path, "count", "night") == "6 tests\n"
