"""A simulator in a process of its own: the same drives, and whose it is; faults: test_workers.py"""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns import campaign, refused
from contents import contents
from faulty import (
    Fault,
    FaultyDriver,
    FaultySimulator,
    Marks,
    Straight,
    hang_in_c,
    leave,
    refuse_connection,
)
from numba.core.registry import CPUDispatcher
from pids import until_gone

from frenetic.analysis.failures import distinct_failures
from frenetic.campaign import CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.description import describe
from frenetic.drivers import (
    Controls,
    Delayed,
    DriveSetup,
    LimitedView,
    Noisy,
    Observation,
    Planner,
)
from frenetic.errors import ENDS_ITS_PROCESS, HANGS, FreneticError
from frenetic.outcome import Outcome
from frenetic.registry import DRIVERS
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.isolated import BrokenDriveError, IsolatedSimulator, isolated
from frenetic.simulators.worlds import in_conditions
from frenetic.testing import DummyDriver, DummySimulator

ROAD = Road([0.0, 0.03, 0.05, 0.0, -0.05, -0.04, 0.0, 0.0])

pytest_plugins = ["campaign_fixtures"]


class PythonPlanner(Planner):
    """The planner as a driver in Python."""


class Faulty(PythonPlanner):
    """Faults strike at the beginning of its drives."""

    def __init__(self, faults: Sequence[Fault]) -> None:
        super().__init__()
        self.faults = faults

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        for fault in self.faults:
            fault.strike()


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


def test_a_campaign_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    """Each proposal knows the result before it, as without a process of its own."""
    driver = Delayed(PythonPlanner(), seconds=0.1)
    apart = IsolatedSimulator(EmbeddedSimulator())
    for name, simulator in (("apart", apart), ("here", EmbeddedSimulator())):
        parts = {"simulator": simulator, "driver": driver}
        campaign(tmp_path / name, 25, **parts).run()
    assert contents(tmp_path / "apart") == contents(tmp_path / "here")
    with (
        CampaignStore.open(tmp_path / "apart") as one,
        CampaignStore.open(tmp_path / "here") as two,
    ):
        assert one.config == two.config
        assert {test.outcome for test in one.tests()} >= {Outcome.PASS, Outcome.FAIL}


def test_no_kernel_is_loaded_on_a_drivers_time() -> None:
    """The wall limit is for the driver alone, also in a fresh process."""
    driver = Delayed(LimitedView(Noisy(Watching())))
    with IsolatedSimulator(EmbeddedSimulator()) as apart:
        assert apart.drive(Road([0.0] * 3), driver).error is None


def test_conditions_reach_the_other_process() -> None:
    here = EmbeddedSimulator()
    conditions = {"friction": 0.4, "speed": 50.0, "noise": 0.3, "start": 0.5, "heading": 0.02}
    driver = PythonPlanner()
    with IsolatedSimulator(EmbeddedSimulator()) as apart:
        usual = apart.drive(ROAD, driver).trajectory.to_rows()
        drives = []
        for simulator in (here, apart):
            with in_conditions(conditions, simulator, driver) as layered:
                drives.append(simulator.drive(ROAD, layered))
        assert drives[1].rules.speed_limit == 50.0
        rows = [drive.trajectory.to_rows() for drive in drives]
        np.testing.assert_array_equal(rows[0], rows[1])
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
    embedded = EmbeddedSimulator()
    for driver in (Planner(), Noisy(Planner()), Delayed(Noisy(Planner()))):
        assert isolated(embedded, driver) is embedded
    for simulator, driver in (
        (embedded, PythonPlanner()),
        (embedded, Noisy(Noisy(Planner()))),
        (DummySimulator(), Planner()),
    ):
        assert isinstance(isolated(simulator, driver), IsolatedSimulator)


@pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")
def test_a_driver_that_breaks_its_process_costs_its_drive(marks: Marks) -> None:
    with IsolatedSimulator(FaultySimulator(marks.folder)) as simulator:
        lost = "^the driver's process was lost: it ended with exit code 7$"
        with refused(lost, BrokenDriveError):
            simulator.drive(ROAD, FaultyDriver(Fault(leave, marks.folder)))
        assert simulator.drive(ROAD, DummyDriver()).error is None
    until_gone(marks.pids())
    start = Fault(refuse_connection, marks.folder)
    simulator = IsolatedSimulator(FaultySimulator(marks.folder, start=start))
    with pytest.raises(BrokenDriveError, match="ConnectionRefusedError: nobody listens on port"):
        simulator.__enter__()
    until_gone(marks.pids())


LOST = "the driver's process was lost: "
DEEDS = {
    ENDS_ITS_PROCESS: (leave, LOST + "it ended with exit code 7"),
    HANGS: (hang_in_c, LOST + "its drive took more than 2 s"),
    "ConnectionRefusedError": (refuse_connection, "the driver raised ConnectionRefusedError"),
}
"""Kind of fault -> what a driver does, and the reason of its failure."""


@pytest.mark.skipif(sys.platform == "win32", reason="by POSIX means")
@pytest.mark.parametrize("workers", [1, 2])
def test_what_a_driver_does_to_its_process_is_its_failure(
    marks: Marks, tmp_path: Path, workers: int
) -> None:
    strategy = Straight(8, 9)
    strategy.expects_failures = True  # type: ignore[misc]  # so none is driven a second time
    search = campaign(
        tmp_path / "c",
        5,
        simulator=EmbeddedSimulator(),
        driver=Faulty([Fault(deed, marks.folder, times=1) for deed, _ in DEEDS.values()]),
        strategy=strategy,
        workers=workers,
        drive_limit=2.0,
    )
    search.isolate = True
    summary = search.run()
    assert (summary.failed, summary.errors) == (len(DEEDS), 0)
    with CampaignStore.open(tmp_path / "c") as store:
        failures = list(store.tests(Outcome.FAIL))
        clusters = distinct_failures(store)
    assert {cluster.ids for cluster in clusters} == {(test.id,) for test in failures}
    faults = {test.result.fault.kind: test for test in failures if test.result.fault is not None}
    for kind, (_, text) in DEEDS.items():
        test = faults[kind]
        assert test.reason.startswith(text)
        assert test.attempts == 1, "what the driver did is not tried again"
        assert test.result.fault is not None
        assert test.result.fault.part == "driver"
    assert check_campaign(tmp_path / "c").findings == ()
    until_gone(marks.pids())


class Uncopied(DummyDriver):
    """A driver that cannot be pickled, as one with an open session cannot."""

    def __init__(self) -> None:
        super().__init__()
        self.session = lambda: None


def test_a_driver_that_cannot_be_copied_is_made_anew_by_its_name_or_drives_here(
    caplog: pytest.LogCaptureFixture,
) -> None:
    named, simulator = DRIVERS.make(f"{__name__}:Uncopied"), DummySimulator()
    for driver in (named, Noisy(named)):
        with isolated(simulator, driver) as apart:
            assert isinstance(apart, IsolatedSimulator)
            assert apart.drive(ROAD, driver).error is None
    assert isolated(simulator, Uncopied()) is simulator
    assert "nothing protects this process from the driver" in caplog.text
    with IsolatedSimulator(simulator) as apart, refused("be copied"):
        apart.drive(ROAD, Uncopied())
