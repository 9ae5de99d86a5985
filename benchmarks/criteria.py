"""Which built-in drivers meet which criteria, and whether a search by a criterion finds more.

    python benchmarks/criteria.py drivers
    python benchmarks/criteria.py search
    python benchmarks/criteria.py agreement

``drivers`` drives the same random roads of a class with each driver, and judges each drive by every
set of criteria. ``search`` compares `frenetic` with `random` by the worst value that each search
finds, over ten seeds (A12: 0.5 is no difference; 1: `frenetic` always finds a worse value).
``agreement`` judges drives a second time, by plain loops over their records and by shapely.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from tempfile import TemporaryDirectory

import numpy as np
from shapely import LineString, Point, Polygon, segmentize

from frenetic import Budget, Campaign, EmbeddedSimulator, Frenetic, Outcome, Planner, RandomSearch
from frenetic.analysis.statistics import a12
from frenetic.campaign.objective import Objective
from frenetic.criteria.criterion import CriteriaSet, criteria_sets, signal_named
from frenetic.drivers import BeamngAi, Driver, Stanley
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive, Rules
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.road.classes import RoadClass
from frenetic.search import Strategy

DRIVERS: dict[str, Driver] = {
    "planner": Planner(),
    "planner, 2.5 m/s²": Planner(lateral_acceleration=2.5, braking=2.0),
    "stanley": Stanley(),
    "beamng-ai": BeamngAi(),
}
SPACING = 0.1
"""Distance between the points of a lane's edge, in m."""
OBJECTIVES = ("lateral-jerk", "edge-distance", "lateral-acceleration")
SEEDS = range(10)


def class_of(name: str) -> RoadClass | None:
    """Return the road class; None for the competition's roads."""
    return None if name == "competition" else RoadClass.of(name)


def random_roads(name: str, number: int, seed: int = 1) -> list[Road]:
    """Return random roads of a class."""
    road_class = class_of(name)
    strategy = RandomSearch(seed=seed, road_class=road_class)
    width = 4.0 if road_class is None else road_class.lane_width
    return [strategy.ask().road(width, road_class=road_class) for _ in range(number)]


def with_criteria(drive: Drive, criteria_set: CriteriaSet) -> Drive:
    """Return the drive with other criteria in its rules."""
    return replace(drive, rules=replace(drive.rules, criteria=criteria_set))


def drivers(roads: int) -> None:
    """Print the share of random roads that each driver passes by each set of criteria."""
    for name in ("competition", "rural-80", "motorway-130"):
        road_class = class_of(name)
        rules = Rules() if road_class is None else Rules(speed_limit=road_class.speed_limit)
        simulator = EmbeddedSimulator(rules=rules)
        class_roads = random_roads(name, roads)
        print(f"| roads: {name} | {' | '.join(criteria_sets())} |")
        print("| --- |" + " ---: |" * len(criteria_sets()))
        for driver_name, driver in DRIVERS.items():
            drives = [simulator.drive(road, driver) for road in class_roads]
            shares = []
            for criteria_set in criteria_sets().values():
                passed = (
                    judge(road, with_criteria(drive, criteria_set)).outcome is Outcome.PASS
                    for road, drive in zip(class_roads, drives, strict=True)
                )
                shares.append(f"{sum(passed) / roads:.0%}")
            print(f"| {driver_name} | {' | '.join(shares)} |")
        print()


def worst_of(strategy: Strategy, objective: str, name: str, simulations: int) -> float:
    """Return the worst value that a search finds; lower is worse."""
    road_class = class_of(name)
    rules = Rules() if road_class is None else Rules(speed_limit=road_class.speed_limit)
    measure = Objective.load(objective)
    values: list[float] = []
    sign = -1.0 if measure.higher_is_worse else 1.0
    with TemporaryDirectory() as folder:
        campaign = Campaign(
            strategy=strategy,
            simulator=EmbeddedSimulator(rules=rules),
            driver=Planner(lateral_acceleration=2.5, braking=2.0),
            budget=Budget(simulations=simulations),
            folder=folder,
            objective=objective,
            max_in_flight=1,
        )

        def on_event(event: object) -> None:
            test = getattr(event, "test", None)
            if test is not None and test.objective is not None:
                values.append(sign * test.objective)

        campaign.run(on_event=on_event)
    return min(values)


def search(simulations: int) -> None:
    """Print A12 of the worst values of Frenetic's search against the worst of random roads."""
    print("| roads | objective | frenetic, median | random, median | A12 |")
    print("| --- | --- | ---: | ---: | ---: |")
    for name in ("competition", "rural-80"):
        for objective in OBJECTIVES:
            values_of: dict[str, list[float]] = {}
            for strategy in (Frenetic, RandomSearch):
                values_of[strategy.__name__] = [
                    worst_of(
                        strategy(seed=seed, road_class=class_of(name)), objective, name, simulations
                    )
                    for seed in SEEDS
                ]
            first, second = values_of.values()
            higher = Objective.load(objective).higher_is_worse
            medians = [abs(np.median(v)) if higher else np.median(v) for v in (first, second)]
            effect = a12([-value for value in first], [-value for value in second])
            print(f"| {name} | {objective} | {medians[0]:.2f} | {medians[1]:.2f} | {effect:.2f} |")


# --- A second computation, by plain loops ----------------------------------------------------


