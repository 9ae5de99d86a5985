"""How well the embedded simulator's model of BeamNG.AI follows recorded drives.

    python benchmarks/beamng_ai.py DATA [--most N]

The folder DATA holds one or both of

- ``beamng_sbft.jsonl``: drives in the competition's setting (aggression 0.7, 70 km/h, 4 m lanes),
  one JSON object a line: ``search``, ``run``, ``curvatures`` (1/m, one every 10 m), ``outcome`` and
  ``max_oob_share``;
- ``beamng_runs/*.json``: trajectories at risk factor 1.5 and 120 km/h on 5 m lanes, tolerance 0.5:
  ``outcome``, ``road_points`` and ``trajectory`` ([t, x, y, z], s and m).

The model's parameters were fitted on every second run of ``beamng_sbft.jsonl``. The figures are of
the other runs. Gradient boosting, if scikit-learn is installed, learns from the runs of the fit. A
road's score is the largest oob share of a drive that continues to the road's end.
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
from frenetic.oracle.assessment import assess
from frenetic.road.validity import interpolate
from frenetic.simulators.embedded import compile_kernels

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

RECORDED_POINT: Final = 0.37
"""Distance of the recorded position to the right of the middle of the car's box, in m; fitted."""
FAULTY_START: Final = 20.0
"""Distance within which a failure is a faulty start, in m."""
SAME_PLACE: Final = 20.0
"""Largest distance of two departures that count as the same place, in m."""
SHORTEST: Final = 50.0
"""Length of a drive up to which its speeds are not compared, in m."""
COST_ROADS: Final = 60
"""Number of random roads on which the cost of drives is measured."""
COST_ROUNDS: Final = 5
"""Number of drives on each of these roads."""
STEP: Final = 10.0
"""Distance between curvatures, and between compared speeds, in m."""


def points_of(curvatures: FloatArray) -> FloatArray:
    """Return the road points of a recorded drive, (N, 2) in m: trapezoidal integrals, as RILaST's.

    The road starts with heading pi/2; its smallest x and y are 8 m.
    """
    middle = 0.5 * STEP * (curvatures[1:] + curvatures[:-1])
    heading = 0.5 * np.pi + np.concatenate([[0.0], np.cumsum(middle)])
    columns = []
    for part in (np.cos(heading), np.sin(heading)):
        column = np.concatenate([[0.0], np.cumsum(0.5 * STEP * (part[1:] + part[:-1]))])
        columns.append(column - column.min() + 8.0)
    return np.stack(columns, axis=1)


def auc(score: FloatArray, failed: BoolArray) -> float:
    """Return the ROC AUC of a score against FAIL; ties count half (Mann-Whitney)."""
    n = int(failed.sum())
    rank_sum = float(rankdata(score)[failed].sum())
    return (rank_sum - n * (n + 1) / 2) / (n * (len(failed) - n))


