"""How well the embedded simulator's model of BeamNG.AI follows recorded drives.

    python benchmarks/beamng_ai.py DATA [--most N]

DATA holds either or both of

- ``beamng_sbft.jsonl``: drives in the competition's setting (aggression 0.7, 70 km/h, 4 m lanes),
  one JSON object a line: ``search``, ``run``, ``curvatures`` (1/m, one every 10 m), ``outcome`` and
  ``max_oob_share``;
- ``beamng_runs/*.json``: trajectories at risk factor 1.5 and 120 km/h on 5 m lanes, tolerance 0.5:
  ``outcome``, ``road_points`` and ``trajectory`` ([t, x, y, z], s and m).

The parameters were fitted on every second run of the first; all that is printed of it is of the
other runs, and gradient boosting (if scikit-learn is installed) learns on the former. A road's
score is the largest oob share of a drive that goes on to its end.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from time import process_time
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.stats import rankdata

from frenetic import BeamngAi, EmbeddedSimulator, Planner, Road, Rules, Stanley, judge
from frenetic.oracle.verdict import assess
from frenetic.road.validity import interpolate

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

RECORDED_POINT: Final = 0.37
"""Distance of the recorded position to the right of the middle of the car's box, in m; fitted."""
START: Final = 20.0
"""Distance within which a failure is a faulty start, in m."""
NEAR: Final = 20.0
"""Largest distance of two places of departure that count as the same, in m."""
SHORT: Final = 50.0
"""Length of a drive up to which its speed has no shape, in m."""
ROADS, ROUNDS = 60, 5
"""Number of random roads whose drives' cost is measured, and of drives of each."""
STEP: Final = 10.0


def points_of(curvatures: FloatArray) -> FloatArray:
    """Road points of a recorded drive, (N, 2) in m: trapezoidal integrals, as its source has it."""
    middle = 0.5 * STEP * (curvatures[1:] + curvatures[:-1])
    heading = 0.5 * np.pi + np.concatenate([[0.0], np.cumsum(middle)])
    columns = []
    for part in (np.cos(heading), np.sin(heading)):
        column = np.concatenate([[0.0], np.cumsum(0.5 * STEP * (part[1:] + part[:-1]))])
        columns.append(column - column.min() + 8.0)
    return np.stack(columns, axis=1)


def auc(score: FloatArray, failed: BoolArray) -> float:
    """ROC AUC of a score against FAIL, ties counted half (Mann-Whitney)."""
    n = int(failed.sum())
    rank_sum = float(rankdata(score)[failed].sum())
    return (rank_sum - n * (n + 1) / 2) / (n * (len(failed) - n))


