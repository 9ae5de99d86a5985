"""Figures of a twin on drives that it has not seen, its baselines, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.words import counted
from frenetic.analysis.statistics import a12, spearman
from frenetic.road import Road
from frenetic.twin.calibration.driving import (
    FAILED,
    OFFSET_MEDIAN,
    IntArray,
)
from frenetic.twin.calibration.loss import with_ties
from frenetic.twin.calibration.recordings import RecordedDrive
from frenetic.twin.profile import Figures

LEAST: Final = 10
"""Fewest failures, and fewest other drives, for a verdict."""
UNFITTED: Final = "the driver as it was"
"""The baseline that needs a twin, too."""
GOOD_AUC, FAIR_AUC = 0.65, 0.5
"""Least lower end of the AUC's interval for the verdicts good and fair."""
GOOD_LIFT, FAIR_LIFT = 2.0, 1.3
"""Least lift of the top tenth; or as much of the largest possible lift as `ENOUGH`."""
ENOUGH: Final = 0.8
OFTEN: Final = 1.5
"""Ratio of the twin's failures to the recorded ones, or the other way round, that is told."""
VERDICTS: Final[Mapping[str, str]] = {
    "good": "Good enough to start from",
    "fair": "Better than chance, start from it with care",
    "poor": "Not good enough to start from",
    "unknown": "Whether it is good enough to start from cannot be told",
}
"""Verdict -> its words."""
_RIDGE: Final = 1e-2

Verdict = Literal["good", "fair", "poor", "unknown"]


def auc_of(score: FloatArray, failed: FloatArray) -> float | None:
    """Chance that a drive that failed ranks above one that did not; None without both."""
    is_failed = failed > 0.5
    if is_failed.all() or not is_failed.any():
        return None
    return a12(score[is_failed], score[~is_failed])


