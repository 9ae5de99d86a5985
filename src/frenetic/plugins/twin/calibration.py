"""Calibration: a twin is fitted to recorded drives and cross-validated.

For each fold a twin is fitted without the fold's drives and then judged on them. These fits know
nothing of the judged drives, so the figures judge the whole procedure. The twin in the profile is
fitted afterwards on all drives; its fits start from the model as it was and from the folds' twins.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from msgspec import Struct
from threadpoolctl import threadpool_limits

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.option_text import read_part
from frenetic.analysis.statistics import ranks
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import REACHED, assess
from frenetic.plugins.twin.fitting import Fitter
from frenetic.plugins.twin.intervals import fitted_parameters
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import PredictionFigures, TwinProfile, Validation
from frenetic.plugins.twin.recorded_drive import RecordedDrive, group_labels, states_of
from frenetic.plugins.twin.recordings import RecordedTerms, Recordings, read_recordings
from frenetic.plugins.twin.verdict import (
    CURVATURE,
    UNFITTED,
    TwinDrive,
    answer,
    auc_interval,
    figures_of,
    verdict_of,
)
from frenetic.simulators.embedded import compile_kernels

__all__ = [
    "CalibrationFile",
    "RecordedTerms",
    "Recordings",
    "answer",
    "calibrate",
    "read_recordings",
]

MIN_DRIVES: Final = 10
"""Fewest recorded drives to calibrate on; our choice."""
FOLDS: Final = 5
"""Number of folds of the cross-validation, or fewer where there are fewer runs or roads."""
RANDOM_STARTS: Final = 1
"""Number of random values from which each fold is fitted, beside the model as it was."""


class CalibrationFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The entries of a calibration's file: what `frenetic calibrate` says, and terms."""

    recordings: tuple[str, ...] = ()
    """Files and folders of recorded drives."""
    terms: RecordedTerms | None = None
    """Terms of all drives, in place of those that a campaign records."""
    driver: str = ""
    """The twin's driver with its options, as on the command line."""
    fit: tuple[str, ...] = ()
    """Parameters, as `TwinModel.of` takes them."""
    vehicle: str = ""
    """Name of the car that the fit begins with, and its parameters."""
    out: str = "profile.json"
    """File for the profile."""

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
    if len(drives) < MIN_DRIVES:
        raise FreneticError(
            f"{len(drives)} recorded drives: at least {MIN_DRIVES} are needed to calibrate on"
        )
    terms = recordings.terms
    fitter = Fitter(model, terms.rules)
    start = np.array([parameter.unit_start for parameter in model.parameters])
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    by_run = len(recordings.runs) > 1
    folds = folds_of(drives, by_run=by_run)
    fit_count = int(folds.max()) + 2  # one for each fold, one for all drives
    compile_kernels()
    with threadpool_limits(1):  # threads would wait for each other on small matrices
        fitter.residuals_by_drive(start, drives[:1])  # raises if the driver breaks
        unfitted_drives = drive_roads(fitter, start, drives)
        held_out_drives, score, fold_values = _cross_validate(
            fitter, start, drives, folds, lambda done: on_progress(done, fit_count)
        )
        best = _best(fitter, [start, *fold_values], drives)
        fitted = fitted_parameters(fitter, best, drives, fold_values)
        on_progress(fit_count, fit_count)
    twin_figures = figures_of(score, failed, held_out_drives)
    baselines = _baselines(drives, _scores(unfitted_drives), failed)
    interval = auc_interval(score, failed, group_labels(drives))
    verdict, reason = verdict_of(twin_figures, failed, interval, baselines)
    return TwinProfile.of(
        name,
        model.spec({parameter.name: parameter.value for parameter in fitted}, terms.spec),
        fitted=fitted,
        recordings=list(places),
        validation=Validation(
            drives=len(drives),
            failures=int(failed.sum()),
            by="run" if by_run else "road",
            twin=twin_figures,
            baselines=baselines,
            verdict=verdict,
            reason=reason,
        ),
    )


