"""The speed at which real drivers begin to fail: by road class, steering lag, car and tolerance.

    python benchmarks/real_drivers.py                     # ten minutes on two cores
    python benchmarks/real_drivers.py --seeds 2 --classes rural-80 --cars embedded   # half a minute

All drivers get the same roads: of each seed some that are random, and those of a search on which
our own `stanley` comes nearest to its lane's edge. They keep the speed limit, bends or not, if they
can be told a speed. The first speed of a ladder at which one of the roads fails is found by
bisection; a cell has the median over the seeds for each lag. A car leaves its lane when more than
95 % of it is outside. Scenic and donkeycar need an environment of their own, and the files
of ``docs/real-drivers.md`` in this folder: they are driven there with ``--out``, and shown with
the others with ``--add``.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from frenetic import Budget, Campaign, CampaignStore, EmbeddedSimulator, Frenetic, Rules, Stanley
from frenetic.analysis.causes import as_text, cause_of
from frenetic.analysis.segments import segment_of
from frenetic.criteria.criterion import Criterion
from frenetic.oracle.measures import measure_criteria
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import is_drivers, judge
from frenetic.parts.registry import DRIVERS
from frenetic.plugins.commonroad import CommonRoadSimulator
from frenetic.plugins.third_party.vehicles import FissCar, HighwayEnvCar, OpendbcCar, RoxCar
from frenetic.road import Road
from frenetic.road.classes import RoadClass, classes
from frenetic.search.random_search import RandomSearch

STEADY: dict[str, Any] = {"lateral": 100.0}
"""Options with which a third-party driver does not slow down for bends."""
DRIVERS_OF: dict[str, tuple[str, dict[str, Any], type | None, str]] = {
    "planner": ("planner", {"lateral_acceleration": 100.0}, None, "frenetic"),
    "stanley": ("stanley", {"lateral_acceleration": 100.0}, None, "frenetic"),
    "highway-env": ("highway-env", STEADY, HighwayEnvCar, "highway_env"),
    "opendbc": ("opendbc", STEADY, OpendbcCar, "opendbc"),
    "rox-control": ("rox-control", STEADY, RoxCar, "rox_control"),
    "rox-control, 20 m": ("rox-control", {**STEADY, "look_ahead": 20.0}, RoxCar, "rox_control"),
    "fiss-planner, MPC": ("fiss-planner", STEADY, FissCar, "fiss_planner"),
    "fiss-planner, Stanley": (
        "fiss-planner",
        {**STEADY, "controller": "stanley"},
        FissCar,
        "fiss_planner",
    ),
    "metadrive-expert": ("metadrive-expert", {}, None, "metadrive"),
    "scenic": ("scenic_pid.py:Scenic", STEADY, None, "scenic"),
    "donkeycar": ("line_follower.py:Donkeycar", STEADY, None, "donkeycar"),
}
"""Name -> driver, options, its package's own car, module that it needs."""
CARS = ("embedded", "commonroad", "own")
OWN_SPEED = ("metadrive-expert",)
"""Drivers that drive as fast as they like."""
LADDER = (0.4, 0.55, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5, 1.7, 1.95, 2.2)
"""Speeds, in design speeds of the class."""
LIMIT = LADDER.index(1.0)
FASTEST = 200.0
"""End of every ladder, in km/h."""
LAGS = (0.05, 0.15, 0.3)
"""Time constants of the steering, in s."""
EDGE = Criterion("edge_distance", 0.0, 0.0)
ACCELERATION = Criterion("lateral_acceleration", 0.0, 0.0)
JERK = Criterion("lateral_jerk", 0.0, 0.5)
PATIENCE = 600.0
"""Wall time that a drive may take, in s: no result here is one of how busy the machine is."""
ENGINE: dict[str, float | str] = {"name": "default", "switch_speed": 70.0}
"""The embedded car with an engine that reaches every speed of the ladder on the run-up."""


@dataclass(frozen=True)
class Task:
    """One driver, class, car and lag, on one seed's roads."""

    driver: str
    roads: str
    car: str
    lag: float
    seed: int


