"""The speed at which real drivers begin to fail: by road class, steering lag, car and tolerance.

    python benchmarks/real_drivers.py                     # ten minutes on two cores
    python benchmarks/real_drivers.py --seeds 2 --classes rural-80 --cars embedded   # half a minute

All drivers get the same roads. Each seed has random roads, and the roads of a search on which our
own `stanley` comes nearest to its lane's edge. Drivers that take a speed keep the speed limit, even
in bends. Bisection finds the first speed of a ladder at which the driver fails on one of the roads;
a cell has the median over the seeds, for each lag. A car leaves its lane when more than 95 % of the
car is outside.

Scenic and donkeycar need environments of their own, with the files of ``docs/real-drivers.md`` in
the current folder. Drive them there with ``--out FILE``; then show the results with ``--add FILE``.
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
from frenetic.segments.causes import as_text, cause_of
from frenetic.segments.segment import segment_of

NO_SLOWING: dict[str, Any] = {"lateral": 100.0}
"""Options with which a third-party driver does not slow down for bends."""
DRIVERS_OF: dict[str, tuple[str, dict[str, Any], type | None, str]] = {
    "planner": ("planner", {"lateral_acceleration": 100.0}, None, "frenetic"),
    "stanley": ("stanley", {"lateral_acceleration": 100.0}, None, "frenetic"),
    "highway-env": ("highway-env", NO_SLOWING, HighwayEnvCar, "highway_env"),
    "opendbc": ("opendbc", NO_SLOWING, OpendbcCar, "opendbc"),
    "rox-control": ("rox-control", NO_SLOWING, RoxCar, "rox_control"),
    "rox-control, 20 m": ("rox-control", {**NO_SLOWING, "look_ahead": 20.0}, RoxCar, "rox_control"),
    "fiss-planner, MPC": ("fiss-planner", NO_SLOWING, FissCar, "fiss_planner"),
    "fiss-planner, Stanley": (
        "fiss-planner",
        {**NO_SLOWING, "controller": "stanley"},
        FissCar,
        "fiss_planner",
    ),
    "metadrive-expert": ("metadrive-expert", {}, None, "metadrive"),
    "scenic": ("scenic_pid.py:Scenic", NO_SLOWING, None, "scenic"),
    "donkeycar": ("line_follower.py:Donkeycar", NO_SLOWING, None, "donkeycar"),
}
"""Name -> driver, options, the package's own car, module that the driver needs."""
CARS = ("embedded", "commonroad", "own")
OWN_SPEED = ("metadrive-expert",)
"""Drivers that choose their speed themselves."""
LADDER = (0.4, 0.55, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5, 1.7, 1.95, 2.2)
"""Speeds, per design speed of the class."""
DESIGN_RUNG = LADDER.index(1.0)
"""Index of the design speed on the ladder."""
FASTEST = 200.0
"""End of every ladder, in km/h."""
LAGS = (0.05, 0.15, 0.3)
"""Time constants of the steering, in s."""
EDGE = Criterion("edge_distance", 0.0, 0.0)
ACCELERATION = Criterion("lateral_acceleration", 0.0, 0.0)
JERK = Criterion("lateral_jerk", 0.0, 0.5)
WALL_LIMIT = 600.0
"""Wall time that a drive may take, in s: so long that a busy machine changes no result."""
ENGINE: dict[str, float | str] = {"name": "default", "switch_speed": 70.0}
"""The embedded car with an engine that reaches every speed of the ladder on the run-up."""


@dataclass(frozen=True)
class Task:
    """A driver in a class, a car and a lag, on the roads of a seed."""

    driver: str
    roads: str
    car: str
    lag: float
    seed: int


@dataclass
class TaskResult:
    """Results of the drives of a task."""

    leaves: float | None = None
    """Lowest speed in km/h at which more than 95 % of the car leaves the lane; None if none."""
    touches: float | None = None
    """Lowest speed in km/h at which a corner of the car leaves the lane; None if none."""
    acceleration: float | None = None
    """Largest lateral acceleration at the design speed, in m/s²."""
    jerk: float | None = None
    """Largest lateral jerk at the design speed, in m/s³."""
    causes: list[str] = field(default_factory=list)
    """Causes of the failures at the speed `leaves`."""
    design_speed_counts: list[int] = field(default_factory=list)
    """Counts at the design speed: drives that leave the lane, that touch its edge, all drives."""
    drives: int = 0
    """Number of all drives."""


