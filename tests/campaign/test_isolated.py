"""A simulator in a process of its own: whatever a driver does there, the rest goes on."""

from __future__ import annotations

import gc
import os
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import faulty
import numpy as np
import pytest
from campaigns import campaign, refused
from contents import contents
from faulty import Deed, Fault, FaultyDriver, FaultySimulator, Marks
from numba.core.registry import CPUDispatcher
from pids import LIMIT, until_gone

from frenetic.campaign import CampaignStore
from frenetic.campaign.log import LOG
from frenetic.drivers import (
    Controls,
    Delayed,
    Driver,
    DriveSetup,
    LimitedView,
    Noisy,
    Observation,
    Planner,
)
from frenetic.errors import FreneticError
from frenetic.outcome import Outcome
from frenetic.registry import DRIVERS
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.isolated import BrokenDriveError, IsolatedSimulator, isolated
from frenetic.simulators.worlds import in_conditions
from frenetic.spec import describe
from frenetic.testing import DummyDriver, DummySimulator

ROAD = Road([0.0, 0.03, 0.05, 0.0, -0.05, -0.04, 0.0, 0.0])
OTHER = Road([0.0, 0.01, 0.02, 0.03, 0.0, 0.0])

pytest_plugins = ["campaign_fixtures"]

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")


class PythonPlanner(Planner):
    """The planner as a driver in Python."""


class Watching(PythonPlanner):
    """A driver during whose drives no kernel may be compiled or loaded."""

    def reset(self, setup: DriveSetup) -> None:
        self.ready = ready_kernels()
        super().reset(setup)

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        assert ready_kernels() == self.ready
        return controls


def ready_kernels() -> set[tuple[str, str]]:
    """Name and arguments of each kernel that has its machine code."""
    kernels = [one for one in gc.get_objects() if isinstance(one, CPUDispatcher)]
    return {
        (one.py_func.__name__, str(arguments)) for one in kernels for arguments in one.signatures
    }


def test_the_same_drives_come_out() -> None:
    plain = EmbeddedSimulator(friction=0.8)
    with IsolatedSimulator(EmbeddedSimulator(friction=0.8)) as apart:
        for driver in (PythonPlanner(), Delayed(PythonPlanner(), seconds=0.1)):
            for road in (ROAD, OTHER, ROAD):
                here, there = plain.drive(road, driver), apart.drive(road, driver)
                np.testing.assert_array_equal(here.trajectory.to_rows(), there.trajectory.to_rows())
                assert (there.car, there.rules, there.error) == (here.car, here.rules, None)


@pytest.mark.parametrize("ordered", [True, False])
def test_a_campaign_is_the_same_bit_for_bit(tmp_path: Path, ordered: bool) -> None:
    """Each proposal knows the result before it, as without a process of its own."""
    driver = Delayed(PythonPlanner(), seconds=0.1)
    apart = IsolatedSimulator(EmbeddedSimulator())
    for name, simulator in (("apart", apart), ("here", EmbeddedSimulator())):
        parts = {"simulator": simulator, "driver": driver}
        campaign(tmp_path / name, 40, ordered=ordered, **parts).run()
    assert contents(tmp_path / "apart") == contents(tmp_path / "here")
    with (
        CampaignStore.open(tmp_path / "apart") as one,
        CampaignStore.open(tmp_path / "here") as two,
    ):
        assert one.config == two.config
        assert {test.outcome for test in one.tests()} >= {Outcome.PASS, Outcome.FAIL}


@pytest.mark.parametrize("layer", [Delayed, LimitedView, Noisy])
def test_no_kernel_is_loaded_on_a_drivers_time(layer: Callable[[Driver], Driver]) -> None:
    """The wall limit is for the driver alone, also in a fresh process."""
    with IsolatedSimulator(EmbeddedSimulator()) as apart:
        assert apart.drive(Road([0.0] * 3), layer(Watching())).error is None


def test_conditions_reach_the_other_process() -> None:
    here = EmbeddedSimulator()
    conditions = {"friction": 0.4, "speed": 50.0, "noise": 0.3, "start": 0.5, "heading": 0.02}
    driver = PythonPlanner()
    with IsolatedSimulator(EmbeddedSimulator()) as apart:
        usual = apart.drive(ROAD, driver).trajectory.to_rows()
        for simulator in (here, apart):
            with in_conditions(conditions, simulator, driver) as layered:
                drive = simulator.drive(ROAD, layered)
            assert drive.rules.speed_limit == 50.0
            if simulator is here:
                expected = drive.trajectory.to_rows()
        np.testing.assert_array_equal(drive.trajectory.to_rows(), expected)
        np.testing.assert_array_equal(apart.drive(ROAD, driver).trajectory.to_rows(), usual)
    wet, dummy = {"friction": 0.5}, IsolatedSimulator(DummySimulator())
    with (
        pytest.raises(FreneticError, match="DummySimulator cannot vary friction"),
        in_conditions(wet, dummy, driver),
    ):
        pass


