"""Built-in parts behave as their declared version did when it was recorded in `behaviour.json`.

After an intended change raise the part's ``BEHAVIOUR``. Then record the new version beside the old
versions, which are never recorded again:

    python tests/test_behaviour.py
"""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, TypeAlias

import numpy as np
import pytest

from frenetic import Budget, Campaign, CampaignStore, road
from frenetic.conditions.condition import known_conditions
from frenetic.conditions.declaration import Condition
from frenetic.conditions.sensors_and_steering import SENSOR_CONDITIONS, STEERING_CONDITIONS
from frenetic.drivers import Observation, Planner, Stanley
from frenetic.drivers.stack import scene_of
from frenetic.errors import FreneticError
from frenetic.oracle import verdict
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.parts.registry import DRIVERS, SIMULATORS, STRATEGIES, Registry
from frenetic.parts.versions import version_of
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.plugins.vision.rendering import CameraRenderer
from frenetic.road import Road
from frenetic.search import Candidate, Strategy
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.simulators.simulator import Simulator
from frenetic.testing import DummyDriver, DummySimulator, converse

RECORDED: Final = Path(__file__).with_name("behaviour.json")
NOT_RECORDED: Final = {
    "simulator beamng": "it needs a licensed program; its tests have a stand-in",
    "simulator commonroad": "CommonRoad's own code moves the car",
    "strategy foresight": "each machine rounds its fit differently",
    "driver metadrive-policy": "it needs a file of weights",
    "strategy command": "it is the user's program",
    "driver command": "it is the user's program",
    "simulator command": "it is the user's program",
    "driver fiss-planner": "it is another project's",
    "driver highway-env": "it is another project's",
    "driver opendbc": "it is another project's",
    "driver rox-control": "it is another project's",
}
"""Part -> reason why its behaviour is not recorded."""
CURVATURES: Final = (
    [0.0, 0.0, 0.01, 0.02, 0.02, 0.0, -0.02, -0.03, -0.01, 0.0, 0.0],
    [0.0, 0.03, 0.06, 0.06, 0.03, 0.0, 0.0, 0.0, -0.05, -0.06, -0.02, 0.0, 0.0],
    [0.0] * 12,
)


def roads() -> list[Road]:
    return [
        Road(np.array(values), 10.0).placed()[0] or Road(np.array(values), 10.0)
        for values in CURVATURES
    ]


def of_drives(simulator: Simulator, driver: Any, test_roads: list[Road]) -> list[float]:
    """Return length and last state of the drives on these roads."""
    numbers: list[float] = []
    with simulator:
        for test_road in test_roads:
            drive = simulator.drive(test_road, driver)
            last = drive.trajectory.to_rows()[-1]
            numbers += [len(drive.trajectory), *last[:4].tolist()]
    return numbers


def of_strategy(strategy: Strategy) -> list[float]:
    """Return length and a weighted sum of each road that it proposes to a made-up driver."""

    def verdict(candidate: Candidate) -> tuple[Outcome, float]:
        moobd = 1.2 - 30.0 * float(np.abs(np.diff(candidate.curvatures)).max(initial=0.0))
        return (Outcome.FAIL if moobd < 0.0 else Outcome.PASS), moobd

    curvatures = [evaluation.candidate.curvatures for evaluation in converse(strategy, verdict, 80)]
    return [
        number
        for values in curvatures
        for number in (len(values), float(values @ np.arange(len(values))))
    ]


def of_search(strategy: Strategy) -> list[float]:
    """Return weighted sums of the roads that it proposes while it learns from real drives."""
    with TemporaryDirectory() as folder:
        Campaign(
            strategy=strategy,
            simulator=EmbeddedSimulator(),
            driver=Planner(),
            budget=Budget(simulations=150),
            folder=Path(folder) / "c",
        ).run()
        with CampaignStore.open(Path(folder) / "c") as store:
            roads = [test.candidate.curvatures for test in store.tests()]
    return [float(curvatures @ np.arange(len(curvatures))) for curvatures in roads]