def row(name: str, score: FloatArray, failed: BoolArray, share: FloatArray) -> str:
    """Return a row of the table: how well a score orders recorded drives."""
    order = np.argsort(-score, kind="stable")
    failures = np.cumsum(failed[order])
    half = (int(np.searchsorted(failures, 0.5 * failures[-1])) + 1) / len(failed)
    top = failed[order[: len(failed) // 10]].mean() / failed.mean()
    rank = float(np.corrcoef(rankdata(score), rankdata(share))[0, 1])
    return f"{name:<34}{auc(score, failed):>7.3f}{rank:>11.3f}{top:>11.1f}{half:>16.0%}"


def competition(path: Path, most: int | None) -> None:
    """Print how well drivers and features order the drives in the competition's setting."""
    drives = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    names = [f"{drive['search']}/{drive['run']}" for drive in drives]
    fit_runs = set(sorted(set(names))[::2])
    fit_drives = [drive for drive, name in zip(drives, names, strict=True) if name in fit_runs]
    test_drives = [drive for drive, name in zip(drives, names, strict=True) if name not in fit_runs]
    test_drives = test_drives[:most]
    kappa = np.array([drive["curvatures"] for drive in test_drives])
    failed = np.array([drive["outcome"] == "FAIL" for drive in test_drives])
    share = np.array([drive["max_oob_share"] for drive in test_drives])
    print(f"{len(test_drives)} drives of runs on which nothing was fitted, {failed.sum()} FAIL")
    print(f"{'ordered by':<34}{'AUC':>7}{'rank corr.':>11}{'top tenth':>11}{'half found in':>16}")
    features: dict[str, Callable[[FloatArray], FloatArray]] = {
        "largest |curvature|": lambda k: np.abs(k).max(axis=1),
        "mean |curvature|": lambda k: np.abs(k).mean(axis=1),
    }
    for name, feature in features.items():
        print(row(name, feature(kappa), failed, share))
    if (forecast := boosting(fit_drives, kappa)) is not None:
        print(row("gradient boosting of curvatures", forecast, failed, share))
    roads = [Road.from_points(interpolate(points_of(curvatures))) for curvatures in kappa]
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


def boosting(fit_drives: list[dict[str, Any]], kappa: FloatArray) -> FloatArray | None:
    """Return the oob shares that gradient boosting forecasts; None without scikit-learn."""
    try:
        ensemble = import_module("sklearn.ensemble")  # not a dependency
    except ImportError:
        print("(gradient boosting is left out: pip install scikit-learn)")
        return None

    def columns(k: FloatArray) -> FloatArray:
        size = np.abs(k)
        totals = [size.max(axis=1), size.mean(axis=1), k.mean(axis=1), k.std(axis=1)]
        return np.concatenate([k, size, np.diff(k, axis=1), np.stack(totals, axis=1)], axis=1)

    model = ensemble.HistGradientBoostingRegressor(
        max_iter=200, learning_rate=0.05, max_leaf_nodes=8, min_samples_leaf=30, random_state=0
    )
    model.fit(
        columns(np.array([drive["curvatures"] for drive in fit_drives])),
        np.array([drive["max_oob_share"] for drive in fit_drives]),
    )
    forecast: FloatArray = model.predict(columns(kappa))
    return forecast


def speed_shapes(
    modelled: tuple[FloatArray, FloatArray], recorded: tuple[FloatArray, FloatArray], end: float
) -> tuple[float, float]:
    """Return correlation and median difference of two speeds, each over its mean, every 10 m.

    Args:
        modelled: (n,) distances along the road in m and (n,) times in s.
        recorded: (n,) distances along the road in m and (n,) times in s.
        end: distance along the road to which the speeds are compared, in m.
    """
    marks = np.arange(STEP, end, STEP)
    shapes = []
    for distance, time in (modelled, recorded):
        furthest = np.maximum.accumulate(distance)
        passing_time = np.interp(marks, furthest, time)
        speed = STEP / np.maximum(np.diff(passing_time), 1e-3)
        shapes.append(speed / speed.mean())
    correlation = float(np.corrcoef(*shapes)[0, 1])
    return correlation, float(np.median(np.abs(shapes[0] - shapes[1])))


def trajectories(folder: Path, most: int | None) -> None:
    """Print how far the model is from the recorded trajectories."""
    simulator = EmbeddedSimulator(
        rules=Rules(speed_limit=120.0, oob_tolerance=1.0), vehicle="etk800"
    )
    driver = BeamngAi(aggression=1.5)
    errors, scores, failures, gaps = [], [], [], []
    lengths, shapes = [], []
    for file in sorted(folder.glob("*.json"))[:most]:
        data = json.loads(file.read_text(encoding="utf-8"))
        road = Road.from_points(data["road_points"], lane_width=5.0)
        recorded = np.array(data["trajectory"], dtype=np.float64)
        distance, offset = road.track(recorded[:, 1:3]).T
        offset = offset + 2.5  # from the centre line to the middle of the lane
        failed = data["outcome"] == "FAIL"
        if failed and distance[-1] < FAULTY_START:
            continue
        drive = simulator.drive(road, driver)
        modelled = assess(road, drive)
        out = np.flatnonzero(np.abs(offset) > 2.5)
        end = min(distance.max(), modelled.distance.max(), distance[out[0]] if len(out) else np.inf)
        marks = np.arange(3.0, end)
        model_offset, recorded_offset = (
            np.interp(marks, s[np.argsort(s)], d[np.argsort(s)])
            for s, d in (
                (modelled.distance, modelled.lateral_offset - RECORDED_POINT),
                (distance, offset),
            )
        )
        errors.append(float(np.median(np.abs(model_offset - recorded_offset))))
        if end > SHORTEST:
            model_times = drive.trajectory.time[: len(modelled.distance)]
            shapes.append(
                speed_shapes((modelled.distance, model_times), (distance, recorded[:, 0]), end)
            )
        scores.append(float(modelled.oob_share.max()))
        failures.append(failed)
        lengths.append(road.length)
        model_out = np.flatnonzero(modelled.oob_share > 0.5)
        if failed and len(out) and len(model_out):
            gaps.append(abs(float(distance[out[0]] - modelled.distance[model_out[0]])))
    near = sum(gap <= SAME_PLACE for gap in gaps)
    print(
        f"\n{len(errors)} trajectories: median over drives of the median lateral error"
        f" {np.median(errors):.2f} m; {len(gaps)} common failures, {near} within {SAME_PLACE:g} m;"
        f" AUC {auc(np.array(scores), np.array(failures)):.3f}"
    )
    correlation, difference = np.median(shapes, axis=0)
    print(
        f"shape of the speed: correlation {correlation:.2f}, difference {difference:.0%} of the"
        " mean speed, medians over drives"
    )
    print(f"AUC of the road's length alone: {auc(np.array(lengths), np.array(failures)):.3f}")


def cost() -> None:
    """Print what 250 m cost: the planner in the default car and in the model's car, the model."""
    rng = np.random.default_rng(0)
    changes = rng.uniform(-0.05, 0.05, (COST_ROADS, 26))
    roads = [Road(np.clip(np.cumsum(row), -0.07, 0.07)) for row in changes]
    for name, driver, vehicle in (
        ("Planner", Planner(), "default"),
        ("Planner, etk800", Planner(), "etk800"),
        ("BeamngAi, etk800", BeamngAi(), "etk800"),
    ):
        simulator = EmbeddedSimulator(rules=Rules(oob_tolerance=1.0), vehicle=vehicle)
        compile_kernels()
        simulator.drive(roads[0], driver)
        costs = []
        for road in roads:
            seconds = []
            for _ in range(COST_ROUNDS):
                start = process_time()
                path = simulator.drive(road, driver).trajectory
                seconds.append(process_time() - start)
            metres = float(np.hypot(np.diff(path.x), np.diff(path.y)).sum())
            costs.append(250e3 * min(seconds) / metres)
        print(f"{name:<20} {np.mean(costs):5.2f} ms of CPU per 250 m")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("--most", type=int, metavar="N", help="use only the first N drives")
    options = parser.parse_args()
    drives, runs = options.data / "beamng_sbft.jsonl", options.data / "beamng_runs"
    if not drives.is_file() and not runs.is_dir():
        print(f"beamng_ai: {options.data} lacks {drives.name} and {runs.name}/; see --help")
        return 2
    if drives.is_file():
        competition(drives, options.most)
    if runs.is_dir():
        trajectories(runs, options.most)
    cost()
    return 0


if __name__ == "__main__":
    sys.exit(main())