@dataclass(frozen=True)
class DriveResult:
    """Result of a drive."""

    leaves: bool
    """Whether more than 95 % of the car left the lane."""
    touches: bool
    """Whether a corner of the car left the lane."""
    cause: str
    """Cause of the failure; empty if there is none."""
    acceleration: float
    """Largest lateral acceleration, in m/s²."""
    jerk: float
    """Largest lateral jerk, in m/s³."""


def class_of(name: str, length: float) -> RoadClass:
    """Return a road class without slopes and widening, because not every car here knows them."""
    flat = {"max_grade": 0.0, "max_superelevation": 0.0, "widening": 0.0, "length": length}
    standard = RoadClass.of(name)
    # The least radius follows from the superelevation: keep the radius of the standard class.
    return RoadClass.of(name, {**flat, "min_radius": standard.min_radius})


@cache
def roads_of(
    name: str, seed: int, length: float, drawn: int, searched: int, simulations: int
) -> list[tuple[list[float], float, float]]:
    """Return curvatures, step and lane width of random roads, and of the worst of a search."""
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
    """Return the road after a straight on which a car reaches a speed, in m/s."""
    curvatures, step, width = road
    run_up = [0.0] * round((speed * speed / 7.0 + 2.0 * speed) / step)
    return Road(np.array([*run_up, *curvatures]), step, lane_width=width)


def simulator_of(task: Task, rules: Rules) -> Any:
    """Return the simulator of a task's car, with the task's steering lag."""
    if task.car == "embedded":
        return EmbeddedSimulator(
            rules=rules, vehicle=ENGINE, steering_lag=task.lag, wall_limit=WALL_LIMIT
        )
    if task.car == "commonroad":
        simulator = CommonRoadSimulator(rules=rules, wall_limit=WALL_LIMIT)
        simulator.steering_lag = task.lag
        return simulator
    simulator_class = DRIVERS_OF[task.driver][2]
    assert simulator_class is not None
    simulator = simulator_class(rules=rules, steering_lag=task.lag)
    simulator.wall_limit = WALL_LIMIT
    return simulator


def drive(task: Task, road: Road, rules: Rules) -> DriveResult:
    """Drive a road, and return the result."""
    name, options, _, _ = DRIVERS_OF[task.driver]
    with simulator_of(task, rules) as simulator:
        record = simulator.drive(road, DRIVERS.make(name, **options))
    result = judge(road, record)
    if result.outcome is Outcome.ERROR:
        raise RuntimeError(f"{task}: {result.reason}")
    if is_drivers(result.fault):
        return DriveResult(True, True, f"breaks: {result.reason}"[:90], 0.0, 0.0)
    criteria = (EDGE, ACCELERATION, JERK)
    values = {
        measured.criterion: measured.value for measured in measure_criteria(road, record, criteria)
    }
    leaves = result.outcome is Outcome.FAIL
    cause = cause_of(segment_of(road, record, result.finding)) if leaves else None
    return DriveResult(
        leaves,
        leaves or values[EDGE] < 0.0,
        "" if cause is None else as_text(cause.kind),
        values[ACCELERATION],
        values.get(JERK, 0.0),
    )


def ladder(design_speed: float) -> list[float]:
    """Return the speeds of a class's ladder, in km/h."""
    return [factor * design_speed for factor in LADDER if factor * design_speed <= FASTEST]


def first(fails: Callable[[int], bool], low: int, high: int) -> int:
    """Return the first rung from `low` on that fails; `high` if none fails.

    All rungs above a rung that fails are taken to fail.
    """
    while low < high:
        middle = (low + high) // 2
        if fails(middle):
            high = middle
        else:
            low = middle + 1
    return low