def row(name: str, score: FloatArray, failed: BoolArray, share: FloatArray) -> str:
    """A row of the table: how well a score orders recorded drives."""
    order = np.argsort(-score, kind="stable")
    found = np.cumsum(failed[order])
    half = (int(np.searchsorted(found, 0.5 * found[-1])) + 1) / len(failed)
    top = failed[order[: len(failed) // 10]].mean() / failed.mean()
    rank = float(np.corrcoef(rankdata(score), rankdata(share))[0, 1])
    return f"{name:<34}{auc(score, failed):>7.3f}{rank:>11.3f}{top:>11.1f}{half:>16.0%}"


def competition(path: Path, most: int | None) -> None:
    """Prints how drivers and features order the drives in the competition's setting."""
    drives = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    names = [f"{drive['search']}/{drive['run']}" for drive in drives]
    fitted = set(sorted(set(names))[::2])
    unseen = [drive for drive, name in zip(drives, names, strict=True) if name not in fitted]
    seen = [drive for drive, name in zip(drives, names, strict=True) if name in fitted]
    unseen = unseen[:most]
    kappa = np.array([drive["curvatures"] for drive in unseen])
    failed = np.array([drive["outcome"] == "FAIL" for drive in unseen])
    share = np.array([drive["max_oob_share"] for drive in unseen])
    print(f"{len(unseen)} drives of runs that nothing was fitted on, {failed.sum()} FAIL")
    print(f"{'ordered by':<34}{'AUC':>7}{'rank corr.':>11}{'top tenth':>11}{'half found in':>16}")
    features: dict[str, Callable[[FloatArray], FloatArray]] = {
        "largest |curvature|": lambda k: np.abs(k).max(axis=1),
        "mean |curvature|": lambda k: np.abs(k).mean(axis=1),
    }
    for name, feature in features.items():
        print(row(name, feature(kappa), failed, share))
    if (boosted := boosting(seen, kappa)) is not None:
        print(row("gradient boosting of curvatures", boosted, failed, share))
    roads = [Road.from_points(interpolate(points_of(one))) for one in kappa]
    rules = Rules(oob_tolerance=1.0)
    for name, driver, vehicle in (
        ("Planner", Planner(), "default"),
        ("Stanley", Stanley(), "default"),
        ("BeamngAi, etk800", BeamngAi(), "etk800"),
    ):
        simulator = EmbeddedSimulator(rules=rules, vehicle=vehicle)
        results = [judge(road, simulator.drive(road, driver)) for road in roads]
        score = np.array([result.max_oob_share or 0.0 for result in results])
        print(row(name, score, failed, share), flush=True)


def boosting(seen: list[dict[str, Any]], kappa: FloatArray) -> FloatArray | None:
    """Oob shares that gradient boosting forecasts; None without scikit-learn."""
    try:
        ensemble = import_module("sklearn.ensemble")  # not a dependency
    except ImportError:
        print("(gradient boosting is left out: pip install scikit-learn)")
        return None

    def columns(k: FloatArray) -> FloatArray:
        size = np.abs(k)
        few = [size.max(axis=1), size.mean(axis=1), k.mean(axis=1), k.std(axis=1)]
        return np.concatenate([k, size, np.diff(k, axis=1), np.stack(few, axis=1)], axis=1)

    model = ensemble.HistGradientBoostingRegressor(
        max_iter=200, learning_rate=0.05, max_leaf_nodes=8, min_samples_leaf=30, random_state=0
    )
    model.fit(
        columns(np.array([drive["curvatures"] for drive in seen])),
        np.array([drive["max_oob_share"] for drive in seen]),
    )
    forecast: FloatArray = model.predict(columns(kappa))
    return forecast


def speed_shapes(
    ours: tuple[FloatArray, FloatArray], theirs: tuple[FloatArray, FloatArray], end: float
) -> tuple[float, float]:
    """Correlation and median difference of two speeds, each over its mean, every 10 m.

    Args:
        ours: (n,) places in m and (n,) times in s.
        theirs: likewise.
        end: of what is compared, in m.
    """
    at = np.arange(STEP, end, STEP)
    both = []
    for place, time in (ours, theirs):
        furthest = np.maximum.accumulate(place)
        passed = np.interp(at, furthest, time)
        speed = STEP / np.maximum(np.diff(passed), 1e-3)
        both.append(speed / speed.mean())
    return float(np.corrcoef(*both)[0, 1]), float(np.median(np.abs(both[0] - both[1])))


def trajectories(folder: Path, most: int | None) -> None:
    """Prints how far the model is off the recorded trajectories."""
    simulator = EmbeddedSimulator(
        rules=Rules(speed_limit=120.0, oob_tolerance=1.0), vehicle="etk800"
    )
    driver = BeamngAi(aggression=1.5)
    errors, scores, failures, gaps, used = [], [], [], [], 0
    lengths, shapes = [], []
    for file in sorted(folder.glob("*.json"))[:most]:
        data = json.loads(file.read_text(encoding="utf-8"))
        road = Road.from_points(data["road_points"], lane_width=5.0)
        place, offset = road.track(np.array(data["trajectory"], dtype=np.float64)[:, 1:3]).T
        offset = offset + 2.5
        failed = data["outcome"] == "FAIL"
        if failed and place[-1] < START:
            continue
        used += 1
        drive = simulator.drive(road, driver)
        seen = assess(road, drive)
        out = np.flatnonzero(np.abs(offset) > 2.5)
        end = min(place.max(), seen.distance.max(), place[out[0]] if len(out) else np.inf)
        at = np.arange(3.0, end)
        ours, theirs = (
            np.interp(at, s[np.argsort(s)], d[np.argsort(s)])
            for s, d in ((seen.distance, seen.lateral_offset - RECORDED_POINT), (place, offset))
        )
        errors.append(float(np.median(np.abs(ours - theirs))))
        if end > SHORT:
            shapes.append(
                speed_shapes(
                    (seen.distance, drive.trajectory.time[: len(seen.distance)]),
                    (place, np.array(data["trajectory"], dtype=np.float64)[:, 0]),
                    end,
                )
            )
        scores.append(float(seen.oob_share.max()))
        failures.append(failed)
        lengths.append(road.length)
        left = np.flatnonzero(seen.oob_share > 0.5)
        if failed and len(out) and len(left):
            gaps.append(abs(float(place[out[0]] - seen.distance[left[0]])))
    near = sum(gap <= NEAR for gap in gaps)
    print(
        f"\n{used} trajectories: median over drives of the median lateral error"
        f" {np.median(errors):.2f} m; {len(gaps)} common failures, {near} within {NEAR:g} m;"
        f" AUC {auc(np.array(scores), np.array(failures)):.3f}"
    )
    alike, apart = np.median(shapes, axis=0)
    print(
        f"shape of the speed: correlation {alike:.2f}, difference {apart:.0%} of the mean speed,"
        " medians over drives"
    )
    print(f"AUC of the road's length alone: {auc(np.array(lengths), np.array(failures)):.3f}")


def cost() -> None:
    """Prints what 250 m cost, beside the planner in its car and in the model's."""
    rng = np.random.default_rng(0)
    steps = rng.uniform(-0.05, 0.05, (ROADS, 26))
    roads = [Road(np.clip(np.cumsum(row), -0.07, 0.07)) for row in steps]
    for name, driver, vehicle in (
        ("Planner", Planner(), "default"),
        ("Planner, etk800", Planner(), "etk800"),
        ("BeamngAi, etk800", BeamngAi(), "etk800"),
    ):
        simulator = EmbeddedSimulator(rules=Rules(oob_tolerance=1.0), vehicle=vehicle)
        simulator.drive(roads[0], driver)  # compiles
        costs = []
        for road in roads:
            taken = []
            for _ in range(ROUNDS):
                start = process_time()
                path = simulator.drive(road, driver).trajectory
                taken.append(process_time() - start)
            driven = float(np.hypot(np.diff(path.x), np.diff(path.y)).sum())
            costs.append(250e3 * min(taken) / driven)
        print(f"{name:<20} {np.mean(costs):5.2f} ms of CPU per 250 m")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--most", type=int, metavar="N", help="Of each, only the first N.")
    options = parser.parse_args()
    drives, runs = options.data / "beamng_sbft.jsonl", options.data / "beamng_runs"
    if not drives.is_file() and not runs.is_dir():
        print(f"beamng_ai: {options.data} has neither {drives.name} nor {runs.name}/; see --help")
        return 2
    if drives.is_file():
        competition(drives, options.most)
    if runs.is_dir():
        trajectories(runs, options.most)
    cost()
    return 0


if __name__ == "__main__":
    sys.exit(main())
