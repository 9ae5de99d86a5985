"""Ranking by the embedded simulator of roads that BeamNG.tech has driven, and the tuning for it.

    python benchmarks/beamng_ai.py --runs FOLDER [--tune] [--folds 5] [--repeats 2] [--seed 0]

Without ``--tune`` it drives the recorded roads with the preset `BeamngAi`, with the default
`Planner` and with nothing (plain road features) and prints how well each ranks the recorded
outcomes. With ``--tune`` it repeats the search for the preset's parameters: once in a
cross-validation, which measures the tuning on unseen roads, and once on all runs, which gives the
parameters.

FOLDER holds one JSON file per run:

    outcome      "PASS" or "FAIL"
    road_points  [[x, y], ...] in m, the centre line, about one point per metre
    trajectory   [[t, x, y, z], ...]: wall clock in s and the car's position in m, at a steady
                 simulated rate

as BeamNG.AI drives it on a road of two 5 m lanes with a risk factor of 1.5, a speed limit of
120 km/h and an oob tolerance of 0.5. Runs that failed within their first 20 m are starts that went
wrong and are left out.

The score of a road is -MOOBD of its drive under the same rules; the figure of merit is the ROC AUC
of that score against FAIL: the chance that a road that failed is ranked above one that passed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, differential_evolution
from scipy.stats import rankdata

from frenetic.drivers import BeamngAi, Planner
from frenetic.errors import FreneticError
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators.drive import Rules
from frenetic.simulators.embedded import EmbeddedSimulator

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]

LANE_WIDTH: Final = 5.0
"""m."""
RULES: Final = Rules(speed_limit=120.0, oob_tolerance=0.5)
START: Final = 20.0
"""Distance within which a failure is a faulty start, in m."""
NEAR: Final = 20.0
"""Largest distance of two places of departure that count as the same, in m."""

BOUNDS: Final = {
    "lateral_acceleration": (4.0, 8.0),
    "braking": (2.0, 7.0),
    "smoothing": (0.0, 10.0),
    "lookahead_time": (0.1, 0.9),
    "lookahead_min": (2.0, 10.0),
    "speed_gain": (0.3, 2.0),
}
"""Tuned parameters and their ranges."""
SHARE_WEIGHT: Final = 0.1
"""Weight of the error in the share of failures against AUC."""
POPULATION: Final = 8
"""Candidates per parameter in each generation."""
GENERATIONS: Final = 6
"""After the first."""
NEIGHBOURS: Final = 5
"""Candidates, itself included, over which a candidate's objective is averaged in the end."""


@dataclass(frozen=True)
class Run:
    """One recorded run."""

    name: str
    road: Road
    failed: bool
    departure: float | None
    """m along the road where the car's position first was outside its lane, None if it never was
    (half of the car's box may be out before that)."""


@dataclass(frozen=True)
class Drives:
    """Results of the embedded simulator on the runs' roads: arrays of equal length."""

    score: FloatArray
    """Score -MOOBD, in m."""
    failed: BoolArray
    departure: FloatArray
    """Distance along the road in m, nan where the car did not leave its lane."""


def load_runs(folder: Path) -> tuple[list[Run], int]:
    """The runs in a folder, and how many were left out as starts that went wrong.

    Raises:
        ValueError: no runs there, or a file that is not a run.
    """
    files = sorted(folder.glob("*.json"))
    if not files:
        raise ValueError(f"no runs in {folder}: a folder of JSON files is needed (see --help)")
    runs, left_out = [], 0
    for file in files:
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            road = Road.from_points(data["road_points"], lane_width=LANE_WIDTH)
            path = np.array(data["trajectory"], dtype=np.float64)[:, 1:3]
            outcome = Outcome(data["outcome"])
        except (KeyError, IndexError, TypeError, ValueError, FreneticError) as error:
            raise ValueError(f"{file} is not a recorded run: {error!r}") from None
        distance, offset = road.track(path).T
        failed = outcome is Outcome.FAIL
        if failed and distance[-1] < START:
            left_out += 1
            continue
        out = np.flatnonzero(np.abs(offset + 0.5 * LANE_WIDTH) > 0.5 * LANE_WIDTH)
        departure = float(distance[out[0]]) if failed and len(out) else None
        runs.append(Run(file.stem, road, failed, departure))
    if len({run.failed for run in runs}) < 2:
        raise ValueError(f"the runs in {folder} all ended alike: both PASS and FAIL are needed")
    return runs, left_out


