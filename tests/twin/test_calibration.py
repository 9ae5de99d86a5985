"""Calibration: known parameters are found, what data leave open is said, any stop is survived."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frenetic import Budget, Campaign, EmbeddedSimulator, RandomSearch, Stanley
from frenetic.analysis.statistics import ranks
from frenetic.drive import Rules
from frenetic.errors import FreneticError
from frenetic.oracle import assess
from frenetic.road import Road
from frenetic.spec import Spec
from frenetic.twin.calibration import (
    Asked,
    Calibration,
    Model,
    RecordedDrive,
    Recordings,
    Settings,
    calibrate,
    read_recordings,
)
from frenetic.twin.calibration import recordings as recordings_file
from frenetic.twin.calibration.calibrate import folds_of
from frenetic.twin.calibration.determination import difference
from frenetic.twin.calibration.driving import (
    COLUMNS,
    COVERED,
    MOOBD,
    OFFSET,
    SHARE,
    SPEED,
    TwinDriver,
    drive_twin,
)
from frenetic.twin.calibration.fitting import Journal
from frenetic.twin.calibration.loss import Logistic, Loss, scores, with_ties
from frenetic.twin.calibration.validation import (
    UNFITTED,
    auc_of,
    found_by,
    linear_model,
    verdict_of,
)
from frenetic.twin.page import shape_of
from frenetic.twin.profile import Figures

KNOWN = 7.3
HUGE = int("9" * 320)
"""A number that JSON holds and a float does not."""
MOVES = {"time": [0, 1], "x": [0, 5], "y": [0, 0]}
MODEL_OF = [Asked("lateral_acceleration"), Asked("vehicle.brake_deceleration", 7.0, 9.0)]
BROKEN = """
class Broken:
    def __init__(self, gain=1.0):
        self.gain = gain

    def reset(self, setup):
        pass

    def act(self, observation):
        raise ValueError("no")
"""
HANGS = BROKEN.replace('raise ValueError("no")', "import time; time.sleep(60)")


def drive_record(time: float, speed: float = 5.0) -> list[Any]:
    """A record of the competition's."""
    vectors = [[5.0 * time, 0.0, 0.0], [1.0, 0.0, 0.0], [speed, 0.0, 0.0]]
    return [time, *vectors, *[0.0] * 11, 1.5, 0.0]


QUICK = Settings(seed=1, evaluations=26, folds=2)


def recorded(folder: Path, seed: int, drives: int, known: float = KNOWN) -> Path:
    """A campaign of random roads with a driver of known parameters."""
    Campaign(
        strategy=RandomSearch(seed=seed),
        driver=Stanley(lateral_acceleration=known),
        simulator=EmbeddedSimulator(),
        budget=Budget(simulations=drives),
        folder=folder,
    ).run()
    return folder


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recorded")
    return [recorded(folder / f"run-{seed}", seed, 8) for seed in (101, 102)]


@pytest.fixture(scope="module")
def recordings(campaigns: list[Path]) -> Recordings:
    return read_recordings(campaigns)


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.of("stanley", MODEL_OF)


class Counted:
    """Counts the drives of twins."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.drives = 0
        drive = TwinDriver.rows

        def counting(twins: TwinDriver, candidates: Any, indices: Any) -> Any:
            self.drives += len(candidates) * len(indices)
            return drive(twins, candidates, indices)

        monkeypatch.setattr(TwinDriver, "rows", counting)


@pytest.fixture(scope="module")
def counted_calibration(recordings: Recordings, model: Model) -> tuple[Calibration, int]:
    """A calibration and the number of its drives."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        counted = Counted(monkeypatch)
        found = calibrate(recordings, model, QUICK)
    assert found is not None
    return found, counted.drives


@pytest.fixture(scope="module")
def calibration(counted_calibration: tuple[Calibration, int]) -> Calibration:
    return counted_calibration[0]


# What is found


def test_a_known_parameter_is_found_and_an_idle_one_is_called_undetermined(
    calibration: Calibration,
) -> None:
    found, idle = calibration.parameters
    assert found.value == pytest.approx(KNOWN, rel=0.02)
    assert found.low <= KNOWN <= found.high
    assert found.is_determined
    # No drive brakes so hard.
    assert not idle.is_determined
    assert (idle.low, idle.high) == pytest.approx((7.0, 9.0))
    assert calibration.profile.fitted[0].value == found.value
    assert [one.is_determined for one in calibration.profile.fitted] == [True, False]


