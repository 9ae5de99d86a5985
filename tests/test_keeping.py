"""`keeps_lane` as its users run it: pytest in a process of its own, on the planted drivers."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

import planted_drivers as planted
import pytest

from frenetic.drivers import Planner
from frenetic.errors import DriverError, FreneticError
from frenetic.testing import keeps_lane
from frenetic.testing.keeping import FOLDER, NOTICES, DriverFailedError

if TYPE_CHECKING:
    from interpreters import Ended, Interpreter

pytest_plugins = ["interpreters"]

PLANTED = {
    "BrakesLate": "brakes too late into",
    "Raises": "raises ValueError",
    "Unrepeatable": "",
    "Sound": None,
}
"""One of each kind; what each fault is called is the fact of test_planted.py."""
HEAD = "import planted_drivers as planted\nimport pytest\nfrom frenetic.testing import keeps_lane\n"


def run_pytest(interpreter: Interpreter, folder: Path, text: str, *options: str) -> Ended:
    (folder / "test_lane.py").write_text(HEAD + text, encoding="utf-8")
    shared = str(Path(planted.__file__).parent)
    code = f"""
import os, sys
os.environ.update(PYTHONPATH={shared!r}, PYTEST_ADDOPTS="")
sys.path.insert(0, {shared!r})
import pytest
raise SystemExit(pytest.main({["-p", "no:cacheprovider", *options]}))
"""
    return interpreter.python(code, folder=folder)


def told_of(driver: str, folder: Path, **options: int) -> str:
    """What the test of a driver says, run here; empty if it passes."""

    @keeps_lane(**({"simulations": 150} | options))  # type: ignore[arg-type]
    def test() -> object:
        return getattr(planted, driver)()

    place = folder / "test_here.py"
    place.write_text("")
    test.__wrapped__.__code__ = test.__wrapped__.__code__.replace(co_filename=str(place))  # type: ignore[attr-defined]
    try:
        test()
    except DriverFailedError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("driver", PLANTED)
def test_each_planted_fault_fails_with_its_cause(driver: str, tmp_path: Path) -> None:
    told, cause = told_of(driver, tmp_path), PLANTED[driver]
    if cause is None:
        assert told == ""
        assert not (tmp_path / FOLDER).exists()
        return
    first = next(line for line in told.splitlines() if line.startswith("The driver "))
    assert cause in first
    files = sorted((tmp_path / FOLDER).glob("*.json"))
    assert files
    for file in files:
        assert str(file) in told
        assert file.with_suffix(".png").is_file()
        assert file.stat().st_size < 2000
        assert json.loads(file.read_text(encoding="utf-8"))["curvatures"]
    if driver == "Unrepeatable":
        assert "\nNote: " in told
        return
    again = told_of(driver, tmp_path, simulations=1)
    assert "on which it failed before" in again, "what is remembered is driven first"
    assert cause.partition(" in")[0] in again
    assert sorted((tmp_path / FOLDER).glob("*.json")) == files


def test_the_same_seed_says_the_same_and_a_mended_driver_passes(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    one, other = (told_of("TooFast", tmp_path / name) for name in "ab")
    assert one.replace(str(tmp_path / "a"), "") == other.replace(str(tmp_path / "b"), "")
    assert told_of("Sound", tmp_path / "a", simulations=5) == ""


def test_time_ends_a_search_with_a_notice(tmp_path: Path) -> None:
    NOTICES.clear()

    @keeps_lane(simulations=10_000, seconds=1e-3)
    def test() -> object:
        return planted.Sound()

    test()
    (notice,) = NOTICES
    assert "stopped after 0.001 s and" in notice
    assert "of 10000 simulations" in notice
    NOTICES.clear()


def test_fixtures_parameters_marks_and_workers(interpreter: Interpreter, tmp_path: Path) -> None:
    text = """
@pytest.fixture
def aggression():
    return 1.0

@pytest.mark.parametrize("name", ["Sound", "WrongSign"])
@keeps_lane(simulations=20)
def test_it(name, aggression):
    assert aggression == 1.0
    return getattr(planted, name)()

