"""`doctor` on simulators that work, that are broken, and that are not installed."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Self

import pytest

from frenetic.drivers import Driver
from frenetic.errors import UnknownNameError
from frenetic.parts.registry import SIMULATORS, Registry
from frenetic.road import Road
from frenetic.simulators import Drive, EmbeddedSimulator, doctor
from frenetic.simulators.checks import SimulatorCheck, drive_checks
from frenetic.simulators.doctor import Examination, Health, examine, examine_all
from frenetic.testing import DummyDriver, DummySimulator


class Crooked(DummySimulator):
    """A simulator whose car leaves every road to the left."""

    def __init__(self) -> None:
        super().__init__(drift=lambda _: 6.0)


class Dead(DummySimulator):
    """A simulator that does not start."""

    def __enter__(self) -> Self:
        raise OSError("no display")


class Failing(DummySimulator):
    """A simulator whose drives raise."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        raise RuntimeError("out of memory")


class Absent(DummySimulator):
    """A simulator whose package is not installed."""

    needs = ("a_module_that_is_nowhere",)


class Unchecked(DummySimulator):
    """A simulator that starts, and whose own checks raise."""

    def checks(self) -> Iterator[SimulatorCheck]:
        raise RuntimeError("the licence server is away")


class Unstoppable(DummySimulator):
    """A simulator that cannot be ended."""

    def __exit__(self, *_: object) -> None:
        raise RuntimeError("the process stays")


class Checking(DummySimulator):
    """A simulator with its own check, which fails."""

    def checks(self) -> Iterator[SimulatorCheck]:
        yield SimulatorCheck("key", False, "there is no key", "buy one")


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lets doctor know only the simulators of this file."""
    parts = (
        *(DummySimulator, Crooked, Dead, Failing, Absent),
        *(Unchecked, Unstoppable, Checking, Tuned),
    )
    built_in = {part.__name__.lower(): (f"test_doctor:{part.__name__}", "") for part in parts}
    monkeypatch.setattr(
        doctor, "SIMULATORS", Registry("simulator", "frenetic.none", built_in, SIMULATORS.methods)
    )


class Tuned(DummySimulator):
    """A simulator that needs an option."""

    def __init__(self, *, place: str = "") -> None:
        if not place:
            raise ValueError("say where it is, with place")
        super().__init__()


def test_embedded_simulator_passes_all_checks() -> None:
    reported: list[SimulatorCheck] = []
    examination = examine("embedded", on_check=reported.append)
    assert examination.health is Health.OK, examination.failed
    assert tuple(reported) == examination.checks
    names = [check.name for check in reported]
    assert names == ["start", "cache", "straight road, Stanley", "curve, Stanley"]
    assert not any(check.remedy for check in reported)


def test_a_drive_that_leaves_the_lane_or_stands_fails_its_check() -> None:
    with EmbeddedSimulator(friction=0.2) as simulator:
        straight, curve = drive_checks(simulator)
    assert straight.is_ok
    assert not curve.is_ok
    assert "drove out of the lane" in curve.state
    assert "draw it" in curve.remedy
    with EmbeddedSimulator() as simulator:
        checks = list(drive_checks(simulator, DummyDriver(), driver_name="nobody"))
    assert [check.name for check in checks] == ["straight road, nobody", "curve, nobody"]
    assert all("moved less than 1 m" in check.state for check in checks)


@pytest.mark.usefixtures("registry")
def test_every_simulator_is_examined() -> None:
    examinations = {examination.simulator: examination for examination in examine_all()}
    assert {name: examination.health for name, examination in examinations.items()} == {
        "dummysimulator": Health.OK,
        "crooked": Health.BROKEN,
        "dead": Health.BROKEN,
        "failing": Health.BROKEN,
        "absent": Health.NOT_INSTALLED,
        "unchecked": Health.BROKEN,
        "unstoppable": Health.BROKEN,
        "checking": Health.BROKEN,
        "tuned": Health.NOT_SET_UP,
    }
    assert examinations["absent"].note == 'pip install ".[absent]" in the clone of Frenetic'
    assert "say where it is" in examinations["tuned"].note
    assert examinations["dead"].failed[0].state.startswith("OSError: no display (test_doctor.py:")
    for name, failed in (("dead", "start"), ("unchecked", "checks"), ("unstoppable", "end")):
        assert [check.name for check in examinations[name].failed] == [failed]
    assert len(examinations["failing"].failed) == 2
    for check in examinations["failing"].failed:
        assert check.state.startswith("RuntimeError: out of memory (test_doctor.py:")
    assert examinations["checking"].failed == (
        SimulatorCheck("key", False, "there is no key", "buy one"),
    )
    for examination in examinations.values():
        assert all(check.remedy for check in examination.failed)


@pytest.mark.usefixtures("registry")
def test_the_log_has_the_traceback_of_a_check_that_raised(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.DEBUG, logger="frenetic"):
        examine("dead")
    assert "Traceback" in caplog.text
    assert "OSError: no display" in caplog.text


def test_unknown_simulator_names_the_close_match() -> None:
    assert Examination("x", Health.NOT_INSTALLED, (), "pip install x").failed == ()
    with pytest.raises(UnknownNameError, match="did you mean 'embedded'"):
        examine("embeded")