@dataclass
class Found:
    """What its drives showed."""

    leaves: float | None = None
    """Speed in km/h at which more than 95 % of the car leaves the lane; None if at none."""
    touches: float | None = None
    """Speed at which a corner does."""
    acceleration: float | None = None
    """Largest lateral acceleration at the design speed, in m/s²."""
    jerk: float | None = None
    """Largest lateral jerk there, in m/s³."""
    causes: list[str] = field(default_factory=list)
    """Causes of the failures at the first speed that has some."""
    usual: list[int] = field(default_factory=list)
    """Of its drives at the design speed: how many leave the lane, touch its edge, and are."""
    drives: int = 0


@dataclass(frozen=True)
class Seen:
    """One drive."""

    leaves: bool
    touches: bool
    cause: str
    acceleration: float
    jerk: float


def class_of(name: str, length: float) -> RoadClass:
    """The class without slopes and widening, which not every car here knows."""
    flat = {"max_grade": 0.0, "max_superelevation": 0.0, "widening": 0.0, "length": length}
    standard = RoadClass.of(name)
    # A flat road of the guidelines' least radius, which follows from the lean.
    return RoadClass.of(name, {**flat, "min_radius": standard.min_radius})


@cache
def roads_of(
    name: str, seed: int, length: float, drawn: int, searched: int, simulations: int
) -> list[tuple[list[float], float, float]]:
    """Curvatures, step and lane width of random roads and of those that a search finds worst."""
    road_class = class_of(name, length)
    strategy = RandomSearch(seed=seed, road_class=road_class)
    candidates = [strategy.ask() for _ in range(drawn)]
    with TemporaryDirectory() as folder:
        speed = 1.3 * road_class.design_speed
        Campaign(
            strategy=Frenetic(seed=seed, road_class=road_class),
            simulator=EmbeddedSimulator(rules=Rules(speed_limit=speed), vehicle=ENGINE),
            driver=Stanley(lateral_acceleration=100.0),
            budget=Budget(simulations=simulations),
            folder=Path(folder) / "c",
            max_in_flight=16,
        ).run()
        with CampaignStore.open(Path(folder) / "c") as store:
            tests = [
                test
                for test in store.tests()
                if test.moobd is not None
                and len(test.candidate.curvatures) * test.candidate.step > 0.6 * length
            ]
    candidates += [t.candidate for t in sorted(tests, key=lambda t: (t.moobd, t.id))[:searched]]
    return [
        ([*candidate.curvatures], candidate.step, road_class.lane_width) for candidate in candidates
    ]


def with_run_up(road: tuple[list[float], float, float], speed: float) -> Road:
    """The road behind a straight on which a car reaches a speed, in m/s."""
    curvatures, step, width = road
    run_up = [0.0] * round((speed * speed / 7.0 + 2.0 * speed) / step)
    return Road(np.array([*run_up, *curvatures]), step, lane_width=width)


def simulator_of(task: Task, rules: Rules) -> Any:
    if task.car == "embedded":
        return EmbeddedSimulator(
            rules=rules, vehicle=ENGINE, steering_lag=task.lag, wall_limit=PATIENCE
        )
    if task.car == "commonroad":
        simulator = CommonRoadSimulator(rules=rules, wall_limit=PATIENCE)
        simulator.steering_lag = task.lag
        return simulator
    simulator_class = DRIVERS_OF[task.driver][2]
    assert simulator_class is not None
    simulator = simulator_class(rules=rules, steering_lag=task.lag)
    simulator.wall_limit = PATIENCE
    return simulator