@keeps_lane(simulations=5000, seconds=0.001)
def test_slow():
    return planted.Sound()

def test_other():
    pass
"""
    done = run_pytest(
        interpreter, tmp_path, text, "-n", "2", "-m", "keeps_lane", "--junitxml", "r.xml"
    )
    assert done.code == 1, done.stdout
    assert "1 failed, 2 passed" in done.stdout
    assert "The driver steers the wrong way" in done.stdout
    assert "Traceback" not in done.stdout
    assert "keeping.py" not in done.stdout, "the message alone"
    assert "test_slow: stopped after 0.001 s" in done.stdout
    assert "PytestUnknownMarkWarning" not in done.stdout
    found = {case.get("name"): case for case in ET.parse(tmp_path / "r.xml").iter("testcase")}
    failure = found["test_it[WrongSign]"].find("failure")
    assert failure is not None
    assert "road      failing-roads" in (failure.text or "")
    assert [one.get("name") for one in found["test_slow"].iter("property")] == ["frenetic"]
    (file,) = (tmp_path / FOLDER).glob("*.json")
    line = next(line for line in done.stdout.splitlines() if line.startswith("Drive them again: "))
    assert line == 'Drive them again: pytest "test_lane.py::test_it[WrongSign]"'
    again = run_pytest(interpreter, tmp_path, text, "test_lane.py::test_it[WrongSign]")
    assert "on which it failed before" in again.stdout
    file.write_text("{", encoding="utf-8")
    damaged = run_pytest(interpreter, tmp_path, text, "test_lane.py::test_it[WrongSign]")
    assert damaged.code == 1
    assert file.name in damaged.stdout
    assert "keeping.py" not in damaged.stdout
    assert "plugin.py" not in damaged.stdout


def test_criteria_of_a_class_of_roads(interpreter: Interpreter, tmp_path: Path) -> None:
    text = """
from frenetic import Planner

@keeps_lane(roads="rural-80,length=600", criteria="after-iso-11270,lateral_acceleration=0.5",
            simulations=6)
def test_it():
    return Planner()
"""
    done = run_pytest(interpreter, tmp_path, text)
    assert "The driver exceeds the limit of lateral acceleration" in done.stdout
    assert "criteria: after-iso-11270" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"roads": "rural-800"}, "there is no road class 'rural-800'"),
        ({"criteria": "iso"}, "there are no criteria 'iso'"),
        ({"simulations": 0}, "simulations is 0"),
        ({"seconds": 0.0}, "seconds is 0.0"),
        ({"speed_limit": "a"}, "speed_limit is 'a': a number"),
        ({"criteria": 3}, "criteria is 3: "),
        ({"conditions": ["delay"]}, r"conditions is \['delay'\]: names with values"),
        ({"conditions": {"delay": "a"}}, "conditions is {'delay': 'a'}: "),
    ],
)
def test_mistakes_are_named_where_the_test_is_declared(
    arguments: dict[str, object], words: str
) -> None:
    with pytest.raises((FreneticError, ValueError), match=words):
        keeps_lane(**arguments)  # type: ignore[arg-type]


def test_what_is_no_driver_is_refused() -> None:
    @keeps_lane()
    def kind() -> object:
        return Planner

    @keeps_lane()
    def nothing() -> None:
        pass

    with pytest.raises(DriverError, match=r"kind returned <class .*Planner'>: a driver"):
        kind()
    with pytest.raises(DriverError, match="nothing returned None: a driver"):
        nothing()
    with pytest.raises(TypeError, match=r"with parentheses: @keeps_lane\(\)"):
        keeps_lane(nothing)  # type: ignore[arg-type]


def test_tests_of_two_classes_remember_roads_apart(
    interpreter: Interpreter, tmp_path: Path
) -> None:
    test = "    @keeps_lane(simulations=60)\n    def test_it(self): return planted.WrongSign()\n"
    run_pytest(interpreter, tmp_path, f"class TestFast:\n{test}\nclass TestOther:\n{test}")
    stems = {path.stem[:-9] for path in (tmp_path / FOLDER).glob("*.json")}
    assert stems == {"test_lane-TestFast-test_it", "test_lane-TestOther-test_it"}