def of_rules() -> list[float]:
    """Return results of drives at fixed offsets."""
    numbers = []
    for offset in (0.0, 0.9, -1.4, 2.5, -4.0):
        simulator = DummySimulator(lambda _, offset=offset: offset, rules=Rules(timeout_base=20.0))  # type: ignore[misc]
        for test_road in roads():
            result = judge(test_road, simulator.drive(test_road, DummyDriver()))
            place = result.departure
            numbers += [
                float(result.outcome is Outcome.FAIL),
                result.moobd or 0.0,
                result.max_oob_share or 0.0,
                0.0 if place is None else place.distance,
            ]
    return numbers


def of_picture(driver: Any) -> list[float]:
    """Return mean colours of parts of a picture that the camera sees through the wrapper."""
    images: list[Any] = []
    driver.driver.act = lambda observation: images.append(observation.image)
    test_road = roads()[0]
    renderer = CameraRenderer(test_road, driver.driver.camera, scene_of(driver))
    image = renderer.draw(*test_road.pose)
    driver.act(
        Observation(1.0, 15.0, 0.2, 0.0, 0.0, 0.0, np.empty((0, 2)), np.empty(0), 0.0, image)
    )
    parts = np.asarray(images[0], dtype=np.float64).reshape(4, 20, 4, 40, 3).mean(axis=(1, 3))
    return [float(number) for number in parts.ravel()]


def of_map() -> list[float]:
    """Return validity and pose of random roads on two maps."""
    rng = np.random.default_rng(5)
    numbers = []
    for size in (200.0, 120.0):
        for _ in range(25):
            values = np.clip(np.cumsum(rng.uniform(-0.03, 0.03, 18)), -0.08, 0.08)
            fitted, verdict = Road(values, 10.0).placed(size)
            numbers += [float(verdict.valid), *((0.0,) * 3 if fitted is None else fitted.pose)]
    return numbers


Numbers: TypeAlias = Callable[[], list[float]]
Probe: TypeAlias = Callable[[], tuple[str, Numbers]]
"""Function that makes a part, and returns its version and a function that measures behaviour."""


def probes() -> dict[str, Probe]:
    """Return name of a part of ours -> its probe."""
    parts: dict[str, Probe] = {
        "rules": lambda: (f"version {verdict.BEHAVIOUR}", of_rules),
        "map": lambda: (f"version {road.BEHAVIOUR}", of_map),
        "search for the planner's failures": probe_search,
    }
    kinds: dict[str, tuple[Registry, Callable[[str], tuple[str, Numbers]]]] = {
        "strategy": (STRATEGIES, probe_strategy),
        "driver": (DRIVERS, probe_driver),
        "simulator": (SIMULATORS, probe_simulator),
    }
    for kind, (registry, probe) in kinds.items():
        for entry in registry.entries():
            if f"{kind} {entry.name}" not in NOT_RECORDED:
                parts[f"{kind} {entry.name}"] = partial(probe, entry.name)
    for row in known_conditions().values():
        if row.wrapper:
            parts[f"wrapper {row.name}"] = partial(probe_wrapper, row)
    return parts


def probe_search() -> tuple[str, Numbers]:
    learning = STRATEGIES.make("frenetic", seed=7)
    versions = ", ".join(map(version_text, (learning, EmbeddedSimulator(), Planner())))
    return versions, lambda: of_search(learning)


def probe_strategy(name: str) -> tuple[str, Numbers]:
    strategy = STRATEGIES.make(name, seed=7)
    return version_text(strategy), lambda: of_strategy(strategy)


def probe_driver(name: str) -> tuple[str, Numbers]:
    driver = DRIVERS.make(name)
    if name.startswith("metadrive"):
        simulator = SIMULATORS.make("metadrive")
        return version_text(driver), lambda: of_drives(simulator, driver, roads()[:1])
    if name == "marking-follower":  # its pictures take long to draw
        return version_text(driver), lambda: of_drives(EmbeddedSimulator(), driver, roads()[:1])
    return version_text(driver), lambda: of_embedded_drives(driver)