def assess(task: Task, length: float, drawn: int, searched: int, simulations: int) -> TaskResult:
    """Find where on the ladder the driver begins to fail."""
    speeds = ladder(class_of(task.roads, length).design_speed)
    roads = roads_of(task.roads, task.seed, length, drawn, searched, simulations)
    drives = 0

    @cache
    def at(rung: int) -> list[DriveResult]:
        """Drive the roads at a speed of the ladder, up to the first failure."""
        nonlocal drives
        rules, results = Rules(speed_limit=speeds[rung]), []
        for road in roads:
            results.append(drive(task, with_run_up(road, speeds[rung] / 3.6), rules))
            drives += 1
            if results[-1].leaves and rung != DESIGN_RUNG:
                break
        return results

    at_design_speed = at(DESIGN_RUNG)
    if task.driver in OWN_SPEED:
        speeds = speeds[: DESIGN_RUNG + 1]
    low = DESIGN_RUNG if task.driver in OWN_SPEED else 0
    leaves = first(lambda rung: any(result.leaves for result in at(rung)), low, len(speeds))
    touches = first(lambda rung: any(result.touches for result in at(rung)), low, len(speeds))
    failed = at(leaves) if leaves < len(speeds) else []
    return TaskResult(
        speeds[leaves] if failed else None,
        speeds[touches] if touches < len(speeds) else None,
        max(result.acceleration for result in at_design_speed),
        max(result.jerk for result in at_design_speed),
        [result.cause for result in failed if result.leaves],
        [
            sum(r.leaves for r in at_design_speed),
            sum(r.touches for r in at_design_speed),
            len(at_design_speed),
        ],
        drives,
    )


# --- The tables ------------------------------------------------------------------------------


def middle(speeds: list[float | None], top: float) -> str:
    """Return the median speed as a text; above the ladder's top the speed is not known."""
    median = statistics.median(2.0 * top if speed is None else speed for speed in speeds)
    return f"> {top:.0f}" if median > top else f"{median:.0f}"


def table(title: str, head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table with a title."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return f"{title}:\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in lines)


