"""Calibration: fits a twin to recorded drives, cross-validates it, and says what it is worth.

Each fold's twin is fitted from the model as it was, without the drives of the runs that it is
judged on, so the figures judge the whole procedure. The twin in the profile is fitted on all
drives afterwards, from there and from the folds' twins.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Literal, TypeAlias

import numpy as np
from msgspec import Struct
from threadpoolctl import threadpool_limits

from frenetic._support.arrays import FloatArray
from frenetic._support.words import counted, read_part
from frenetic.analysis.statistics import a12, ranks
from frenetic.errors import FreneticError
from frenetic.oracle.verdict import REACHED, assess
from frenetic.plugins.twin.fitting import Fit, IntArray, RecordedDrive, group_labels, states_of
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import PredictionFigures, TwinProfile, Validation
from frenetic.plugins.twin.recordings import RecordedTerms, Recordings, read_recordings
from frenetic.simulators.embedded import compile_kernels

__all__ = [
    "CalibrationFile",
    "RecordedTerms",
    "Recordings",
    "answer",
    "calibrate",
    "read_recordings",
]

LEAST_DRIVES: Final = 10
FOLDS: Final = 5
STARTS: Final = 1
"""Random places from which each fold is fitted, beside the model as it was."""
LEAST: Final = 10
"""Fewest failures, and fewest other drives, for a verdict."""
UNFITTED: Final = "the driver as it was"
CURVATURE: Final = "largest curvature"
GOOD_AUC, FAIR_AUC = 0.65, 0.5
"""Least lower end of the AUC's interval for the verdicts good and fair."""
GOOD_LIFT, FAIR_LIFT = 2.0, 1.3
"""Least lift of the top tenth; or as much of the largest possible lift as `ENOUGH`."""
ENOUGH: Final = 0.8
OFTEN: Final = 1.5
"""Ratio of the twin's failures to the recorded ones, or the other way round, that is reported."""
VERDICTS: Final[Mapping[str, str]] = {
    "good": "Good enough to start from",
    "fair": "Better than chance, start from it with care",
    "poor": "Not good enough to start from",
    "unknown": "Whether it is good enough to start from cannot be told",
}
"""Sentence of each verdict."""

Verdict: TypeAlias = Literal["good", "fair", "poor", "unknown"]


class CalibrationFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The entries of a calibration's file: what `frenetic calibrate` says, and terms."""

    recordings: tuple[str, ...] = ()
    """Files and folders."""
    terms: RecordedTerms | None = None
    """What holds of all drives, whatever a campaign says."""
    driver: str = ""
    """The twin's driver with its options, as on the command line."""
    fit: tuple[str, ...] = ()
    """Parameters, as `TwinModel.of` takes them."""
    vehicle: str = ""
    """Name of the car that the fit begins with, and its parameters."""
    out: str = "profile.json"

    def model(self) -> TwinModel:
        """Return the model that is fitted.

        Raises:
            FreneticError: the file names no driver, or as `TwinModel.of` raises it.
            ValueError: the driver's options cannot be read.
        """
        name, options = read_part(self.driver)
        if not name:
            raise FreneticError("the twin has no driver: name one, such as planner")
        car, vehicle = read_part(self.vehicle)
        if car:
            vehicle["name"] = car
        return TwinModel.of(name, self.fit, driver_options=options, vehicle=vehicle)


def calibrate(
    recordings: Recordings,
    model: TwinModel,
    *,
    name: str = "twin",
    places: Sequence[str] = (),
    on_progress: Callable[[int, int], None] = lambda *_: None,
) -> TwinProfile:
    """Return the profile of a twin, fitted and cross-validated.

    Args:
        recordings: recorded drives that the twin is to follow.
        model: driver and car, with the parameters to fit.
        name: name of the profile.
        places: files and folders of the recordings, for people.
        on_progress: called with the number of fits done, and of all.

    Raises:
        FreneticError: there are too few drives, or the driver breaks.
    """
    drives = recordings.drives
    if len(drives) < LEAST_DRIVES:
        raise FreneticError(
            f"{len(drives)} recorded drives: at least {LEAST_DRIVES} are needed to calibrate on"
        )
    terms = recordings.terms
    fit = Fit(model, terms.rules)
    start = np.array([parameter.place for parameter in model.parameters])
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    by_run = len(recordings.runs) > 1
    fold = folds_of(drives, by_run=by_run)
    fits = int(fold.max()) + 2  # of the folds and of all drives
    compile_kernels()
    with threadpool_limits(1):  # threads would wait for each other on small matrices
        fit.differences(start, drives[:1])  # refuses a driver that breaks
        before = driven(fit, start, drives)
        rows, score, fold_places = _cross_validate(
            fit, start, drives, fold, lambda done: on_progress(done, fits)
        )
        best = _best(fit, [start, *fold_places], drives)
        fitted = fit.intervals(best, drives, fold_places)
        on_progress(fits, fits)
    twin = figures_of(score, failed, rows)
    others = _baselines(drives, scores(before), failed)
    interval = auc_interval(score, failed, group_labels(drives))
    verdict, reason = verdict_of(twin, failed, interval, others)
    return TwinProfile.of(
        name,
        model.spec({parameter.name: parameter.value for parameter in fitted}, terms.spec),
        fitted=fitted,
        recordings=list(places),
        validation=Validation(
            drives=len(drives),
            failures=int(failed.sum()),
            by="run" if by_run else "road",
            twin=twin,
            baselines=others,
            verdict=verdict,
            reason=reason,
        ),
    )


