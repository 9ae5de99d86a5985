"""Many drives side by side in the embedded simulator are the same as drives one after the other."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frenetic.drivers import BeamngAi, Delayed, LimitedView, Noisy, Planner, Stanley
from frenetic.drivers.driver import Driver
from frenetic.drivers.wrappers import Hasty
from frenetic.errors import RoadError
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive, Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.road.classes import class_of
from frenetic.search.operators import random_curvatures
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators import EmbeddedSimulator

DRIVERS: dict[str, Driver] = {
    "planner": Planner(aggression=1.2),
    "stanley": Stanley(),
    "beamng-ai": BeamngAi(),
    "noisy": Noisy(Planner(), offset=0.3, seed=4),
    "delayed": Delayed(Stanley(), seconds=0.2),
    "limited": LimitedView(BeamngAi(), distance=20.0),
    "hasty": Hasty(Planner(), excess=15.0),
    "all": Noisy(Delayed(LimitedView(Hasty(Planner()), distance=40.0), seconds=0.1), offset=0.1),
}
CONDITIONS: dict[str, dict[str, Any]] = {
    "dry": {},
    "snow": {"friction": 0.4},
    "loaded": {"load": 400.0, "steering_lag": 0.3},
    "wet stretch": {"wet": 0.5},
    "gust": {"gust": 15.0, "gust_at": 60.0},
    "start": {"start_offset": 0.5, "start_heading": -0.05},
    "start at speed": {"start_speed": 60.0},
    "other car": {"vehicle": "metadrive"},
}


def competition_roads(seed: int) -> Iterator[Road]:
    """Yield random roads of 30 to 250 m; some leave their map or meet themselves."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            yield Road(random_curvatures(rng, int(rng.integers(3, 26))))
        except RoadError:
            continue


def class_roads(name: str, seed: int) -> Iterator[Road]:
    """Yield random roads of a road class, with slopes, widening and limits."""
    road_class = class_of(f"{name},length=400")
    yield from RandomRoads(road_class=road_class, map_size=500.0).valid(np.random.default_rng(seed))


def some_roads(count: int, seed: int = 0) -> list[Road]:
    """Return roads of every kind, in turn."""
    kinds = [
        competition_roads(seed),
        competition_roads(seed + 1),
        class_roads("rural-80", seed),
        class_roads("urban-50", seed),
    ]
    limits = [(0.0, 70.0), (20.0, 30.0), (60.0, 50.0)]
    roads = [next(kinds[i % len(kinds)]) for i in range(count)]
    return [
        Road(road.curvatures, speed_limits=limits) if i % 8 == 1 else road
        for i, road in enumerate(roads)
    ]