def report(results: dict[Task, TaskResult]) -> str:
    """Return the tables, in Markdown."""
    drivers = [name for name in DRIVERS_OF if any(task.driver == name for task in results)]
    names = [name for name in classes() if any(task.roads == name for task in results)]
    cars = [car for car in CARS if any(task.car == car for task in results)]
    lags = sorted({task.lag for task in results})
    main_class = next((t.roads for t in results if t.car != "embedded"), names[0])

    def of(driver: str, roads: str, car: str, lag: float) -> list[TaskResult]:
        """Return the results of all seeds."""
        wanted = (driver, roads, car, lag)
        return [r for t, r in results.items() if (t.driver, t.roads, t.car, t.lag) == wanted]

    def speed_cell(event: str, driver: str, roads: str, car: str) -> str:
        """Return the median speed of an event, ``leaves`` or ``touches``, for each lag."""
        top = ladder(RoadClass.of(roads).design_speed)[-1]
        parts = []
        for by_seed in (of(driver, roads, car, lag) for lag in lags):
            if by_seed and driver in OWN_SPEED:
                counts = np.sum([result.design_speed_counts for result in by_seed], axis=0)
                parts.append(f"{counts[int(event == 'touches')]} of {counts[2]}")
            else:
                speeds = [getattr(result, event) for result in by_seed]
                parts.append(middle(speeds, top) if by_seed else "-")
        return ", ".join(parts) if any(part != "-" for part in parts) else "-"

    def comfort_cell(by_seed: list[TaskResult]) -> str:
        """Return the largest lateral acceleration and jerk."""
        worst = (max(getattr(r, name) or 0.0 for r in by_seed) for name in ("acceleration", "jerk"))
        return ", ".join(f"{value:.1f}" for value in worst) if by_seed else "-"

    middle_lag = lags[len(lags) // 2]
    causes = []
    for driver in drivers:
        counts = Counter(
            cause
            for task, result in results.items()
            if task.driver == driver
            for cause in result.causes
        )
        texts = (f"{cause} ({n})" for cause, n in counts.most_common(3))
        causes.append([driver, ", ".join(texts) or "-"])
    by_lag = "at lags of " + ", ".join(f"{lag:g}" for lag in lags) + " s"
    car_leaves = "Speed at which more than 95 % of the car leaves the lane"
    tables = [
        table(
            f"{title}, km/h, {by_lag}",
            ["driver", *names],
            [[d, *(speed_cell(event, d, name, "embedded") for name in names)] for d in drivers],
        )
        for title, event in (
            (car_leaves, "leaves"),
            ("Speed at which a corner of the car leaves the lane", "touches"),
        )
    ]
    tables += [
        table(
            f"{car_leaves} in other cars, {main_class}, km/h, {by_lag}",
            ["driver", *cars],
            [[d, *(speed_cell("leaves", d, main_class, car) for car in cars)] for d in drivers],
        ),
        table(
            "Largest lateral acceleration, m/s², and jerk, m/s³, at the design speed,"
            f" lag {middle_lag:g} s",
            ["driver", *names],
            [
                [d, *(comfort_cell(of(d, name, "embedded", middle_lag)) for name in names)]
                for d in drivers
            ],
        ),
        table(
            "What the driver does wrong at the speed at which it begins to fail",
            ["driver", "causes"],
            causes,
        ),
    ]
    return "\n\n".join([*tables, f"{sum(r.drives for r in results.values())} drives"])


def read(file: Path) -> dict[Task, TaskResult]:
    """Return the results in a file that `--out` wrote."""
    rows = json.loads(file.read_text(encoding="utf-8"))
    keys = Task.__annotations__
    # A row has the fields of the task and of the result: take out the task's fields first.
    return {Task(**{key: row.pop(key) for key in keys}): TaskResult(**row) for row in rows}


def main() -> None:
    """Drive what the options choose, and print the tables."""
    here = [name for name, (_, _, _, module) in DRIVERS_OF.items() if find_spec(module)]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--drivers", nargs="*", choices=here, default=here, help="without a name: only --add"
    )
    parser.add_argument("--classes", nargs="+", choices=list(classes()), default=list(classes()))
    parser.add_argument("--cars", nargs="+", choices=CARS, default=list(CARS))
    parser.add_argument("--lags", nargs="+", type=float, default=list(LAGS), help="in s")
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds")
    parser.add_argument("--length", type=float, default=500.0, help="of each road, in m")
    parser.add_argument("--random", type=int, default=1, help="random roads of each seed")
    parser.add_argument("--searched", type=int, default=1, help="searched roads of each seed")
    parser.add_argument("--simulations", type=int, default=60, help="of the search for these roads")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, help="JSON file for the results")
    parser.add_argument(
        "--add", nargs="+", type=Path, default=[], help="files of --out, to show their results, too"
    )
    options = parser.parse_args()
    # All cars drive on roads of this class.
    main_class = "rural-80" if "rural-80" in options.classes else options.classes[0]
    tasks = []
    for driver, name, car, lag in product(
        options.drivers, options.classes, options.cars, options.lags
    ):
        if car != "embedded" and name != main_class:
            continue
        if car == "own" and DRIVERS_OF[driver][2] is None:
            continue
        # The multi-body car is slow: two seeds at most, and one lag.
        is_slow = car == "commonroad"
        if is_slow and lag != options.lags[len(options.lags) // 2]:
            continue
        seeds = range(1, 1 + (min(options.seeds, 2) if is_slow else options.seeds))
        tasks += [Task(driver, name, car, lag, seed) for seed in seeds]
    terms = (options.length, options.random, options.searched, options.simulations)
    with ProcessPoolExecutor(options.workers) as pool:
        running = [pool.submit(assess, task, *terms) for task in tasks]
        results = {task: future.result() for task, future in zip(tasks, running, strict=True)}
    added = {task: result for file in options.add for task, result in read(file).items()}
    print(report({**results, **added}))
    if options.out is not None:
        rows = [asdict(task) | asdict(result) for task, result in results.items()]
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