def drive(roads: list[Road], driver: Planner) -> Drives:
    """The driver on every road, under the rules of the recorded runs."""
    simulator = EmbeddedSimulator(rules=RULES)
    results = [judge(road, simulator.drive(road, driver)) for road in roads]
    return Drives(
        np.array([-r.moobd if r.moobd is not None else np.nan for r in results]),
        np.array([r.outcome is Outcome.FAIL for r in results]),
        np.array([r.departure.distance if r.departure else np.nan for r in results]),
    )


def auc(score: FloatArray, failed: BoolArray) -> float:
    """ROC AUC of a score against FAIL, ties counted half (Mann-Whitney)."""
    n = int(failed.sum())
    rank_sum = float(rankdata(score)[failed].sum())
    return (rank_sum - n * (n + 1) / 2) / (n * (len(failed) - n))


def bootstrap(
    score: FloatArray, failed: BoolArray, rng: np.random.Generator, times: int = 2000
) -> tuple[float, float]:
    """95 % interval of the AUC: runs drawn anew with replacement, FAIL and PASS apart."""
    yes, no = score[failed], score[~failed]
    label = np.arange(len(score)) < len(yes)
    values = [
        auc(np.concatenate([rng.choice(yes, len(yes)), rng.choice(no, len(no))]), label)
        for _ in range(times)
    ]
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


FEATURES: Final[dict[str, Callable[[Road], float]]] = {
    "length": lambda road: road.length,
    "max |curvature|": lambda road: float(np.abs(road.curvatures).max()),
    "mean |curvature|": lambda road: float(np.abs(road.curvatures).mean()),
    "std of curvature": lambda road: float(road.curvatures.std()),
    "total turning": lambda road: float(np.abs(np.diff(road.headings)).sum()),
}
"""Plain features by which one might rank roads without driving."""


def objective(drives: Drives, failed: BoolArray) -> float:
    """What the tuning maximises: the AUC, a little less where the share of failures is off."""
    off = abs(float(drives.failed.mean()) - float(failed.mean()))
    return auc(drives.score, failed) - SHARE_WEIGHT * off


def tune(roads: list[Road], failed: BoolArray, seed: int) -> tuple[Planner, int]:
    """The parameters that rank these roads best, and the number of candidates tried.

    Differential evolution searches. Of all candidates it tried, not the best one is taken, as its
    lead is luck in part, but the one around which candidates are best: the mean objective of its
    nearest five, distances measured in units of the bounds.
    """
    low, high = np.array(list(BOUNDS.values())).T
    tried: list[FloatArray] = []
    values: list[float] = []

    def lose(x: FloatArray) -> float:
        value = objective(drive(roads, planner_of(x)), failed)
        tried.append((x - low) / (high - low))
        values.append(value)
        return -value

    differential_evolution(
        lose,
        Bounds(low, high),
        seed=np.random.default_rng(seed),
        popsize=POPULATION,
        maxiter=GENERATIONS,
        tol=0.0,
        polish=False,
    )
    x, value = np.array(tried), np.array(values)
    distance = ((x[:, None] - x[None]) ** 2).sum(axis=2)
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :NEIGHBOURS]
    best = int(np.argmax(value[nearest].mean(axis=1)))
    return planner_of(low + x[best] * (high - low)), len(x)


def planner_of(x: FloatArray) -> Planner:
    """The planner with these values of the tuned parameters."""
    return Planner(**dict(zip(BOUNDS, map(float, x), strict=True)))


def splits(
    failed: BoolArray, folds: int, rng: np.random.Generator
) -> Iterator[tuple[BoolArray, BoolArray]]:
    """(training part, held-out part) masks with equal shares of failures in every fold."""
    fold = np.empty(len(failed), dtype=np.int64)
    for label in (True, False):
        members = np.flatnonzero(failed == label)
        fold[rng.permutation(members)] = np.arange(len(members)) % folds
    for k in range(folds):
        yield fold != k, fold == k