def test_it_is_described_as_the_simulator_itself() -> None:
    simulator = EmbeddedSimulator(friction=0.8)
    apart = IsolatedSimulator(simulator)
    assert describe(apart) == describe(simulator)
    assert (apart.rules, apart.car, apart.wall_limit) == (simulator.rules, simulator.car, 60.0)
    apart.rules = replace(apart.rules, speed_limit=30.0)
    assert simulator.rules.speed_limit == 30.0
    assert not hasattr(apart, "aggression")


def test_only_drives_of_our_compiled_code_stay_here() -> None:
    class Own(EmbeddedSimulator):
        pass

    embedded = EmbeddedSimulator()
    for driver in (Planner(), Noisy(Planner()), Delayed(Noisy(Planner()))):
        assert isolated(embedded, driver) is embedded
    for simulator, driver in (
        (embedded, PythonPlanner()),
        (embedded, Noisy(Noisy(Planner()))),
        (DummySimulator(), Planner()),
    ):
        assert isinstance(isolated(simulator, driver), IsolatedSimulator)
    assert isolated(Own(), Planner()).drive is not None


# Drivers that misbehave; what else they do to such a process: test_workers.py


LOST = "the driver's process was lost: "
FATAL = {
    "kill": f"{LOST}it was killed by SIGKILL",
    "leave": f"{LOST}it ended with exit code 7",
    "hang": f"{LOST}its drive took more than 3 s",
    "close_everything": LOST,
    "sys_exit": "the simulator raised SystemExit: 3 (faulty.py:",
    "raise_error": faulty.STALLED,
}


@posix_only
@pytest.mark.parametrize("deed", FATAL)
def test_a_driver_that_breaks_its_process_costs_its_drive(marks: Marks, deed: str) -> None:
    the_deed: Deed = getattr(faulty, deed)
    inside = FaultySimulator(marks.folder)
    limit = 3.0 if deed == "hang" else LIMIT
    with IsolatedSimulator(inside, drive_limit=limit) as simulator:
        with refused("^" + re.escape(FATAL[deed]), BrokenDriveError):
            simulator.drive(ROAD, FaultyDriver(Fault(the_deed, marks.folder)))
        assert simulator.drive(ROAD, DummyDriver()).error is None
    assert os.getpid() not in marks.pids()
    until_gone(marks.pids())


def test_a_simulator_that_does_not_start_says_why(marks: Marks) -> None:
    fault = Fault(faulty.refuse_connection, marks.folder)
    simulator = IsolatedSimulator(FaultySimulator(marks.folder, start=fault))
    with pytest.raises(BrokenDriveError, match="ConnectionRefusedError: nobody listens on port"):
        simulator.__enter__()
    until_gone(marks.pids())


def test_a_simulator_that_raised_is_ended_in_order_and_started_again(
    tmp_path: Path, marks: Marks
) -> None:
    fault = Fault(faulty.raise_error, marks.folder, times=1)
    simulator = IsolatedSimulator(FaultySimulator(marks.folder, drive=fault))
    summary = campaign(tmp_path / "c", simulator=simulator).run()
    assert summary.errors == 0
    assert os.getpid() not in marks.pids()
    assert marks.numbers("start") == marks.numbers("end") == [1, 2]
    log = (tmp_path / "c" / LOG).read_text().splitlines()
    retried = [line for line in log if "test_retried" in line]
    assert len(retried) == 1
    assert faulty.STALLED.replace('"', '\\"') in retried[0]
    until_gone(marks.pids())


class Uncopied(DummyDriver):
    """A driver that cannot be pickled, as one with an open session cannot."""

    def __init__(self) -> None:
        super().__init__()
        self.session = lambda: None


def test_a_driver_that_cannot_be_copied_is_made_anew_by_its_name() -> None:
    named = DRIVERS.make(f"{__name__}:Uncopied")
    for driver in (named, Noisy(named)):
        apart = isolated(DummySimulator(), driver)
        assert isinstance(apart, IsolatedSimulator)
        with apart:
            assert apart.drive(ROAD, driver).error is None


def test_a_nameless_driver_that_cannot_be_copied_drives_here(
    caplog: pytest.LogCaptureFixture,
) -> None:
    simulator = DummySimulator()
    assert isolated(simulator, Uncopied()) is simulator
    assert "nothing protects this process from the driver" in caplog.text
    with IsolatedSimulator(simulator) as apart, refused("be copied"):
        apart.drive(ROAD, Uncopied())