def broken_by_loops(
    road: Road, drive: Drive, criteria_set: CriteriaSet, edge_distances: list[float]
) -> set[str]:
    """Return the criteria that a drive breaks, computed by plain loops."""
    n = len(assess(road, drive).distance)
    path = drive.trajectory
    time = path.time[:n].tolist()
    dt = time[1] - time[0]

    def slope(values: list[float]) -> list[float]:
        inner = [(b - a) / (2.0 * dt) for a, b in zip(values, values[2:], strict=False)]
        first, last = (values[1] - values[0]) / dt, (values[-1] - values[-2]) / dt
        return [first, *inner, last]

    speed, lateral_speed = path.speed[:n].tolist(), path.lateral_speed[:n].tolist()
    yaw_rate = path.yaw_rate[:n].tolist()
    lateral = [v * w + a for v, w, a in zip(speed, yaw_rate, slope(lateral_speed), strict=True)]
    forward = [a - v * w for a, v, w in zip(slope(speed), lateral_speed, yaw_rate, strict=True)]
    broken = set()
    for criterion in criteria_set.criteria:
        k = round(criterion.window / dt)
        values: list[float] = []
        if criterion.signal == "lateral_acceleration":
            values = [abs(a) for a in lateral]
        elif criterion.signal == "lateral_jerk":
            values = [
                abs(b - a) / criterion.window for a, b in zip(lateral, lateral[k:], strict=False)
            ]
        elif criterion.signal == "deceleration":
            values = [-a for a in forward]
        elif criterion.signal == "speed_excess":
            values = [3.6 * v - drive.rules.speed_limit for v in speed]
        elif criterion.signal == "sway":
            offsets = assess(road, drive).lateral_offset.tolist()
            values = [
                max(offsets[max(0, i - k) : i + 1]) - min(offsets[max(0, i - k) : i + 1])
                for i in range(n)
            ]
        elif criterion.signal == "edge_distance":
            values = [-distance for distance in edge_distances]
        else:
            raise AssertionError(criterion.signal)
        limit = -criterion.limit if signal_named(criterion.signal).is_least else criterion.limit
        if values and max(values) > limit:
            broken.add(criterion.signal)
    return broken


def edge_distances_of(road: Road, drive: Drive) -> list[float]:
    """Return distances of the car's outline from its lane's edges, by shapely; outside negative."""
    path, car, assessment = drive.trajectory, drive.car, assess(road, drive)
    ends = [(np.cos(h), np.sin(h)) for h in (road.pose[2], road.pose_at(road.length)[2])]
    ahead = np.arange(1, 200)[:, None] * SPACING
    edges = []
    for offset in (0.0, -road.lane_width):
        line = road.sample(SPACING, offset)
        # The lane goes straight on beyond both ends, where parts of a car may be.
        before, after = line[0] - ahead[::-1] * ends[0], line[-1] + ahead * ends[1]
        edges.append(np.vstack([before, line, after]))
    corners = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    distances = []
    for i, place in enumerate(assessment.distance):
        cos, sin = np.cos(path.heading[i]), np.sin(path.heading[i])
        outline = [
            (0.5 * a * car.length + car.centre_ahead, 0.5 * b * car.width) for a, b in corners
        ]
        box = Polygon(
            (path.x[i] + cos * a - sin * b, path.y[i] + sin * a + cos * b) for a, b in outline
        )
        middle = round(place / SPACING) + 199
        near = slice(max(middle - 150, 0), middle + 150)
        sides = [LineString(edge[near]) for edge in edges]
        lane = Polygon(np.vstack([edges[0][near], edges[1][near][::-1]]))
        if lane.contains(box):
            distances.append(min(side.distance(box) for side in sides))
            continue
        # In a bend, the car's straight side may be furthest out between two corners.
        outline_points = segmentize(box, 0.02).exterior.coords
        points = [p for p in map(Point, outline_points) if not lane.covers(p)]
        distances.append(-max((min(s.distance(p) for s in sides) for p in points), default=0.0))
    return distances


def agreement(number: int) -> None:
    """Print the drives on which both computations disagree about the broken criteria."""
    counts: Counter[str] = Counter()
    per = number // (2 * len(DRIVERS))
    for name in ("competition", "rural-80"):
        road_class = class_of(name)
        rules = Rules() if road_class is None else Rules(speed_limit=road_class.speed_limit)
        simulator = EmbeddedSimulator(rules=rules)
        for k, driver in enumerate(DRIVERS.values()):
            for road in random_roads(name, per, seed=k):
                drive = simulator.drive(road, driver)
                edge_distances = edge_distances_of(road, drive)
                counts["drives"] += 1
                for criteria_set in criteria_sets().values():
                    judged = with_criteria(drive, criteria_set)
                    names = {finding.criterion for finding in judge(road, judged).findings} - {
                        "lane"
                    }
                    counts["verdicts"] += 1
                    counts["broken"] += bool(names)
                    looped = broken_by_loops(road, judged, criteria_set, edge_distances)
                    if names != looped:
                        counts["disagreements"] += 1
                        print(name, criteria_set.name, names ^ looped)
    columns = ("drives", "verdicts", "broken", "disagreements")
    print(", ".join(f"{counts[column]} {column}" for column in columns))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("benchmark", choices=("drivers", "search", "agreement"))
    parser.add_argument("--number", type=int, help="number of roads, simulations or drives")
    options = parser.parse_args()
    benchmarks = {
        "drivers": (drivers, 100),
        "search": (search, 200),
        "agreement": (agreement, 1000),
    }
    run, number = benchmarks[options.benchmark]
    run(options.number or number)


if __name__ == "__main__":
    main()