def cross_validate(
    roads: list[Road], failed: BoolArray, folds: int, repeats: int, seed: int
) -> FloatArray:
    """(repeats, folds) AUC on the held-out part after tuning on the rest."""
    values = np.empty((repeats, folds))
    for repeat in range(repeats):
        rng = np.random.default_rng([seed, repeat])
        for k, (train, test) in enumerate(splits(failed, folds, rng)):
            chosen, _ = tune(_pick(roads, train), failed[train], seed)
            values[repeat, k] = auc(drive(_pick(roads, test), chosen).score, failed[test])
            print(f"  repeat {repeat + 1} fold {k + 1}: {values[repeat, k]:.3f}", flush=True)
    return values


def _pick(roads: list[Road], mask: BoolArray) -> list[Road]:
    return [road for road, wanted in zip(roads, mask, strict=True) if wanted]


def report(runs: list[Run], driver: Planner, seed: int) -> None:
    """Prints the ranking table, the confusion and the agreement of the places of departure."""
    roads = [run.road for run in runs]
    failed = np.array([run.failed for run in runs])
    rng = np.random.default_rng(seed)
    rows = [(name, np.array([f(road) for road in roads])) for name, f in FEATURES.items()]
    drives = drive(roads, driver)
    rows += [("default Planner", drive(roads, Planner()).score)]
    rows += [(type(driver).__name__, drives.score)]
    print(f"\n{'ranked by':<20}{'AUC':>7}   95 % interval")
    for name, score in rows:
        low, high = bootstrap(score, failed, rng)
        print(f"{name:<20}{auc(score, failed):>7.3f}   {low:.3f} .. {high:.3f}")

    print(f"\n{type(driver).__name__:<20}{'sim. FAIL':>10}{'sim. PASS':>10}")
    for label, mask in (("recorded FAIL", failed), ("recorded PASS", ~failed)):
        yes = int(drives.failed[mask].sum())
        print(f"{label:<20}{yes:>10}{int(mask.sum()) - yes:>10}")
    right = int((drives.failed == failed).sum())
    print(f"agree on {right} of {len(runs)} outcomes ({right / len(runs):.0%})")

    recorded = np.array([np.nan if r.departure is None else r.departure for r in runs])
    both = np.isfinite(recorded) & np.isfinite(drives.departure)
    if both.any():
        gap = np.abs(recorded - drives.departure)[both]
        length = np.array([road.length for road in roads])[both]
        place = recorded[both]
        chance = np.minimum(place + NEAR, length) - np.maximum(place - NEAR, 0.0)
        print(
            f"departures in both: {both.sum()}, {int((gap <= NEAR).sum())} within {NEAR:g} m of"
            f" each other ({float((chance / length).sum()):.1f} expected of places by chance),"
            f" median gap {np.median(gap):.0f} m"
        )


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--tune", action="store_true", help="repeat the search for the parameters")
    parser.add_argument("--folds", type=int, default=5)
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    try:
        runs, left_out = load_runs(options.runs)
    except ValueError as error:
        print(f"beamng_ai: {error}", file=sys.stderr)
        return 2
    failed = np.array([run.failed for run in runs])
    least = int(min(failed.sum(), (~failed).sum()))
    if options.repeats < 1 or not 2 <= options.folds <= least:
        parser.error(f"--repeats of at least 1 and --folds of 2 to {least} are needed")
    print(
        f"{len(runs)} runs, {int(failed.sum())} FAIL and {int((~failed).sum())} PASS"
        f" ({left_out} starts that went wrong left out)"
    )
    driver: Planner = BeamngAi()
    if options.tune:
        roads = [run.road for run in runs]
        print("cross-validated AUC:")
        values = cross_validate(roads, failed, options.folds, options.repeats, options.seed)
        means = ", ".join(f"{mean:.3f}" for mean in values.mean(axis=1))
        print(
            f"mean {values.mean():.3f} (repeats: {means}; folds' standard deviation"
            f" {values.std():.3f})"
        )
        driver, tried = tune(roads, failed, options.seed)
        print(f"tuned on all runs ({tried} candidates):")
        for item in fields(driver):
            print(f"  {item.name} = {getattr(driver, item.name):.6g}")
    report(runs, driver, options.seed)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