def test_an_interval_that_ends_at_a_bound_is_a_warning_and_usual_bounds_are_wide(
    tmp_path: Path,
) -> None:
    slow = read_recordings([recorded(tmp_path / "slow", 101, 12, known=2.5)])
    found = {}
    for bounds in ((3.0, 12.0), (None, None)):
        asked = Model.of("stanley", [Asked("lateral_acceleration", *bounds)])
        result = calibrate(slow, asked, QUICK)
        assert result is not None
        found[bounds] = result.parameters[0], result.answer
    one, answer = found[3.0, 12.0]
    assert one.low == pytest.approx(3.0)
    assert (one.at_bound, one.is_determined) == (True, False)
    assert "; its interval ends at a bound" in str(one)
    assert answer.endswith(
        "; the bounds decide driver.lateral_acceleration: widen them, and calibrate again"
    )
    one, answer = found[None, None]
    assert one.value == pytest.approx(2.5, rel=0.03)
    assert one.is_determined
    assert "widen" not in answer


def test_figures_are_those_of_drives_that_a_fold_has_not_seen(
    calibration: Calibration, recordings: Recordings
) -> None:
    validation = calibration.validation
    assert (validation.by, validation.folds) == ("run", 2)
    for run in recordings.runs:
        own = {
            int(k) for k, d in zip(calibration.fold, recordings.drives, strict=True) if d.run == run
        }
        assert len(own) == 1
    i = 3
    values = calibration.folds[int(calibration.fold[i])]
    drive = recordings.drives[i]
    driver, simulator = calibration.model.make(values, drive.rules)
    seen = assess(drive.road, simulator.drive(drive.road, driver))
    assert calibration.rows[i, SHARE] == seen.oob_share.max()
    assert calibration.rows[i, MOOBD] == seen.oob_distance.min()
    assert validation.twin.offset_error is not None
    assert validation.twin.offset_error < 0.05
    assert set(validation.baselines) == set(calibration.rankings)


def test_folds_are_compared_by_ranks_because_their_twins_scores_differ_in_scale(
    calibration: Calibration, recordings: Recordings
) -> None:
    drives = recordings.drives
    for k, values in enumerate(calibration.folds):
        driver, simulator = calibration.model.make(values, drives[0].rules)
        score = scores(np.array([drive_twin(one, driver, simulator) for one in drives]))
        held_out = calibration.fold == k
        assert (calibration.ranking[held_out] == ranks(score)[held_out]).all()
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    assert calibration.validation.twin.auc == auc_of(calibration.ranking, failed)


def test_the_profile_drives_as_the_fitted_twin(calibration: Calibration, tmp_path: Path) -> None:
    calibration.profile.write(tmp_path / "twin.json")
    read = type(calibration.profile).read(tmp_path / "twin.json")
    assert read == calibration.profile
    assert read.changes() == []
    driver, simulator = read.spec().make_parts(isolate=False)
    assert driver.lateral_acceleration == calibration.parameters[0].value  # type: ignore[attr-defined]
    assert simulator.vehicle.brake_deceleration == calibration.parameters[1].value  # type: ignore[attr-defined]
    assert Spec.read(tmp_path / "twin.json").driver.name == "stanley"


def test_one_run_is_held_out_road_by_road_and_runs_of_a_road_stay_together(
    recordings: Recordings,
) -> None:
    one = tuple(d for d in recordings.drives if d.run == recordings.runs[0])
    fold = folds_of((*one, *one), 5, by_run=False, seed=3)
    assert (fold[: len(one)] == fold[len(one) :]).all()
    assert sorted(set(fold.tolist())) == [0, 1, 2, 3, 4]
    with pytest.raises(FreneticError, match="of one road"):
        folds_of((one[0], one[0]), 5, by_run=False, seed=3)


# Going on


def fields(calibration: Calibration | None) -> Any:
    assert calibration is not None
    return calibration.profile, calibration.rows.tobytes(), calibration.losses


