"""How the folder `0.1.0` beside this was made: campaigns and a bench of version 0.1.0.

It runs with that version only (commit 92f9f4351745ab94a4c406b6dcd9504033bdb365, the last one
before campaigns got their present form), installed into a virtual environment of its own:

    git worktree add /tmp/old 92f9f4351745ab94a4c406b6dcd9504033bdb365
    python3 -m venv /tmp/old-env && /tmp/old-env/bin/pip install /tmp/old
    /tmp/old-env/bin/python tests/compatibility/make_fixtures.py a-new-folder

Do not make these fixtures anew with a newer version: that they are old is what they are for. When
a later version changes what is on disk, give that version a folder and a script of its own.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from importlib.metadata import version
from pathlib import Path
from typing import Any

FROM_PYTHON = """
from frenetic import Budget, Campaign, EmbeddedSimulator, Planner
from frenetic.search import RandomSearch

Campaign(
    strategy=RandomSearch(seed=5), simulator=EmbeddedSimulator(), driver=Planner(aggression=1.2),
    budget=Budget(simulations=15), folder="from-python",
).run()
"""

# Kills itself at the beginning of its 31st drive.
KILLED = """
import os, signal, sys
from frenetic.cli import main
from frenetic.simulators import EmbeddedSimulator

drives = 0
drive = EmbeddedSimulator.drive

def counted(self, *arguments, **options):
    global drives
    drives += 1
    if drives == 31:
        os.kill(os.getpid(), signal.SIGKILL)
    return drive(self, *arguments, **options)

