"""`keeps_lane` as users run it: with pytest in another process, on the planted drivers."""

from __future__ import annotations

import fnmatch
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import planted_drivers as planted
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic.drivers import Planner
from frenetic.errors import DriverError, FreneticError
from frenetic.testing import keeps_lane, steers_well
from frenetic.testing.lane_test import FOLDER, NOTICES, DriverFailedError, memory_stem

if TYPE_CHECKING:
    from interpreters import Ended, Interpreter

pytest_plugins = ["interpreters"]

PLANTED = {
    "BrakesLate": "brakes too late into",
    "Raises": "raises ValueError",
    "Unrepeatable": "",
    "Sound": None,
}
"""Driver -> cause in its report; tests/test_planted.py covers all causes."""
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


def report_of(driver: str, folder: Path, **options: int) -> str:
    """Run the test of a driver in this process; return its report, empty if it passes."""
    decorate: Any = keeps_lane(**({"simulations": 150} | options))  # type: ignore[arg-type]
    return report(decorate, getattr(planted, driver), folder)


def report(decorate: Any, make_driver: Callable[[], object], folder: Path) -> str:
    """Run a decorated test in this process; return its report, empty if it passes."""

    @decorate
    def test() -> object:
        return make_driver()

    place = folder / "test_here.py"
    place.write_text("")
    test.__wrapped__.__code__ = test.__wrapped__.__code__.replace(co_filename=str(place))
    try:
        test()
    except DriverFailedError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    "driver",
    [
        pytest.param("BrakesLate", marks=pytest.mark.heavy),
        "Raises",
        pytest.param("Unrepeatable", marks=pytest.mark.heavy),
        "Sound",
    ],
)
def test_each_planted_fault_fails_with_its_cause(driver: str, tmp_path: Path) -> None:
    report, cause = report_of(driver, tmp_path), PLANTED[driver]
    if cause is None:
        assert report == ""
        assert not (tmp_path / FOLDER).exists()
        return
    first = next(line for line in report.splitlines() if line.startswith("The driver "))
    assert cause in first
    files = sorted((tmp_path / FOLDER).glob("*.json"))
    assert files
    for file in files:
        assert str(file) in report
        assert file.with_suffix(".png").is_file()
        assert file.stat().st_size < 2000
        assert json.loads(file.read_text(encoding="utf-8"))["curvatures"]
    if driver == "Unrepeatable":
        assert "\nNote: " in report
        return
    second = report_of(driver, tmp_path, simulations=1)
    assert "on which it failed before" in second, "remembered roads are driven first"
    assert cause.partition(" in")[0] in second
    assert sorted((tmp_path / FOLDER).glob("*.json")) == files