def test_a_stopped_fit_goes_on_to_the_same_end(
    recordings: Recordings,
    model: Model,
    counted_calibration: tuple[Calibration, int],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calibration, drives = counted_calibration
    state = tmp_path / "twin.fit.jsonl"
    counted = Counted(monkeypatch)
    asked = iter([False] * 4 + [True])
    stopped = calibrate(recordings, model, QUICK, state=state, should_stop=lambda: next(asked))
    assert stopped is None
    assert 0 < counted.drives < drives
    state.write_bytes(state.read_bytes() + b'{"key": "fold 0 3", "val')  # killed while writing
    again = calibrate(recordings, model, QUICK, state=state)
    assert fields(again) == fields(calibration)
    assert counted.drives == drives  # nothing is driven twice
    assert not state.exists()


def test_results_of_other_roads_or_of_another_order_are_not_taken_up(
    recordings: Recordings, model: Model, tmp_path: Path
) -> None:
    table, state = tmp_path / "tests.jsonl", tmp_path / "fit.jsonl"
    digests = set()
    for step in (10.0, 12.0):
        row = {"curvatures": [0.0, 0.01], "step": step, "outcome": "PASS"}
        table.write_text(json.dumps(row), encoding="utf-8")
        digests |= set(read_recordings([table]).digests.values())
    assert len(digests) == 2
    turned = replace(recordings, digests=dict(reversed(list(recordings.digests.items()))))
    begun = set()
    for one in (recordings, turned):
        assert calibrate(one, model, QUICK, state=state, should_stop=lambda: True) is None
        begun.add(state.read_bytes())
    assert len(begun) == 2


def test_the_number_of_workers_changes_nothing(recordings: Recordings, model: Model) -> None:
    short = Settings(evaluations=2, folds=2)
    one, two = (calibrate(recordings, model, short, workers=n) for n in (1, 2))
    assert fields(one) == fields(two)


def test_a_worker_that_dies_is_named(recordings: Recordings, model: Model) -> None:
    start = model.values([one.place(one.start) for one in model.parameters])
    with TwinDriver(model, recordings.drives, shapes=False, workers=2) as twins:
        alone = twins.rows([start], np.arange(2))
        assert alone.shape == (1, 2, COLUMNS)
        for process in active_children():
            process.kill()
        with pytest.raises(FreneticError, match=r"worker \d was lost: it .*with 1 worker"):
            twins.rows([start], np.arange(2))
    assert not active_children()


def test_a_journal_of_other_settings_is_replaced_and_one_in_use_refused(tmp_path: Path) -> None:
    path = tmp_path / "new" / "fit.jsonl"
    with Journal(path, "a") as journal:
        journal.put("x", np.array([[1.0, math.nan]]))
    with Journal(path, "a") as journal:
        found = journal.get("x", 1)
        assert found is not None
        assert np.array_equal(found, [[1.0, math.nan]], equal_nan=True)
        assert journal.get("x", 2) is None
    path.write_text(path.read_text() + "[]\n{}\nno\n", encoding="utf-8")
    with Journal(path, "a") as journal:
        assert journal.found == 1
    with Journal(path, "b") as journal:
        assert journal.found == 0
    assert path.read_text(encoding="utf-8") == '{"settings": "b"}\n'
    path.unlink()
    path.mkdir()
    with pytest.raises(FreneticError, match=r"cannot be written|may not be"), Journal(path, "b"):
        pass


# The loss


def test_a_twin_is_ranked_by_moobd_where_it_stays_in_its_lane() -> None:
    recorded = np.array([0.0, 0.4, 0.0, 0.9])
    rows = np.zeros((4, COLUMNS))
    rows[:, MOOBD] = [1.5, 0.9, 1.2, 0.8]
    assert np.argsort(with_ties(scores(rows), recorded), kind="stable").tolist() == [0, 2, 1, 3]
    drives = drives_of(recorded.tolist(), [False, False, False, True])
    loss = Loss(drives, np.arange(4), {"offset": 0.0, "speed": 0.0})
    assert loss.terms(rows)["oob_share"] == pytest.approx(np.zeros(4))


def drives_of(shares: list[float], failed: list[bool]) -> list[RecordedDrive]:
    road = Road([0.0, 0.01, 0.0])
    return [
        RecordedDrive(
            "d", "r", "r", road, Rules(), fails, share,
            offset=np.array([0.1, 0.2 + share]), speed=np.array([1.0, 5.0 + share]),
        )
        for share, fails in zip(shares, failed, strict=True)
    ]  # fmt: skip


def rows_of(shares: list[float], *, covered: float, error: float) -> Any:
    rows = np.zeros((len(shares), COLUMNS))
    rows[:, SHARE], rows[:, MOOBD] = shares, 1.0 - 2.0 * np.array(shares)
    rows[:, COVERED] = covered
    rows[:, OFFSET] = rows[:, SPEED] = error
    return rows


def test_the_loss_is_0_for_the_record_itself_and_1_for_what_says_nothing() -> None:
    shares, failed = [0.0, 0.0, 0.3, 0.6, 0.97, 1.0], [False] * 4 + [True] * 2
    loss = Loss(drives_of(shares, failed), np.arange(6))
    assert set(loss.weights) == {"outcome", "oob_share", "offset", "speed"}
    same = loss.terms(rows_of(shares, covered=1.0, error=0.0))
    assert {name: values.mean() for name, values in same.items()} == pytest.approx(
        dict.fromkeys(loss.weights, 0.0), abs=0.05
    )
    nothing = loss.terms(rows_of([0.5] * 6, covered=0.0, error=math.nan))
    assert {name: values.mean() for name, values in nothing.items()} == pytest.approx(
        dict.fromkeys(loss.weights, 1.0)
    )
    broken = rows_of(shares, covered=1.0, error=0.0)
    broken[2, SHARE] = math.nan
    assert (loss.contributions(broken) == 10.0).all()


def test_weights_choose_the_terms() -> None:
    drives = drives_of([0.0, 0.5, 1.0], [False, False, True])
    loss = Loss(drives, np.arange(3), {"speed": 0.0, "offset": 3.0})
    assert loss.weights == {"outcome": 1.0, "oob_share": 1.0, "offset": 3.0}
    rows = rows_of([0.0, 0.5, 1.0], covered=1.0, error=0.2)
    expected = sum(loss.weights[k] * v.mean() for k, v in loss.terms(rows).items()) / 5.0
    assert loss.contributions(rows).mean() == pytest.approx(expected)
    for weights, message in (
        ({"grip": 1.0}, "no term 'grip'; there are: outcome"),
        ({"speed": -1.0}, "weight of speed is -1.0"),
        (dict.fromkeys(loss.weights, 0.0) | {"speed": 0.0}, "nothing to fit to"),
    ):
        with pytest.raises(FreneticError, match=message):
            Loss(drives, np.arange(3), weights)


def test_the_logistic_is_the_most_likely_one() -> None:
    from scipy.optimize import minimize

    score = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.6, 0.8, 1.0])
    failed = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0])

    def likelihood(values: Any) -> float:
        p = 1.0 / (1.0 + np.exp(-(values[0] + values[1] * score)))
        return -float((failed * np.log(p) + (1.0 - failed) * np.log(1.0 - p)).sum())

    ours = Logistic.fitted(score, failed)
    best = minimize(likelihood, [0.0, 1.0])
    assert likelihood([ours.intercept, ours.slope]) == pytest.approx(best.fun, rel=1e-3)
    # More share outside is never taken for less chance of failing.
    assert Logistic.fitted(score, 1.0 - failed) == Logistic(0.0, 0.0)