EmbeddedSimulator.drive = counted
main(sys.argv[1:])
"""


def old(module: str) -> Any:
    """A module of the old version, which need not be there any more."""
    return importlib.import_module(f"frenetic.{module}")


def frenetic(*arguments: str) -> str:
    return python("-m", "frenetic", *arguments)


def python(*arguments: str, code: int = 0) -> str:
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    return done.stdout


def make_commanded() -> None:
    """With every side file, and options that are not the usual ones."""
    frenetic(
        *("run", "--simulations", "40", "--seed", "3", "--workers", "1", "--out", "commanded"),
        *("--strategy-option", "random_budget=0.4", "--driver-option", "aggression=1.1"),
        *("--delay", "0.05", "--noise", "0.05", "--simulator-option", "friction=0.95"),
    )
    frenetic(
        *("rerun", "commanded", "--top", "3", "--times", "3"),
        *("--vary", "friction=0.8:1.0", "noise=0.2"),
    )
    frenetic("rerun", "commanded", "--top", "1", "--times", "4", "--delay", "0")
    frenetic("confirm", "commanded", "--top", "3", "--simulator-option", "friction=0.9")
    frenetic("minimise", "commanded", "--max-drives", "60")


def make_interrupted() -> None:
    """One that was killed, and what its twin, which was not, has found."""
    run = ("run", "--simulations", "80", "--seed", "11", "--workers", "1", "--delay", "0.05")
    python("-c", KILLED, *run, "--out", "interrupted", code=-9)
    frenetic(*run, "--out", "twin")
    Path("twin.json").write_text(json.dumps(table(Path("twin")), indent=0), encoding="utf-8")
    shutil.rmtree("twin")


def make_bench() -> None:
    """One run of which is not there yet, and one that was killed."""
    frenetic(
        *("bench", "--simulations", "12", "--repeats", "2", "--records", "none", "--workers", "1"),
        *("--strategy", "random", "--strategy", "frenetic", "--option", "random_budget=0.5"),
        *("--name", "evolved", "--delay", "0.05", "--out", "bench"),
    )
    runs = json.loads(frenetic("bench", "--out", "bench", "--list", "--json"))
    for run in runs:
        run["tests"] = table(Path(run["folder"]))
    Path("bench-runs.json").write_text(json.dumps(runs, indent=0), encoding="utf-8")
    shutil.rmtree("bench/evolved/02")
    shutil.rmtree("bench/random/02/competition")
    with closing(sqlite3.connect("bench/random/02/campaign.sqlite")) as database, database:
        database.execute("DELETE FROM campaign WHERE key IN ('finished_at', 'bench')")
        database.execute("DELETE FROM trajectory WHERE candidate_id > 5")
        database.execute("DELETE FROM test WHERE candidate_id > 5")


def make_schema(number: int) -> None:
    """The campaign from Python as a version of the database before has it."""
    store = old("campaign.store")
    folder = Path(f"schema-{number}")
    folder.mkdir()
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as database, database:
        for statements in store.MIGRATIONS[:number]:
            for statement in statements:
                database.execute(statement)
        database.execute(f"PRAGMA application_id = {store.APPLICATION_ID}")
        database.execute(f"PRAGMA user_version = {number}")
        database.commit()
        database.execute("ATTACH 'from-python/campaign.sqlite' AS newer")
        for name in ("campaign", "candidate", "test", "trajectory"):
            columns = ", ".join(
                row[1] for row in database.execute(f"PRAGMA main.table_info({name})")
            )
            database.execute(
                f"INSERT INTO main.{name} ({columns}) SELECT {columns} FROM newer.{name}"
            )


def table(folder: Path) -> list[Any]:
    """What a campaign found, a row per test."""
    with closing(sqlite3.connect(folder / "campaign.sqlite")) as database:
        return database.execute(
            "SELECT id, operator, parents, generation, outcome, moobd"
            " FROM test JOIN candidate ON id = candidate_id ORDER BY told"
        ).fetchall()


def expected(name: str) -> dict[str, Any]:
    """What this version says of a campaign."""
    shown = json.loads(frenetic("show", name, "--json"))
    tests = table(Path(name))
    failures = [row[0] for row in tests if row[4] == "FAIL"][:1]
    return {
        "show": shown,
        "tests": tests,
        "one": [json.loads(frenetic("show", name, str(one), "--json")) for one in failures],
    }


def expected_of_side_files() -> dict[str, Any]:
    read_reruns = old("analysis").read_reruns
    read_confirmations = old("analysis.confirming").read_confirmations
    folder = Path("commanded")
    return {
        "reruns": [
            {
                "test": one.test_id,
                "seed": one.seed,
                "variations": [[v.quantity, v.low, v.high] for v in one.variations],
                "failed": one.failed,
                "judged": one.judged,
                "alike": one.alike,
                "interval": one.interval,
                "stability": one.stability,
                "driver": one.driver,
                "simulator": one.simulator,
                "drives": [[drive.outcome, drive.moobd] for drive in one.drives],
            }
            for one in read_reruns(folder)
        ],
        "confirmations": [
            {
                "key": one.key,
                "driver": one.driver,
                "simulator": one.simulator,
                "missing": one.missing,
                "alike": one.alike,
                "tests": [
                    [
                        test.test_id,
                        test.agreement,
                        test.is_alike,
                        test.reason,
                        test.other.moobd,
                        len(one.drive(test).trajectory.time),
                    ]
                    for test in one.tests
                ],
            }
            for one in read_confirmations(folder)
        ],
    }


def make_small() -> None:
    """Leaves what is read again; pictures and reports can be made again."""
    for path in list(Path().rglob("*")):
        is_remade = path.suffix in (".png", ".html", ".csv", ".md", ".lock")
        if is_remade and path.parts[1] != "confirmed":
            path.unlink()
    for path in Path("commanded/confirmed").rglob("test-*.png"):
        path.unlink()
    for folder in ("failures", "competition"):
        for path in list(Path().rglob(folder)):
            shutil.rmtree(path)
    for path in list(Path().rglob("campaign.sqlite")):
        with closing(sqlite3.connect(path)) as database:
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.execute("PRAGMA journal_mode = DELETE")
            database.execute("VACUUM")
    for path in list(Path().rglob("*"))[::-1]:
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def make(folder: Path) -> None:
    assert version("frenetic-roads") == "0.1.0", "this needs version 0.1.0"
    folder.mkdir()
    os.chdir(folder)
    make_commanded()
    python("-c", FROM_PYTHON)
    make_interrupted()
    make_bench()
    for number in (1, 2):
        make_schema(number)
    known = {name: expected(name) for name in ("commanded", "from-python")}
    known["commanded"] |= expected_of_side_files()
    text = json.dumps(known, indent=0)
    make_small()
    Path("expected.json").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    make(Path(sys.argv[1]))