@pytest.mark.heavy
def test_the_same_seed_gives_the_same_report_and_a_mended_driver_passes(tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    first, second = (report_of("TooFast", tmp_path / name) for name in "ab")
    assert first.replace(str(tmp_path / "a"), "") == second.replace(str(tmp_path / "b"), "")
    assert report_of("Sound", tmp_path / "a", simulations=5) == ""


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


@pytest.mark.heavy
def test_fixtures_parameters_marks_and_workers_work(
    interpreter: Interpreter, tmp_path: Path
) -> None:
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
    result = run_pytest(
        interpreter, tmp_path, text, "-n", "2", "-m", "keeps_lane", "--junitxml", "r.xml"
    )
    assert result.code == 1, result.stdout
    assert "1 failed, 2 passed" in result.stdout
    assert "The driver steers the wrong way" in result.stdout
    assert "Traceback" not in result.stdout
    assert "lane_test.py" not in result.stdout, "the report has no traceback"
    assert "test_slow: stopped after 0.001 s" in result.stdout
    assert "PytestUnknownMarkWarning" not in result.stdout
    cases = {case.get("name"): case for case in ET.parse(tmp_path / "r.xml").iter("testcase")}
    failure = cases["test_it[WrongSign]"].find("failure")
    assert failure is not None
    assert "road      failing-roads" in (failure.text or "")
    assert [entry.get("name") for entry in cases["test_slow"].iter("property")] == ["frenetic"]
    file, *_ = sorted((tmp_path / FOLDER).glob("*.json"))
    line = next(
        line for line in result.stdout.splitlines() if line.startswith("Drive them again: ")
    )
    assert line == 'Drive them again: pytest "test_lane.py::test_it[WrongSign]"'
    second = run_pytest(interpreter, tmp_path, text, "test_lane.py::test_it[WrongSign]")
    assert "on which it failed before" in second.stdout
    file.write_text("{", encoding="utf-8")
    damaged = run_pytest(interpreter, tmp_path, text, "test_lane.py::test_it[WrongSign]")
    assert damaged.code == 1
    assert file.name in damaged.stdout
    assert "lane_test.py" not in damaged.stdout
    assert "plugin.py" not in damaged.stdout


@pytest.mark.heavy
def test_criteria_and_a_road_class_apply(interpreter: Interpreter, tmp_path: Path) -> None:
    text = """
from frenetic import Planner

@keeps_lane(roads="rural-80,length=600", criteria="after-iso-11270,lateral_acceleration=0.5",
            simulations=6)
def test_it():
    return Planner()
"""
    result = run_pytest(interpreter, tmp_path, text)
    assert "The driver exceeds the limit of lateral acceleration" in result.stdout
    assert "criteria: after-iso-11270" in result.stdout


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
def test_mistakes_are_reported_at_the_declaration(arguments: dict[str, object], words: str) -> None:
    with pytest.raises((FreneticError, ValueError), match=words):
        keeps_lane(**arguments)  # type: ignore[arg-type]


def test_a_test_that_returns_no_driver_is_refused() -> None:
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


CAREFUL: Final = partial(Planner, lateral_acceleration=3.0, braking=2.0)
"""A compiled driver that passes random roads."""


def test_a_margin_that_is_too_small_fails_the_test(tmp_path: Path) -> None:
    decorate = partial(keeps_lane, simulations=3, roads="urban-50,length=100")
    passes = decorate(margin={"delay": 0.02, "friction": 0.9})
    assert report(passes, CAREFUL, tmp_path) == ""
    text = report(decorate(margin={"delay": 0.9}), CAREFUL, tmp_path)
    title, _, first, second, *_ = text.splitlines()
    assert title == "1 margin too small; roads: urban-50, 50 km/h; criteria: competition"
    assert re.fullmatch(r"delay: begins to fail at 0\.\d+ s, 0\.9 s is needed", first)
    assert re.fullmatch(r"  \d+ of 80 random roads fail up to 0\.9 s", second)
    assert "Drive them again: pytest" in text
    assert not (tmp_path / FOLDER).exists()


def test_a_driver_that_steers_badly_fails_on_roads_that_are_remembered(tmp_path: Path) -> None:
    decorate = partial(steers_well, roads="rural-80,length=300", simulations=8)
    assert report(decorate(offset=1.5, jerk=9.0), CAREFUL, tmp_path) == ""
    text = report(decorate(offset=0.05, jerk=9.0), CAREFUL, tmp_path)
    title = "5 failures in 8 simulations; roads: rural-80, 80 km/h; criteria: competition: lateral"
    assert text.startswith(f"{title} offset at most 0.05 m, lateral jerk at most 9 m/s³")
    assert "The driver exceeds the limit of lateral offset" in text
    assert sorted((tmp_path / FOLDER).glob("*.json"))
    again = report(decorate(offset=0.05, simulations=1), CAREFUL, tmp_path)
    assert "on which it failed before" in again
    assert report(decorate(offset=1.5, simulations=1), CAREFUL, tmp_path) == ""
    jerky = report(decorate(criteria={"lateral_jerk": 9.0}, jerk=0.1), CAREFUL, tmp_path)
    assert "lateral jerk" in jerky, "the argument wins"


@pytest.mark.parametrize(
    ("decorator", "arguments", "words"),
    [
        (keeps_lane, {"margin": {"delya": 0.1}}, "unknown condition 'delya'; did you mean 'delay'"),
        (keeps_lane, {"margin": {"delay": 11.0}}, "delay is 11: 0 to 10 s is needed"),
        (steers_well, {}, "steers_well has no limit"),
        (steers_well, {"offset": -0.1}, "lateral_offset is -0.1: at least 0"),
        (steers_well, {"offset": 0.1, "simulations": 0}, "simulations is 0"),
        (steers_well, {"criteria": "iso"}, "there are no criteria 'iso'"),
    ],
)
def test_mistakes_about_limits_are_reported_at_the_declaration(
    decorator: Any, arguments: dict[str, object], words: str
) -> None:
    with pytest.raises((FreneticError, ValueError), match=words):
        decorator(**arguments)


@pytest.mark.heavy
def test_both_marks_are_known_and_their_failures_have_no_traceback(
    interpreter: Interpreter, tmp_path: Path
) -> None:
    text = """
from frenetic.testing import steers_well

@steers_well(offset=0.05, simulations=4)
def test_well():
    return planted.Sound()

@keeps_lane(simulations=2, margin={"delay": 0.9})
def test_margin():
    return planted.Sound()
"""
    result = run_pytest(interpreter, tmp_path, text, "-m", "steers_well or keeps_lane")
    assert "2 failed" in result.stdout
    assert "The driver exceeds the limit of lateral offset" in result.stdout
    assert "delay: begins to fail at" in result.stdout
    assert "Traceback" not in result.stdout
    assert "lane_test.py" not in result.stdout
    assert "PytestUnknownMarkWarning" not in result.stdout


@pytest.mark.heavy
def test_tests_with_similar_ids_remember_their_own_roads(
    interpreter: Interpreter, tmp_path: Path
) -> None:
    text = """
@pytest.mark.parametrize("gain", [1.0, -1.0])
@keeps_lane(simulations=20)
def test_sign(gain):
    return planted.WrongSign() if gain < 0.0 else planted.Sound()

class TestFast:
    @keeps_lane(simulations=20)
    def test_it(self): return planted.WrongSign()

class Testfast:
    @keeps_lane(simulations=20)
    def test_it(self): return planted.Sound()
"""
    first, second = (run_pytest(interpreter, tmp_path, text, "-rfp") for _ in range(2))
    for run in (first, second):
        assert "PASSED test_lane.py::test_sign[1.0]" in run.stdout
        assert "FAILED test_lane.py::test_sign[-1.0]" in run.stdout
        assert "PASSED test_lane.py::Testfast::test_it" in run.stdout
        assert "FAILED test_lane.py::TestFast::test_it" in run.stdout
    stems = {path.stem[:-9] for path in (tmp_path / FOLDER).glob("*.json")}
    ids = ("test_sign[-1.0]", "TestFast::test_it")
    assert stems == {memory_stem("test_lane", f"test_lane.py::{test}") for test in ids}


SIMILAR_IDS: Final = (
    "test_sign[1.0]",
    "test_sign[-1.0]",
    "test_sign[1/0]",
    "test_sign[-1-0]",
    "test_sign",
    "test_Sign",
    "TestSign::test_it",
    "Testsign::test_it",
    "test_sign[a::b]",
    "test_sign[a b]",
    "test_sign-",
    "тест",
    "test_" + "x" * 300,
    "test_" + "x" * 301,
    "test_sign[" + ":" * 300 + "]",
)
"""Ids of tests of the same file."""

MODULES: Final = ("test_lane", "test_Lane", "test_lane-test_sign", "con")


def test_each_id_has_its_own_file_names_on_every_system() -> None:
    stems = {
        memory_stem(module, f"{module}.py::{test}") for module in MODULES for test in SIMILAR_IDS
    }
    folded = {stem.casefold() for stem in stems}
    assert len(folded) == len(MODULES) * len(SIMILAR_IDS)
    for stem in stems:
        assert re.fullmatch(r"[A-Za-z0-9_]+-[A-Za-z0-9_.-]+", stem)
        assert len(f"{stem}-12345678.json") <= 200  # bytes, of 255 that systems allow
        # The pattern of a test's files fits no file of another test.
        files = [f"{stem}-12345678.json" for stem in stems]
        assert fnmatch.filter(files, f"{stem}-????????.json") == [f"{stem}-12345678.json"]


@given(st.text(), st.text())
def test_two_ids_never_share_a_file_name(first: str, second: str) -> None:
    stems = [memory_stem("test_lane", f"test_lane.py::{text}") for text in (first, second)]
    assert (stems[0].casefold() == stems[1].casefold()) is (first == second)


def test_a_plain_id_gives_a_plain_file_name_from_any_folder() -> None:
    for folder in ("", "tests/", "/home/me/tests/"):
        assert memory_stem("bends_test", f"{folder}bends_test.py::test_hasty") == (
            "bends_test-test_hasty"
        )
    assert memory_stem("bends_test", "test_hasty") == "bends_test-test_hasty"
    imported = {memory_stem("shared", f"tests/{name}.py::test_hasty") for name in ("a", "b")}
    assert len(imported) == 2