# Figures


def test_figures_of_a_ranking_agree_with_counting() -> None:
    score = np.array([0.9, 0.5, 0.5, 0.5, 0.1, 0.8])
    failed = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    pairs = [(a > b) + 0.5 * (a == b) for a in score[:2] for b in score[2:]]
    assert auc_of(score, failed) == pytest.approx(np.mean(pairs))
    assert auc_of(score, np.ones(6)) is None
    roads, found = found_by(score, failed)
    assert roads == pytest.approx(np.arange(7) / 6)
    # One of the three equal ones fails: a third of a failure each.
    assert found == pytest.approx(np.array([0, 1, 1, 4 / 3, 5 / 3, 2, 2]) / 2)


def test_the_linear_baseline_finds_a_line() -> None:
    x = np.random.default_rng(1).normal(size=(200, 2))
    features = np.column_stack((x, np.ones(200)))
    assert linear_model(features, 3.0 * x[:, 0] + 1.0) == pytest.approx([3.0, 0.0, 1.0], abs=0.05)


def test_a_difference_has_the_error_of_its_independent_groups() -> None:
    d = np.array([1.0, 1.0, -1.0, -1.0])
    mean, error = difference(d, np.zeros(4), np.arange(4))
    assert (mean, error) == pytest.approx((0.0, math.sqrt(4 / 3) / 2))
    _, in_pairs = difference(d, np.zeros(4), np.array([0, 0, 1, 1]))
    assert in_pairs == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("failures", "auc", "low", "lift", "baseline", "verdict"),
    [
        (30, 0.8, 0.7, 3.0, 0.6, "good"),
        (30, 0.8, 0.7, 3.0, 0.8, "poor"),  # no better than a baseline
        (30, 0.8, 0.7, 1.5, 0.6, "fair"),
        (30, 0.7, 0.6, 3.0, 0.6, "fair"),
        (30, 0.6, 0.45, 3.0, 0.5, "poor"),
        (30, 0.8, 0.7, 1.0, 0.6, "poor"),
        (160, 0.8, 0.7, 1.2, 0.6, "good"),  # of 1.25 that are possible
        (9, 0.9, 0.8, 9.0, 0.6, "unknown"),
        (195, 0.9, 0.8, 1.0, 0.6, "unknown"),
    ],
)
def test_the_verdict(
    failures: int, auc: float, low: float, lift: float, baseline: float, verdict: str
) -> None:
    twin = Figures(drives=200, failures=failures, auc=auc, top_tenth=lift)
    other = Figures(drives=200, failures=failures, auc=baseline)
    found, reason = verdict_of(twin, (low, 0.95), {"length": other})
    assert found == verdict
    assert ("length ranks no worse" in reason) == (baseline >= auc)