def probe_simulator(name: str) -> tuple[str, Numbers]:
    if name == "embedded":
        return version_text(EmbeddedSimulator()), lambda: of_embedded_drives(Planner())
    simulator = SIMULATORS.make(name)
    test_roads = roads()[:1] if name == "metadrive" else roads()
    return version_text(simulator), lambda: of_drives(simulator, Planner(), test_roads)


def probe_wrapper(row: Condition) -> tuple[str, Numbers]:
    amount = 0.2 if row.no_effect != math.inf else min(15.0, row.high)
    if row.name in appearance.ALL:
        amount = 5.0 if row.name in ("scene", "rain") else amount
        seeing = row.wrapper_class().over(MarkingFollower(), amount)
        return version_text(seeing), lambda: of_picture(seeing)
    driver = row.wrapper_class().over(Planner(), amount)
    if row in STEERING_CONDITIONS + SENSOR_CONDITIONS:
        driver = row.wrapper_class().over(Stanley(), row.usual[1])  # it reads all signals
    return version_text(driver), lambda: of_embedded_drives(driver)


def of_embedded_drives(driver: Any) -> list[float]:
    """Return `of_drives` in two embedded simulators."""
    other = EmbeddedSimulator(vehicle="metadrive", friction=0.8)
    usual = EmbeddedSimulator(vehicle="default")
    return of_drives(usual, driver, roads()) + of_drives(other, driver, roads())


def version_text(part: object) -> str:
    return version_of(part).text


PROBES: Final = probes()


HEAVY: Final = (
    "driver dave2",
    "driver metadrive-expert",
    "driver metadrive-idm",
    "simulator metadrive",
)
"""Parts whose packages only ``.[test-all]`` installs."""


def marked(name: str) -> Any:
    """Return the name as a test's parameter, heavy for a part in `HEAVY`."""
    return pytest.param(name, marks=pytest.mark.heavy) if name in HEAVY else name


@pytest.mark.parametrize("name", [marked(name) for name in PROBES])
def test_a_part_behaves_as_recorded_for_its_version(name: str) -> None:
    recorded = json.loads(RECORDED.read_text(encoding="utf-8")).get(name, {})
    version, measure = PROBES[name]()
    if version not in recorded and "," in version:
        return  # recorded with other versions of its packages
    assert version in recorded, f"record {version} of {name}: python {__file__}"
    assert measure() == pytest.approx(recorded[version], abs=2e-3), (
        f"{name} no longer behaves as {version} did: raise its BEHAVIOUR"
    )


def test_every_record_is_probed() -> None:
    assert set(json.loads(RECORDED.read_text(encoding="utf-8"))) == set(PROBES)


def test_every_built_in_part_declares_a_version() -> None:
    for target in targets():
        module, _, name = target.partition(":")
        assert isinstance(getattr(importlib.import_module(module), name).BEHAVIOUR, int), target


def targets() -> Iterator[str]:
    for registry in (STRATEGIES, DRIVERS, SIMULATORS):
        yield from (target for target, _ in registry.built_in.values())
    yield from (row.wrapper for row in known_conditions().values() if row.wrapper)


def record() -> None:
    """Record the versions that are not recorded yet, except of parts whose package is missing."""
    recorded = json.loads(RECORDED.read_text(encoding="utf-8")) if RECORDED.exists() else {}
    for name, probe in PROBES.items():
        try:
            version, measure = probe()
        except FreneticError as error:
            sys.stderr.write(f"{name} is not recorded: {error}\n")
            continue
        if not version.startswith("version "):
            sys.exit(f"{name} has no version: give its class BEHAVIOUR: ClassVar[int] = 1")
        if version not in recorded.setdefault(name, {}):
            recorded[name][version] = [round(number, 6) for number in measure()]
    lines = (f"{json.dumps(name)}: {json.dumps(versions)}" for name, versions in recorded.items())
    RECORDED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    record()
