"""Built-in parts behave as their declared version did when it was recorded in `behaviour.json`.

After an intended change raise the part's ``BEHAVIOUR``. Then record the new version beside the old
versions, which are never recorded again:

    python tests/test_behaviour.py
"""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
import pytest

from frenetic import Budget, Campaign, CampaignStore, road
from frenetic.conditions.condition import known_conditions
from frenetic.drivers import Observation, Planner
from frenetic.drivers.stack import scene_of
from frenetic.oracle import verdict
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.parts.registry import DRIVERS, SIMULATORS, STRATEGIES
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
NOT_RECORDED: Final = {"simulator beamng"}
"""Parts that need a licensed program; `tests/plugins/beamng` tests them with a stand-in."""
NOT_REPRODUCIBLE: Final = {"foresight"}
"""Strategies with a fit that each machine rounds differently."""
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


def probes() -> dict[str, tuple[str, Callable[[], list[float]]]]:
    """Return name of a built-in part -> its version, and a function that measures its behaviour."""
    parts: dict[str, tuple[str, Callable[[], list[float]]]] = {
        "rules": (f"version {verdict.BEHAVIOUR}", of_rules),
        "map": (f"version {road.BEHAVIOUR}", of_map),
    }
    for name in sorted(set(STRATEGIES.built_in) - NOT_REPRODUCIBLE):
        strategy = STRATEGIES.make(name, seed=7)
        parts[f"strategy {name}"] = version_text(strategy), lambda s=strategy: of_strategy(s)  # type: ignore[misc]
    learning = STRATEGIES.make("frenetic", seed=7)
    versions = ", ".join(map(version_text, (learning, EmbeddedSimulator(), Planner())))
    parts["search for the planner's failures"] = versions, lambda: of_search(learning)
    for name in DRIVERS.built_in:
        driver = DRIVERS.make(name)
        where = "metadrive" if name.startswith("metadrive") else "embedded"
        if name == "marking-follower":  # its pictures take long to draw
            parts[f"driver {name}"] = (
                version_text(driver),
                lambda d=driver: of_drives(EmbeddedSimulator(), d, roads()[:1]),  # type: ignore[misc]
            )
            continue
        parts[f"driver {name}"] = version_text(driver), drives(where, driver)
    for wrapper in [row for row in known_conditions().values() if row.wrapper]:
        amount = 15.0 if wrapper.no_effect == math.inf else 0.2
        if wrapper.name in appearance.ALL:
            seeing = wrapper.wrapper_class().over(
                MarkingFollower(), 5.0 if wrapper.name in ("scene", "rain") else amount
            )
            parts[f"wrapper {wrapper.name}"] = version_text(seeing), lambda d=seeing: of_picture(d)  # type: ignore[misc]
            continue
        driver = wrapper.wrapper_class().over(Planner(), amount)
        parts[f"wrapper {wrapper.name}"] = version_text(driver), drives("embedded", driver)
    for name in SIMULATORS.built_in:
        if f"simulator {name}" not in NOT_RECORDED:
            simulator = SIMULATORS.make(name)
            parts[f"simulator {name}"] = version_text(simulator), drives(name, Planner())
    return parts


def version_text(part: object) -> str:
    return version_of(part).text


def drives(simulator: str, driver: Any) -> Callable[[], list[float]]:
    def drive() -> list[float]:
        if simulator == "metadrive":
            return of_drives(SIMULATORS.make(simulator), driver, roads()[:1])
        other = EmbeddedSimulator(vehicle="metadrive", friction=0.8)
        usual = EmbeddedSimulator(vehicle="default")
        return of_drives(usual, driver, roads()) + of_drives(other, driver, roads())

    return drive


PROBES: Final = probes()


@pytest.mark.parametrize("name", PROBES)
def test_a_part_behaves_as_recorded_for_its_version(name: str) -> None:
    recorded = json.loads(RECORDED.read_text(encoding="utf-8")).get(name, {})
    version, probe = PROBES[name]
    if version not in recorded and "," in version:
        return  # recorded with other versions of its packages
    assert version in recorded, f"record {version} of {name}: python {__file__}"
    assert probe() == pytest.approx(recorded[version], abs=2e-3), (
        f"{name} no longer behaves as {version} did: raise its BEHAVIOUR"
    )


def test_every_built_in_part_declares_a_version() -> None:
    for target in targets():
        module, _, name = target.partition(":")
        assert isinstance(getattr(importlib.import_module(module), name).BEHAVIOUR, int), target


def targets() -> Iterator[str]:
    for registry in (STRATEGIES, DRIVERS, SIMULATORS):
        for name, (target, _) in registry.built_in.items():
            if name not in NOT_REPRODUCIBLE:
                yield target
    yield from (row.wrapper for row in known_conditions().values() if row.wrapper)


def record() -> None:
    """Record the versions that are not recorded yet."""
    recorded = json.loads(RECORDED.read_text(encoding="utf-8")) if RECORDED.exists() else {}
    for name, (version, probe) in PROBES.items():
        if version not in recorded.setdefault(name, {}):
            recorded[name][version] = [round(number, 6) for number in probe()]
    lines = (f"{json.dumps(name)}: {json.dumps(versions)}" for name, versions in recorded.items())
    RECORDED.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    record()