def _baselines(
    drives: Sequence[RecordedDrive], unfitted_score: FloatArray, failed: FloatArray
) -> dict[str, PredictionFigures]:
    """Return the figures of two baselines: the twin before its fit, and the road's curvature."""
    curvature = np.array([np.abs(drive.road.curvatures).max() for drive in drives])
    scores = {UNFITTED: unfitted_score, CURVATURE: curvature}
    return {name: figures_of(score, failed) for name, score in scores.items()}


def _cross_validate(
    fitter: Fitter,
    start: FloatArray,
    drives: list[RecordedDrive],
    folds: IntArray,
    on_progress: Callable[[int], None],
) -> tuple[list[TwinDrive], FloatArray, list[FloatArray]]:
    """Fit a twin for each fold, and let it drive the fold's roads.

    Returns:
        drives of the held-out roads; their scores, (n,); each fold's fitted unit values.
    """
    held_out_drives: dict[int, TwinDrive] = {}
    score = np.empty(len(drives))
    fold_values: list[FloatArray] = []
    count = int(folds.max()) + 1
    for k in range(count):
        on_progress(k)
        train, held_out = np.flatnonzero(folds != k), np.flatnonzero(folds == k)
        random_starts = np.random.default_rng(k).random((RANDOM_STARTS, len(start)))
        fold_values.append(_best(fitter, [start, *random_starts], [drives[i] for i in train]))
        twin_drives = drive_roads(fitter, fold_values[-1], drives)
        held_out_drives |= {i: twin_drives[i] for i in held_out.tolist()}
        # Scores of several twins are not comparable: one may leave its lane by more everywhere.
        # So a fold's roads get their ranks among all roads that its twin drives.
        score[held_out] = ranks(_scores(twin_drives))[held_out]
    on_progress(count)
    return [held_out_drives[i] for i in range(len(drives))], score, fold_values


def _best(
    fitter: Fitter, starts: Sequence[FloatArray], drives: Sequence[RecordedDrive]
) -> FloatArray:
    """Return the unit values of least loss that fits from these starts reach."""
    losses_and_values = (fitter.fit(start, drives) for start in starts)
    _, unit_values = min(losses_and_values, key=lambda loss_and_values: loss_and_values[0])
    return unit_values


def folds_of(drives: Sequence[RecordedDrive], *, by_run: bool) -> IntArray:
    """Return the number of each drive's fold, (n,); drives of one run, or road, share it.

    Folds hold about as many drives each.

    Raises:
        FreneticError: all drives are of one road.
    """
    names = [drive.run if by_run else drive.road.curvatures.tobytes().hex() for drive in drives]
    sizes = Counter(names)
    groups = list(sizes)
    np.random.default_rng(0).shuffle(groups)
    count = min(FOLDS, len(groups))
    if count < 2:
        raise FreneticError("all recorded drives are of one road: drives of others are needed")
    fold_sizes = [0] * count
    fold_of: dict[str, int] = {}
    for name in sorted(groups, key=lambda name: -sizes[name]):  # the largest group first
        k = fold_sizes.index(min(fold_sizes))
        fold_sizes[k] += sizes[name]
        fold_of[name] = k
    return np.array([fold_of[name] for name in names], dtype=np.int64)


def drive_roads(
    fitter: Fitter, unit_values: FloatArray, drives: Sequence[RecordedDrive]
) -> list[TwinDrive]:
    """Return how the twin with these unit values drives the roads of recorded drives.

    Raises:
        FreneticError: driver or car refuse the values.
    """
    twin_drives = []
    for recorded, drive in fitter.drive_all(unit_values, drives):
        assessment = assess(recorded.road, drive)
        offset = states_of(drive, assessment)[0]
        k = min(len(offset), recorded.states.shape[1])
        twin_drives.append(
            TwinDrive(
                failed=assessment.end != REACHED,
                oob_share=float(assessment.oob_share.max()),
                moobd=float(assessment.oob_distance.min()),
                offset_error=float(np.median(np.abs(offset[:k] - recorded.states[0, :k]))),
            )
        )
    return twin_drives


def _scores(twin_drives: Sequence[TwinDrive]) -> FloatArray:
    """Return the score of each drive, (n,)."""
    return np.array([drive.score for drive in twin_drives])