def test_a_twin_no_better_than_before_its_fit_is_fair() -> None:
    twin = Figures(drives=200, failures=30, auc=0.8, top_tenth=3.0)
    found, reason = verdict_of(twin, (0.7, 0.9), {UNFITTED: twin})
    assert found == "fair"
    assert "the driver as it was ranks no worse" in reason
    found, reason = verdict_of(twin, (0.7, 0.9), {UNFITTED: twin, "length": twin})
    assert found == "poor"
    assert "the driver as it was and length rank no worse" in reason


def test_a_twin_that_fails_more_or_less_often_is_told() -> None:
    for ours, is_told in ((0, True), (29, False), (46, True)):
        twin = Figures(drives=200, failures=30, auc=0.8, top_tenth=3.0, twin_failures=ours)
        _, reason = verdict_of(twin, (0.7, 0.9), {})
        assert ("trust its order, not its outcomes" in reason) == is_told


# What is refused


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ([Asked("brakng")], r"no parameter 'brakng' to fit; did you mean 'braking'\? stanley has:"),
        ([Asked("braking"), Asked("driver.braking")], "driver.braking is to be fitted twice"),
        ([Asked("braking", 4.0, 1.0)], "bounds of driver.braking are 4:1: LOW:HIGH"),
        ([Asked("braking", -1.0, 1.0)], "driver.braking cannot be -1: .*braking is -1"),
        ([Asked("friction", 0.5, 9.0)], "vehicle.friction cannot be 9: .*lifts an axle"),
        ([Asked("delay")], "layer.delay is 0, so it has no usual bounds"),
        ([], "nothing is to be fitted"),
    ],
)
def test_parameters_that_cannot_be_fitted(asked: list[Asked], message: str) -> None:
    with pytest.raises(FreneticError, match=message):
        Model.of("stanley", asked)


