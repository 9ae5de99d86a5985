"""The core without its plug-ins, and with a third party's package."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PLUGINS = (
    *("beamng", "bench", "commonroad", "competition", "dask", "fmu", "gym", "metadrive"),
    *("third_party", "twin", "vision"),
)
STRANGER = Path(__file__).parents[1] / "stranger"

WITHOUT = """
import sys

class Gone:
    def find_spec(self, name, path=None, target=None):
        if f"{{name}}.".startswith(tuple(f"{{plugin}}." for plugin in {gone!r})):
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Gone())
from frenetic._support import entry_points
installed = entry_points._installed

def others(*key):
    return tuple(entry for entry in installed(*key) if not entry.target.startswith({gone!r}))

entry_points._installed = others
from frenetic.cli import main
for line in {lines!r}:
    try:
        main(line.split(" "))
    except SystemExit as end:
        assert not end.code, line
"""
HELP = ("--help", "run --help", "list")
LINES = (
    "run --simulations 12 --seed 7 --workers 1 --out first",
    "show first",
    "check first",
    "rerun first --top 1 --workers 1",
    "minimise first --max-drives 30",
    *HELP,
)


@pytest.mark.parametrize(
    "gone",
    [PLUGINS, *(pytest.param((plugin,), marks=pytest.mark.heavy) for plugin in PLUGINS)],
    ids="-".join,
)
def test_the_core_works_without_a_plug_in(gone: tuple[str, ...], tmp_path: Path) -> None:
    """Without any plug-in, campaigns run; without a single plug-in, all imports succeed."""
    names, lines = (
        tuple(f"frenetic.plugins.{name}" for name in gone),
        LINES if gone is PLUGINS else HELP,
    )
    code = WITHOUT.format(gone=names, lines=lines)
    command = [sys.executable, "-c", code]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    assert (tmp_path / "first" / "report.html").is_file() is (gone is PLUGINS)


def wheel_of(package: Path, folder: Path) -> Path:
    """Write a wheel of a package of Python files and its ``entry_points.txt``; return its path."""
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
    """Folder in which pip installed the third party's package."""
    folder = tmp_path_factory.mktemp("stranger")
    wheel = wheel_of(STRANGER, folder)
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index"]
    subprocess.run([*pip, "--target", str(folder / "site"), str(wheel)], check=True)
    return folder / "site"


COMMANDS = """
from frenetic.cli import main

for line in {lines!r}:
    try:
        main(line.split(" "))
    except SystemExit as end:
        assert not end.code, line
    print("-" * 20, flush=True)
"""


@pytest.mark.heavy
def test_a_third_partys_parts_work_like_built_in_parts(installed: Path, tmp_path: Path) -> None:
    parts = "--driver hasty,speed=60 --strategy zigzag --simulator rails --with wind=0.2"
    search = f"run {parts} --simulations 6 --seed 1 --workers 2 --out night"
    rerun = "rerun night --all --workers 1 --json"
    varied, calm = f"{rerun} --vary wind=0.1:0.3 --times 2", f"{rerun} --with wind=0"
    lines = ("list", search, "--help", "count night", varied, calm)
    process = subprocess.run(
        [sys.executable, "-c", COMMANDS.format(lines=lines)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(installed)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    listed, _, helped, counted, *reruns, _ = process.stdout.split(f"{'-' * 20}\n")
    for words in (["hasty", "lane-lab"], ["zigzag", "lane-lab"], ["rails", "lane-lab"], ["wind"]):
        assert any(line.split()[: len(words)] == words for line in listed.splitlines()), words
    report = (tmp_path / "night" / "report.html").read_text("utf-8")
    assert "on which hasty,speed=60 leaves its lane" in report
    assert ">wind 0.2" in report
    assert "lane-lab counts" in helped
    assert counted == "6 tests\n"
    varied, calm = map(json.loads, reruns)
    assert "Hasty" in varied["driver"]["class"]
    assert varied["driver"] == calm["driver"]
    drives = [drive for test in varied["tests"] for drive in test["drives"]]
    assert [0.1 <= drive["conditions"]["wind"] <= 0.3 for drive in drives] == [True] * 12
