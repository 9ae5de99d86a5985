"""Users' own drivers and simulators by name: what a command knows of them, and where they drive."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Final

import pytest

from frenetic.campaign import Campaign, CampaignStore
from frenetic.drivers import Noisy
from frenetic.drivers.driver import camera_of
from frenetic.errors import FreneticError
from frenetic.recipe import Named
from frenetic.registry import DRIVERS, SIMULATORS
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator
from frenetic.simulators.capabilities import capabilities, check_pair
from frenetic.spec import Budget, Part, Spec, driver_of, usual_of

PARTS: Final = """
import os

from frenetic import Camera, EmbeddedSimulator, Planner
from frenetic.drivers import Delayed
from frenetic.errors import DriverError

class Own(Planner):
    drives = 0

    def reset(self, setup):
        self.drives += 1  # of this very object
        assert self.drives < 3 and os.getpid() != {pid}
        super().reset(setup)

    def act(self, observation):
        return super().act(observation)

class Layered(Delayed):
    def __init__(self):
        super().__init__(Own(), seconds=0.05)

class Seeing(Own):
    def __init__(self, width=80):
        super().__init__()
        self.camera = Camera(width=width, height=40)

class Choosy(Own):
    def check_simulator(self, simulator):
        if simulator.rules.speed_limit < 60.0:
            raise DriverError("too slow")

class Simulator(EmbeddedSimulator):
    usual_wall_limit = 7.0
    usual_workers = 1

    def prepare(self):
        self.vehicle = type(self.vehicle).named("etk800")

    def check_driver(self, driver):
        if isinstance(driver, Seeing):
            raise DriverError("it is too dark")
"""


@pytest.fixture(autouse=True)
def _parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.py").write_text(PARTS.format(pid=os.getpid()), encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "is_own"),
    [
        ("planner", False),
        ("unknown", False),
        ("model.onnx", False),
        ("folder:with/model.onnx", False),
        ("frenetic.testing:DummyDriver", False),
        ("frenetic.py:Mine", True),
        ("mine.py:Mine", True),
        ("frenetics.drivers:Mine", True),
    ],
)
def test_own_is_what_is_not_ours(name: str, is_own: bool) -> None:
    assert DRIVERS.is_own(name) is is_own


def test_a_named_driver_tells_what_is_read_of_it() -> None:
    seeing = driver_of("own.py:Seeing", {"width": 60}, {"fog": 50.0, "delay": 0.1})
    camera = camera_of(seeing)
    assert camera is not None
    assert camera.width == 60
    choosy = driver_of("own.py:Choosy", {}, {"noise": 0.1})
    check_pair(EmbeddedSimulator(), choosy)
    spec = Spec().replaced({"speed_limit": 50.0})
    with pytest.raises(FreneticError, match="too slow"):
        check_pair(spec.make_simulator(), choosy)


def test_a_named_simulator_has_its_capabilities() -> None:
    assert usual_of("own.py:Simulator").usual_wall_limit == 7.0
    spec = Spec(simulator=Part("own.py:Simulator", {"friction": 0.7}), driver=Part("own.py:Seeing"))
    driver, simulator = spec.make_parts(isolate=False)
    its = capabilities(simulator)
    assert (its.wall_limit, its.usual_workers, its.draws, its.lays_slopes) == (7.0, 1, True, True)
    assert "friction" in its.variable
    made = SIMULATORS.make("frenetic.simulators:EmbeddedSimulator", friction=0.7)
    assert simulator.car == made.car
    its.prepare()
    assert simulator.car == EmbeddedSimulator(vehicle="etk800").car
    with pytest.raises(FreneticError, match="it is too dark"):
        check_pair(simulator, driver)


@pytest.mark.parametrize("name", ["Own", "Layered"])
def test_it_drives_in_other_processes_only(name: str) -> None:
    """One object for all drives there, whatever lies over it."""
    road = Road([0.0, 0.02, 0.0, 0.0])
    spec = Spec(driver=Part(f"own.py:{name}"), simulator=Part("own.py:Simulator"))
    driver, simulator = spec.make_parts(isolate=True)
    with simulator:
        usual = simulator.drive(road, driver)
        noisy = simulator.drive(road, Noisy(driver))
        assert (usual.trouble, noisy.trouble) == (None, None)
        third = simulator.drive(road, driver)
        assert "assert self.drives < 3" in str(third.trouble)
    for part in spec.make_parts(isolate=False):
        kept = pickle.loads(pickle.dumps(part))
        assert isinstance(kept, Named)
    refused = EmbeddedSimulator().drive(road, driver)
    assert f"the driver 'own.py:{name}' drives in another process only" in str(refused.trouble)


def test_a_campaign_of_named_parts_isolates_them(tmp_path: Path) -> None:
    budget = Budget(simulations=2)
    spec = Spec(strategy=Part("random"), driver=Part("own.py:Own"), budget=budget, seed=1)
    Campaign.of(spec, folder=tmp_path / "c", workers=1).run()
    with CampaignStore.open(tmp_path / "c") as store:
        assert [test.outcome.is_driven for test in store.tests()] == [True, True]