def test_usual_bounds_end_where_no_car_can_be_made() -> None:
    (friction,) = Model.of("planner", [Asked("friction")]).parameters
    assert friction.low == 0.25
    assert 1.0 < friction.high < 2.0
    _, simulator = Model.of("planner", [Asked("friction")]).make(
        {"vehicle.friction": friction.high}, Rules()
    )
    assert simulator.friction == friction.high


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda line: line | {"outcome": None}, "row 1 has no outcome"),
        (lambda line: line | {"outcome": "MAYBE"}, "its outcome is 'MAYBE': PASS or FAIL"),
        (lambda line: line | {"curvatures": "x"}, r"got `str` - at `\$.curvatures`"),
        (lambda line: line | {"max_oob_share": "much"}, "its max_oob_share is 'much': a number"),
        (lambda line: line | {"trajectory": {"time": [0, 1]}}, "its trajectory has no x"),
        (lambda line: line | {"trajectory": [[0, 1, 2], [1, 2]]}, "trajectory"),
        (lambda line: line | {"execution_data": [[1, 2]]}, "are no records of a drive"),
        (lambda line: line | {"trajectory": 3}, "its trajectory is"),
        (lambda line: line | {"trajectory": MOVES | {"speed": 5}}, "its speed is not a list of nu"),
        (lambda line: line | {"trajectory": MOVES | {"x": [HUGE] * 2}}, "its x is not a list of n"),
        (lambda line: line | {"trajectory": [[0, HUGE, 2]] * 2}, "its x is not a list of numbers"),
        (lambda line: line | {"max_oob_share": HUGE}, "its max_oob_share is 9999.*: a number"),
        (
            lambda line: line | {"execution_data": [drive_record(0), drive_record(1, HUGE)]},
            "are no records of a drive",
        ),
        (
            lambda line: line | {"execution_data": [drive_record(0), drive_record(1, math.nan)]},
            r"vel of record 2 of its execution_data is \[nan, 0\.0, 0\.0\]: finite numbers",
        ),
        (lambda line: line | {"outcome": ["PASS"]}, r"its outcome is \['PASS'\]: PASS or FAIL"),
        (lambda line: line | {"execution_data": 3}, "are no records of a drive"),
        (lambda line: [line], "an object is needed"),
    ],
)
def test_a_damaged_table_names_its_row(
    tmp_path: Path, change: Callable[[Any], Any], message: str
) -> None:
    table = tmp_path / "tests.jsonl"
    line = change({"curvatures": [0.0, 0.01], "outcome": "PASS"})
    table.write_text(json.dumps(line) + "\n", encoding="utf-8")
    with pytest.raises(FreneticError, match=message) as caught:
        read_recordings([table])
    assert str(table) in str(caught.value)


@pytest.mark.parametrize("cut", [100, -100])
def test_a_damaged_parquet_table_is_named(campaigns: list[Path], tmp_path: Path, cut: int) -> None:
    from frenetic.export import export_campaign

    export_campaign(campaigns[0], "parquet", tmp_path / "out")
    table = tmp_path / "out" / "tests.parquet"
    table.write_bytes(table.read_bytes()[:cut])
    with pytest.raises(FreneticError, match=r"tests.parquet is no table in Parquet"):
        read_recordings([table])