def drive(task: Task, road: Road, rules: Rules) -> Seen:
    name, options, _, _ = DRIVERS_OF[task.driver]
    with simulator_of(task, rules) as simulator:
        made = simulator.drive(road, DRIVERS.make(name, **options))
    result = judge(road, made)
    if result.outcome is Outcome.ERROR:
        raise RuntimeError(f"{task}: {result.reason}")
    if is_drivers(result.fault):
        return Seen(True, True, f"breaks: {result.reason}"[:90], 0.0, 0.0)
    values = {
        one.criterion: one.value for one in measure_criteria(road, made, (EDGE, ACCELERATION, JERK))
    }
    leaves = result.outcome is Outcome.FAIL
    cause = cause_of(segment_of(road, made, result.finding)) if leaves else None
    return Seen(
        leaves,
        leaves or values[EDGE] < 0.0,
        "" if cause is None else as_text(cause.kind),
        values[ACCELERATION],
        values.get(JERK, 0.0),
    )


def ladder(design_speed: float) -> list[float]:
    """The speeds of a class, in km/h."""
    return [factor * design_speed for factor in LADDER if factor * design_speed <= FASTEST]


def first(fails: Callable[[int], bool], low: int, high: int) -> int:
    """The first place from `low` on that fails, if all behind one that fails do; `high` if none."""
    while low < high:
        middle = (low + high) // 2
        if fails(middle):
            high = middle
        else:
            low = middle + 1
    return low


def assess(task: Task, length: float, drawn: int, searched: int, simulations: int) -> Found:
    """Where on the ladder the driver begins to fail."""
    speeds = ladder(class_of(task.roads, length).design_speed)
    roads = roads_of(task.roads, task.seed, length, drawn, searched, simulations)
    drives = 0

    @cache
    def at(place: int) -> list[Seen]:
        nonlocal drives
        rules, found = Rules(speed_limit=speeds[place]), []
        for road in roads:
            found.append(drive(task, with_run_up(road, speeds[place] / 3.6), rules))
            drives += 1
            if found[-1].leaves and place != LIMIT:
                break
        return found

    usual = at(LIMIT)
    if task.driver in OWN_SPEED:
        speeds = speeds[: LIMIT + 1]
    low = LIMIT if task.driver in OWN_SPEED else 0
    leaves = first(lambda place: any(one.leaves for one in at(place)), low, len(speeds))
    touches = first(lambda place: any(one.touches for one in at(place)), low, len(speeds))
    failed = at(leaves) if leaves < len(speeds) else []
    return Found(
        speeds[leaves] if failed else None,
        speeds[touches] if touches < len(speeds) else None,
        max(one.acceleration for one in usual),
        max(one.jerk for one in usual),
        [one.cause for one in failed if one.leaves],
        [sum(one.leaves for one in usual), sum(one.touches for one in usual), len(usual)],
        drives,
    )


# --- The tables ------------------------------------------------------------------------------


def middle(speeds: list[float | None], top: float) -> str:
    """The median speed; above the ladder's top it is not known."""
    median = statistics.median(2.0 * top if speed is None else speed for speed in speeds)
    return f"> {top:.0f}" if median > top else f"{median:.0f}"