def found_by(score: FloatArray, failed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(share of the roads, share of the failures found) in the order of the scores, (n + 1,) each.

    Roads of equal score count as if in random order.
    """
    order = np.argsort(-score, kind="stable")
    _, group, counts = np.unique(-score[order], return_inverse=True, return_counts=True)
    share = (np.bincount(group, weights=failed[order]) / counts)[group]
    found = np.concatenate(([0.0], np.cumsum(share))) / max(float(failed.sum()), 1.0)
    return np.arange(len(score) + 1) / len(score), found


def figures_of(
    score: FloatArray, drives: Sequence[RecordedDrive], rows: FloatArray | None = None
) -> Figures:
    """Figures of a score of roads, larger is worse, and of the twin's drives if there are any.

    Args:
        score: (n,).
        drives: the recorded ones.
        rows: (n, COLUMNS) of the twin.
    """
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    n, failures = len(drives), int(failed.sum())
    found: dict[str, Any] = {"drives": n, "failures": failures, "auc": auc_of(score, failed)}
    shares = np.array([drive.max_oob_share for drive in drives])
    told = np.isfinite(shares)
    if told.sum() >= 3 and np.ptp(shares[told]) > 0.0:
        ours = with_ties(score[told], shares[told])
        varies = np.ptp(ours) > 0.0
        found["rank_correlation"] = spearman(ours, shares[told])[0] if varies else 0.0
    if 0 < failures < n:
        roads, failing = found_by(score, failed)
        found["top_tenth"] = float(np.interp(0.1, roads, failing)) / 0.1
        found["early_half"] = float(roads[int(np.argmax(failing >= 0.5 - 1e-12))])
    if rows is None:
        return Figures(**found)
    found["twin_failures"] = int(rows[:, FAILED].sum())
    found["agreement"] = float((rows[:, FAILED] == failed).mean())
    errors = rows[:, OFFSET_MEDIAN]
    errors = errors[np.isfinite(errors)]
    found["offset_error"] = float(np.median(errors)) if len(errors) else None
    return Figures(**found)


def auc_interval(
    score: FloatArray, drives: Sequence[RecordedDrive], *, seed: int, repeats: int = 400
) -> tuple[float, float] | None:
    """The 95 % interval of the AUC: a bootstrap over runs, over roads where there are few runs."""
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    labels = cluster_labels(drives)
    members = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    generator = np.random.default_rng(seed)
    found = []
    for _ in range(repeats):
        drawn = generator.integers(len(members), size=len(members))
        chosen = np.concatenate([members[i] for i in drawn])
        value = auc_of(score[chosen], failed[chosen])
        if value is not None:
            found.append(value)
    if len(found) < repeats // 2:
        return None
    low, high = np.quantile(found, [0.025, 0.975])
    return float(low), float(high)


FEW_RUNS: Final = 5
"""Below so many runs, roads instead of runs count as independent."""


def cluster_labels(drives: Sequence[RecordedDrive]) -> IntArray:
    """(n,) number of the independent group of each drive: its run, or itself if runs are few."""
    names = [drive.run for drive in drives]
    different = sorted(set(names))
    if len(different) < FEW_RUNS:
        return np.arange(len(names))
    number = {name: i for i, name in enumerate(different)}
    return np.array([number[name] for name in names], dtype=np.int64)


# Baselines


def road_features(road: Road) -> FloatArray:
    """(6,) largest, mean and standard deviation of |curvature|, its steepest change, length, 1."""
    k = np.abs(road.curvatures)
    change = np.abs(np.diff(road.curvatures)).max() / road.step if len(k) > 1 else 0.0
    return np.array([k.max(), k.mean(), k.std(), change, road.length, 1.0])


def linear_model(features: FloatArray, target: FloatArray) -> FloatArray:
    """Weights of a ridge regression of standardised features, to be applied to raw ones.

    Args:
        features: (n, m), the last one constant.
        target: (n,).
    """
    middle, width = features[:, :-1].mean(axis=0), features[:, :-1].std(axis=0)
    width = np.where(width > 1e-12, width, 1.0)
    x = (features[:, :-1] - middle) / width
    y = target - target.mean()
    slopes = np.linalg.solve(x.T @ x + _RIDGE * len(x) * np.eye(x.shape[1]), x.T @ y) / width
    return np.append(slopes, target.mean() - slopes @ middle)


def severities(drives: Sequence[RecordedDrive]) -> FloatArray:
    """(n,) recorded severity: the largest oob share, or else whether the drive failed."""
    return np.array(
        [d.max_oob_share if math.isfinite(d.max_oob_share) else float(d.failed) for d in drives]
    )


# The verdict


def verdict_of(
    twin: Figures, interval: tuple[float, float] | None, baselines: Mapping[str, Figures]
) -> tuple[Verdict, str]:
    """Whether a twin is good enough to start from, and why, in a sentence."""
    passed = twin.drives - twin.failures
    if min(twin.failures, passed) < LEAST or twin.auc is None or interval is None:
        return "unknown", (
            f"{twin.failures} of {twin.drives} recorded drives failed: {LEAST} failures and"
            f" {LEAST} others are needed to say whether its ranking can be trusted"
        )
    low, high = interval
    lift = twin.top_tenth or 0.0
    most = min(10.0, twin.drives / twin.failures)
    told = (
        f"on drives that it has not seen its AUC is {twin.auc:.2f} ({low:.2f} to {high:.2f}), and"
        f" the tenth of the roads that it ranks first fails {lift:.1f} times as often as all"
        f" ({most:.1f} is possible)"
    )
    better = [k for k, v in baselines.items() if v.auc is not None and v.auc >= twin.auc]
    if better:
        told += f"; {' and '.join(better)} {'ranks' if len(better) == 1 else 'rank'} no worse"
    ours = twin.twin_failures
    if ours is not None and not 1.0 / OFTEN <= (ours + 0.5) / (twin.failures + 0.5) <= OFTEN:
        told += f"; it fails on {counted(ours, 'road')}, the record on {twin.failures}: trust its"
        told += " order, not its outcomes"
    if low >= GOOD_AUC and (lift >= GOOD_LIFT or lift >= ENOUGH * most) and not better:
        return "good", told
    if (
        low > FAIR_AUC
        and set(better) <= {UNFITTED}
        and (lift >= FAIR_LIFT or lift >= ENOUGH * most)
    ):
        return "fair", told
    return "poor", told