@pytest.mark.parametrize("form", ["csv", "json", "parquet"])
def test_a_file_that_no_memory_holds_is_refused(
    campaigns: list[Path], tmp_path: Path, form: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    from frenetic.export import export_campaign

    export_campaign(campaigns[0], form, tmp_path / "out")
    monkeypatch.setattr(recordings_file, "MAX_BYTES", 100)
    with pytest.raises(FreneticError, match="has more than 100 bytes: split it"):
        read_recordings([tmp_path / "out"])


def test_recordings_under_different_terms_are_not_mixed(
    campaigns: list[Path], tmp_path: Path
) -> None:
    table = tmp_path / "tests.csv"
    table.write_text('curvatures,outcome\n"[0.0, 0.01]",PASS\n', encoding="utf-8")
    for place in (tmp_path / "nowhere", tmp_path / "empty"):
        if place.name == "empty":
            place.mkdir()
        with pytest.raises(FreneticError, match=r"no file or folder|holds no recording"):
            read_recordings([place])
    with pytest.raises(FreneticError, match="given twice"):
        read_recordings([campaigns[0], campaigns[0]])
    assert len(read_recordings([campaigns[0], table]).drives) == 9
    (tmp_path / "faster").mkdir()
    other = tmp_path / "faster" / "test.0001.json"
    other.write_text(
        json.dumps({"road_points": [[0, 0], [0, 50]], "test_outcome": "PASS"}), encoding="utf-8"
    )
    (tmp_path / "faster" / "experiment_description.csv").write_text(
        "speed_limit,oob_tolerance\n90,0.85\n", encoding="utf-8"
    )
    with pytest.raises(FreneticError, match=r"speed_limit 70 and 90 and oob_tol"):
        read_recordings([campaigns[0], tmp_path / "faster"])
    (tmp_path / "faster" / "experiment_description.csv").write_text(
        f"speed_limit\n{'9' * 200_000}\n", encoding="utf-8"
    )
    with pytest.raises(FreneticError, match=r"description.csv: its speed_limit is .* a number"):
        read_recordings([tmp_path / "faster"])


def test_a_driver_that_breaks_is_named(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.py").write_text(BROKEN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    broken = Model.of("mine.py:Broken", [Asked("gain")])
    state = tmp_path / "twin.fit.jsonl"
    with pytest.raises(FreneticError, match=r"gain 1 broke on 1 of 1 .* ValueError: no"):
        calibrate(recordings, broken, QUICK, state=state)
    assert not state.exists()  # going on would end here again


def test_a_driver_that_hangs_is_broken_soon(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "hangs.py").write_text(HANGS, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    hangs = Model.of("hangs.py:Broken", [Asked("gain")])
    with pytest.raises(FreneticError, match=r"broke on 1 of 1 .* its drive took more than 0.5 s"):
        calibrate(recordings, hangs, QUICK, drive_limit=0.5)


def test_a_line_of_json_ends_with_a_line_feed_alone(tmp_path: Path) -> None:
    row = {"curvatures": [0.0, 0.01], "outcome": "PASS", "run": "a\u2028b\x85c"}
    table = tmp_path / "tests.jsonl"
    table.write_text(json.dumps(row, ensure_ascii=False) + "\n", encoding="utf-8")
    (drive,) = read_recordings([table]).drives
    assert drive.run.endswith("a\u2028b\x85c")


def test_the_digest_of_a_recording_is_that_of_its_content(
    campaigns: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (moved := tmp_path / "elsewhere").mkdir()
    for folder in campaigns:
        shutil.copytree(folder, moved / folder.name)
    monkeypatch.chdir(moved)
    digests = [
        *read_recordings([campaigns[0].parent]).digests.values(),
        *read_recordings([moved]).digests.values(),
        *read_recordings([Path()]).digests.values(),
    ]
    assert len(set(digests)) == 1
    assert set(read_recordings(campaigns).digests.values()).isdisjoint(digests)


def test_too_few_drives_are_refused(recordings: Recordings, model: Model) -> None:
    few = Recordings(recordings.drives[:9], recordings.terms, recordings.digests, 0)
    with pytest.raises(FreneticError, match="9 recorded drives: at least 10"):
        calibrate(few, model)
    with pytest.raises(ValueError, match="folds is 1"):
        calibrate(recordings, model, Settings(folds=1))


@pytest.mark.parametrize("form", ["csv", "json", "parquet", "competition"])
def test_an_export_is_read_as_its_campaign(
    campaigns: list[Path], tmp_path: Path, form: Any
) -> None:
    from frenetic.export import export_campaign

    export_campaign(campaigns[0], form, tmp_path / "out", trajectories="all")
    found = read_recordings([tmp_path / "out"]).drives
    own = read_recordings([campaigns[0]]).drives
    assert [one.failed for one in found] == [one.failed for one in own]
    for theirs, ours in zip(found, own, strict=True):
        assert theirs.max_oob_share == pytest.approx(ours.max_oob_share, abs=1e-4)
        m = min(len(theirs.offset), len(ours.offset))
        assert abs(len(theirs.offset) - len(ours.offset)) <= 1
        assert theirs.offset[:m] == pytest.approx(ours.offset[:m], abs=1e-3)
        assert theirs.speed[:m] == pytest.approx(ours.speed[:m], abs=0.2)
        assert math.isnan(theirs.departure) == math.isnan(ours.departure)


def test_the_shape_of_a_speed_is_one_in_the_mean_and_a_standing_car_has_none() -> None:
    speed = np.array([np.nan, 2.0, 4.0, 6.0])
    np.testing.assert_array_equal(shape_of(speed), [np.nan, 0.5, 1.0, 1.5])
    np.testing.assert_array_equal(shape_of(np.zeros(3)), np.zeros(3))