def _baselines(
    drives: Sequence[RecordedDrive], before: FloatArray, failed: FloatArray
) -> dict[str, PredictionFigures]:
    """Return the figures of two baselines: the twin before its fit, and the road's curvature."""
    curvature = np.array([np.abs(drive.road.curvatures).max() for drive in drives])
    scores_by_name = {UNFITTED: before, CURVATURE: curvature}
    return {name: figures_of(values, failed) for name, values in scores_by_name.items()}


def _cross_validate(
    fit: Fit,
    start: FloatArray,
    drives: list[RecordedDrive],
    fold: IntArray,
    on_progress: Callable[[int], None],
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Return the twin's drives of held-out roads, their scores, and each fold's fitted places."""
    rows, score = np.empty((len(drives), _COLUMNS)), np.empty(len(drives))
    fold_places: list[FloatArray] = []
    count = int(fold.max()) + 1
    for k in range(count):
        on_progress(k)
        train, held_out = np.flatnonzero(fold != k), np.flatnonzero(fold == k)
        random = np.random.default_rng(k).random((STARTS, len(start)))
        fold_places.append(_best(fit, [start, *random], [drives[i] for i in train]))
        rows_of_fold = driven(fit, fold_places[-1], drives)
        rows[held_out] = rows_of_fold[held_out]
        # Scores of several twins are not comparable: one may leave its lane by more everywhere.
        score[held_out] = ranks(scores(rows_of_fold))[held_out]
    on_progress(count)
    return rows, score, fold_places


def answer(profile: TwinProfile) -> str:
    """Return whether a calibrated twin is good enough to start from, and which bounds decide."""
    assert profile.validation is not None
    decided = ", ".join(parameter.name for parameter in profile.fitted if parameter.at_bound)
    widen = f"; the bounds decide {decided}: widen them, and calibrate again" if decided else ""
    return f"{VERDICTS[profile.validation.verdict]}: {profile.validation.reason}{widen}"


def _best(fit: Fit, starts: Sequence[FloatArray], drives: Sequence[RecordedDrive]) -> FloatArray:
    return min((fit.fitted(start, drives) for start in starts), key=lambda fitted: fitted[0])[1]


def folds_of(drives: Sequence[RecordedDrive], *, by_run: bool) -> IntArray:
    """Return the number of each drive's fold, (drives,); drives of one run, or road, share it.

    Folds hold about as many drives each.
    """
    names = [drive.run if by_run else drive.road.curvatures.tobytes().hex() for drive in drives]
    sizes = Counter(names)
    groups = list(sizes)
    np.random.default_rng(0).shuffle(groups)
    count = min(FOLDS, len(groups))
    if count < 2:
        raise FreneticError("all recorded drives are of one road: drives of others are needed")
    filled = [0] * count
    fold_of: dict[str, int] = {}
    for name in sorted(groups, key=lambda name: -sizes[name]):
        k = filled.index(min(filled))
        filled[k] += sizes[name]
        fold_of[name] = k
    return np.array([fold_of[name] for name in names], dtype=np.int64)


# The twin's drives

_FAILED, _SHARE, _MOOBD, _OFFSET = range(4)
_COLUMNS: Final = 4


def driven(fit: Fit, places: FloatArray, drives: Sequence[RecordedDrive]) -> FloatArray:
    """Return a twin's drives, (n, 4): whether it fails, oob share, MOOBD, median offset error in m.

    Raises:
        FreneticError: the driver broke.
    """
    rows = []
    for recorded, drive in fit.drives(places, drives):
        assessment = assess(recorded.road, drive)
        offset = states_of(drive, assessment)[0]
        k = min(len(offset), recorded.states.shape[1])
        error = np.median(np.abs(offset[:k] - recorded.states[0, :k]))
        share, moobd = assessment.oob_share.max(), assessment.oob_distance.min()
        rows.append((assessment.end != REACHED, share, moobd, error))
    return np.array(rows, dtype=np.float64)


def scores(rows: FloatArray) -> FloatArray:
    """Return the twin's scores of roads, larger is worse: the largest oob share, then the MOOBD."""
    values: FloatArray = rows[:, _SHARE] - 1e-6 * rows[:, _MOOBD]
    return values


# Figures


def auc_of(score: FloatArray, failed: FloatArray) -> float | None:
    """Return the chance that a failed drive ranks above another one; None without both."""
    is_failed = failed > 0.5
    if is_failed.all() or not is_failed.any():
        return None
    return a12(score[is_failed], score[~is_failed])


def top_tenth(score: FloatArray, failed: FloatArray) -> float | None:
    """Return the share of failures in the first tenth of the ranked roads, over that in all.

    Roads of equal score count as if in random order.
    """
    if not failed.any():
        return None
    order = np.argsort(-score, kind="stable")
    _, group, counts = np.unique(-score[order], return_inverse=True, return_counts=True)
    share = (np.bincount(group, weights=failed[order]) / counts)[group]
    failures_found = np.concatenate(([0.0], np.cumsum(share))) / failed.sum()
    return float(np.interp(0.1 * len(score), np.arange(len(failures_found)), failures_found)) / 0.1


def figures_of(
    score: FloatArray, failed: FloatArray, rows: FloatArray | None = None
) -> PredictionFigures:
    """Return figures of scores of roads, (n,), and of the twin's drives if there are any."""
    auc, lift = auc_of(score, failed), top_tenth(score, failed)
    if rows is None:
        return PredictionFigures(auc=auc, top_tenth=lift)
    return PredictionFigures(
        auc=auc,
        top_tenth=lift,
        twin_failures=int(rows[:, _FAILED].sum()),
        agreement=float((rows[:, _FAILED] == failed).mean()),
        offset_error=float(np.median(rows[:, _OFFSET])),
    )


def auc_interval(
    score: FloatArray, failed: FloatArray, labels: IntArray, repeats: int = 400
) -> tuple[float, float] | None:
    """Return the 95 % interval of the AUC: a bootstrap over independent groups of drives."""
    members = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    generator = np.random.default_rng(0)
    values = []
    for _ in range(repeats):
        drawn = generator.integers(len(members), size=len(members))
        chosen = np.concatenate([members[i] for i in drawn])
        value = auc_of(score[chosen], failed[chosen])
        if value is not None:
            values.append(value)
    if len(values) < repeats // 2:
        return None
    low, high = np.quantile(values, [0.025, 0.975])
    return float(low), float(high)


# The verdict


def verdict_of(
    twin: PredictionFigures,
    failed: FloatArray,
    interval: tuple[float, float] | None,
    baselines: Mapping[str, PredictionFigures],
) -> tuple[Verdict, str]:
    """Return whether a twin is good enough to start from, and why, in a sentence."""
    n, failures = len(failed), int(failed.sum())
    if min(failures, n - failures) < LEAST or twin.auc is None or interval is None:
        return "unknown", (
            f"{failures} of {n} recorded drives failed: {LEAST} failures and {LEAST} others are"
            " needed to say whether its ranking can be trusted"
        )
    low, high = interval
    lift = twin.top_tenth or 0.0
    most = min(10.0, n / failures)
    reason = (
        f"on drives that it has not seen its AUC is {twin.auc:.2f} ({low:.2f} to {high:.2f}), and"
        f" the tenth of the roads that it ranks first fails {lift:.1f} times as often as all"
        f" ({most:.1f} is possible)"
    )
    better = [k for k, v in baselines.items() if v.auc is not None and v.auc >= twin.auc]
    if better:
        reason += f"; {' and '.join(better)} {'ranks' if len(better) == 1 else 'rank'} no worse"
    twin_failures = twin.twin_failures
    if (
        twin_failures is not None
        and not 1.0 / OFTEN <= (twin_failures + 0.5) / (failures + 0.5) <= OFTEN
    ):
        reason += (
            f"; it fails on {counted(twin_failures, 'road')}, the record on {failures}: trust its"
        )
        reason += " order, not its outcomes"
    if low >= GOOD_AUC and (lift >= GOOD_LIFT or lift >= ENOUGH * most) and not better:
        return "good", reason
    if (
        low > FAIR_AUC
        and set(better) <= {UNFITTED}
        and (lift >= FAIR_LIFT or lift >= ENOUGH * most)
    ):
        return "fair", reason
    return "poor", reason