def table(title: str, head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return f"{title}:\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in lines)


def report(results: dict[Task, Found]) -> str:
    """The tables, in Markdown."""
    drivers = [name for name in DRIVERS_OF if any(task.driver == name for task in results)]
    names = [name for name in classes() if any(task.roads == name for task in results)]
    cars = [car for car in CARS if any(task.car == car for task in results)]
    lags = sorted({task.lag for task in results})
    main_class = next((t.roads for t in results if t.car != "embedded"), names[0])

    def of(driver: str, roads: str, car: str, lag: float) -> list[Found]:
        wanted = (driver, roads, car, lag)
        return [f for t, f in results.items() if (t.driver, t.roads, t.car, t.lag) == wanted]

    def cell(what: str, driver: str, roads: str, car: str) -> str:
        top = ladder(RoadClass.of(roads).design_speed)[-1]
        parts = []
        for found in (of(driver, roads, car, lag) for lag in lags):
            if found and driver in OWN_SPEED:
                counts = np.sum([one.usual for one in found], axis=0)
                parts.append(f"{counts[int(what == 'touches')]} of {counts[2]}")
            else:
                parts.append(middle([getattr(f, what) for f in found], top) if found else "-")
        return ", ".join(parts) if any(part != "-" for part in parts) else "-"

    def column(one: list[Found]) -> str:
        worst = (max(getattr(f, what) or 0.0 for f in one) for what in ("acceleration", "jerk"))
        return ", ".join(f"{value:.1f}" for value in worst) if one else "-"

    usual = lags[len(lags) // 2]
    causes = []
    for driver in drivers:
        counts = Counter(
            c for task, f in results.items() if task.driver == driver for c in f.causes
        )
        words = (f"{cause} ({n})" for cause, n in counts.most_common(3))
        causes.append([driver, ", ".join(words) or "-"])
    by_lag = "at lags of " + ", ".join(f"{lag:g}" for lag in lags) + " s"
    told = [
        table(
            f"{title}, km/h, {by_lag}",
            ["driver", *names],
            [[d, *(cell(what, d, name, "embedded") for name in names)] for d in drivers],
        )
        for title, what in (("Leaves its lane", "leaves"), ("A corner leaves its lane", "touches"))
    ]
    told += [
        table(
            f"Leaves its lane in other cars, {main_class}, km/h, {by_lag}",
            ["driver", *cars],
            [[d, *(cell("leaves", d, main_class, car) for car in cars)] for d in drivers],
        ),
        table(
            f"Lateral acceleration, m/s², and jerk, m/s³, at the design speed, lag {usual:g} s",
            ["driver", *names],
            [[d, *(column(of(d, name, "embedded", usual)) for name in names)] for d in drivers],
        ),
        table("What it does wrong where it begins to fail", ["driver", "causes"], causes),
    ]
    return "\n\n".join([*told, f"{sum(f.drives for f in results.values())} drives"])


def read(file: Path) -> dict[Task, Found]:
    """The results in a file that `--out` made."""
    rows = json.loads(file.read_text(encoding="utf-8"))
    keys = Task.__annotations__
    return {
        Task(**{k: row.pop(k) for k in keys}): Found(**row)
        for row in rows  # the rest
    }


def main() -> None:
    here = [name for name, (_, _, _, module) in DRIVERS_OF.items() if find_spec(module)]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--drivers", nargs="*", choices=here, default=here, help="none: only --add")
    parser.add_argument("--classes", nargs="+", choices=list(classes()), default=list(classes()))
    parser.add_argument("--cars", nargs="+", choices=CARS, default=list(CARS))
    parser.add_argument("--lags", nargs="+", type=float, default=list(LAGS), help="s")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--length", type=float, default=500.0, help="m of each road")
    parser.add_argument("--random", type=int, default=1, help="random roads of each seed")
    parser.add_argument("--searched", type=int, default=1, help="searched roads of each seed")
    parser.add_argument("--simulations", type=int, default=60, help="of the search for them")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, help="JSON file of all results")
    parser.add_argument(
        "--add", nargs="+", type=Path, default=[], help="such files, to be shown too"
    )
    asked = parser.parse_args()
    # The one in which all cars drive.
    main_class = "rural-80" if "rural-80" in asked.classes else asked.classes[0]
    tasks = []
    for driver, name, car, lag in product(asked.drivers, asked.classes, asked.cars, asked.lags):
        if car != "embedded" and name != main_class:
            continue
        if car == "own" and DRIVERS_OF[driver][2] is None:
            continue
        # The multi-body car takes a second for twelve: one seed, and one lag.
        is_slow = car == "commonroad"
        if is_slow and lag != asked.lags[len(asked.lags) // 2]:
            continue
        seeds = range(1, 1 + (min(asked.seeds, 2) if is_slow else asked.seeds))
        tasks += [Task(driver, name, car, lag, seed) for seed in seeds]
    terms = (asked.length, asked.random, asked.searched, asked.simulations)
    with ProcessPoolExecutor(asked.workers) as pool:
        running = [pool.submit(assess, task, *terms) for task in tasks]
        results = {task: one.result() for task, one in zip(tasks, running, strict=True)}
    added = {task: found for file in asked.add for task, found in read(file).items()}
    print(report({**results, **added}))
    if asked.out is not None:
        rows = [asdict(task) | asdict(found) for task, found in results.items()]
        asked.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