def assert_equal(drives: list[Drive], others: list[Drive]) -> None:
    """Compare the drives' records and assessments, bit for bit."""
    for drive, other in zip(drives, others, strict=True):
        np.testing.assert_array_equal(drive.trajectory.to_rows(), other.trajectory.to_rows())
        assert drive.assessed is not None
        assert other.assessed is not None
        ours, theirs = drive.assessed.assessment, other.assessed.assessment
        assert ours.end == theirs.end
        for name in ("distance", "lateral_offset", "oob_distance", "oob_share"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


@pytest.mark.endurance
@pytest.mark.parametrize("conditions", CONDITIONS)
@pytest.mark.parametrize("driver", DRIVERS)
def test_drives_side_by_side_are_the_drives_one_after_the_other(
    driver: str, conditions: str, endurance: bool
) -> None:
    simulator = EmbeddedSimulator(**CONDITIONS[conditions])
    roads = some_roads(10_000 if endurance else 40, seed=len(driver) + len(conditions))
    alone = [simulator.drive(road, DRIVERS[driver]) for road in roads]
    assert len({len(drive.trajectory) for drive in alone}) > 10, "the drives differ"
    for threads in (1, 2, 3):
        assert_equal(simulator.drive_many(roads, DRIVERS[driver], threads=threads), alone)
    some = [3, 17, 5, 38, 6]
    few = simulator.drive_many([roads[k] for k in some], DRIVERS[driver])
    assert_equal(few, [alone[k] for k in some])


@pytest.mark.parametrize("driver", ["planner", "stanley", "beamng-ai"])
def test_the_simulators_assessment_gives_the_verdict_that_a_new_assessment_gives(
    driver: str,
) -> None:
    roads = some_roads(60)
    outcomes = set()
    for road, drive in zip(
        roads, EmbeddedSimulator().drive_many(roads, DRIVERS[driver]), strict=True
    ):
        result = judge(road, drive)
        assert result == judge(road, replace(drive, assessed=None))
        outcomes.add(result.outcome)
        all_shares = assess(road, drive)
        assert result.max_oob_share == all_shares.oob_share.max()
    assert Outcome.PASS in outcomes
    assert driver == "beamng-ai" or Outcome.FAIL in outcomes


def test_an_assessment_holds_only_for_what_it_was_made_from() -> None:
    road = next(competition_roads(0))
    drive = EmbeddedSimulator().drive(road, Planner())
    strict = replace(drive, rules=Rules(oob_tolerance=0.01, timeout_base=1.0))
    assert judge(road, strict) == judge(road, replace(strict, assessed=None))
    other = Road(-road.curvatures)
    assert judge(other, drive) == judge(other, replace(drive, assessed=None))


class PythonPlanner(Planner):
    """The planner, called from Python."""


@pytest.mark.parametrize("conditions", CONDITIONS)
def test_drivers_in_python_drive_many_roads_too(conditions: str) -> None:
    roads = some_roads(4)
    simulator = EmbeddedSimulator(**CONDITIONS[conditions])
    compiled = simulator.drive_many(roads, Planner())
    called = simulator.drive_many(roads, PythonPlanner(), threads=2)
    assert_equal(called, compiled)
    for road, drive in zip(roads, called, strict=True):
        assert judge(road, drive) == judge(road, replace(drive, assessed=None))


def test_no_roads_are_no_drives() -> None:
    assert EmbeddedSimulator().drive_many([], Planner()) == []


@pytest.mark.parametrize("threads", [0, -1])
def test_threads_are_at_least_one(threads: int) -> None:
    with pytest.raises(ValueError, match="threads is"):
        EmbeddedSimulator().drive_many([], Planner(), threads=threads)


def test_the_order_of_the_roads_does_not_matter() -> None:
    roads = some_roads(24, seed=3)
    simulator = EmbeddedSimulator(gust=10.0)
    drives = simulator.drive_many(roads, DRIVERS["noisy"])
    backwards = simulator.drive_many(roads[::-1], DRIVERS["noisy"])
    assert_equal(backwards[::-1], drives)


DIGEST = """
import hashlib

from frenetic._support.interpreted import end_interpretation
from frenetic.drivers import BeamngAi, Noisy, Planner, Stanley
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator

end_interpretation()
road = Road([0.0, 0.03, 0.06, 0.0, -0.04, 0.0])
other, leaning = Road(-road.curvatures), Road(road.curvatures, grade=0.04, superelevation=-0.03)
digest = hashlib.sha256()
class PythonPlanner(Planner):
    pass

for driver in (Planner(), Stanley(), BeamngAi(), Noisy(Planner()), PythonPlanner()):
    for options in ({}, {"gust": 12.0, "friction": 0.7}):
        for drive in EmbeddedSimulator(**options).drive_many([road, other, leaning], driver):
            digest.update(drive.trajectory.to_rows().tobytes())
print(digest.hexdigest())
"""


def digest_of_drives(code: str, **variables: str) -> str:
    """Return what code prints in a process with environment variables."""
    command, environment = [sys.executable, "-c", code], {**os.environ, **variables}
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True
    ).stdout


@pytest.mark.parametrize(
    "variables",
    [
        {"NUMBA_DISABLE_JIT": "1"},
        pytest.param(
            {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}, marks=pytest.mark.heavy
        ),
    ],
    ids=["interpreted", "a plain processor"],
)
def test_drives_have_the_same_bits_without_vector_instructions(
    tmp_path: Path, variables: dict[str, str]
) -> None:
    """Python's own arithmetic, and that of a processor with the least instructions, agree."""
    digest = digest_of_drives(DIGEST, NUMBA_CACHE_DIR=str(tmp_path), **variables)
    assert digest == digest_of_drives(DIGEST) != ""


def test_the_first_drives_on_a_machine_compile_nothing_and_have_the_same_bits(
    tmp_path: Path,
) -> None:
    first_drives = DIGEST.replace("\nend_interpretation()", "")
    digest = digest_of_drives(first_drives, NUMBA_CACHE_DIR=str(tmp_path))
    assert digest == digest_of_drives(DIGEST) != ""
    assert not list(tmp_path.rglob("*.nbi"))
