"""Calibration reads recordings, finds known parameters and says which stay undetermined."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from frenetic import Budget, Campaign, EmbeddedSimulator, RandomSearch, Stanley
from frenetic.errors import FreneticError
from frenetic.export import export_campaign
from frenetic.oracle.drive import Rules
from frenetic.plugins.twin import calibration
from frenetic.plugins.twin.calibration import calibrate, folds_of
from frenetic.plugins.twin.intervals import mean_difference
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import PredictionFigures, TwinProfile
from frenetic.plugins.twin.recordings import Recordings, read_recordings
from frenetic.plugins.twin.verdict import UNFITTED, answer, auc_of, top_tenth, verdict_of

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TRUE_ACCELERATION = 7.3  # [m/s^2], lateral, of the recorded driver
RAISING_DRIVER = """
class Raises:
    def __init__(self, gain=1.0):
        self.gain = gain

    def reset(self, setup):
        pass

    def act(self, observation):
        raise ValueError("no")
"""


@pytest.fixture(scope="module", autouse=True)
def quick_fits() -> Iterator[None]:
    """Fit from one start and validate on two folds, for speed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "RANDOM_STARTS", 0)
        patch.setattr(calibration, "FOLDS", 2)
        yield


def record_campaign(
    folder: Path, seed: int, drives: int, lateral_acceleration: float = TRUE_ACCELERATION
) -> Path:
    """Drive random roads with a driver of this lateral acceleration; return the folder."""
    Campaign(
        strategy=RandomSearch(seed=seed),
        driver=Stanley(lateral_acceleration=lateral_acceleration),
        simulator=EmbeddedSimulator(),
        budget=Budget(simulations=drives),
        folder=folder,
    ).run()
    return folder


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recorded")
    return [record_campaign(folder / f"run-{seed}", seed, 8) for seed in (101, 102)]


@pytest.fixture(scope="module")
def recordings(campaigns: list[Path]) -> Recordings:
    return read_recordings(campaigns)


# Fitted parameters


@pytest.mark.heavy
def test_a_fit_finds_known_parameters_and_names_undetermined_ones(
    recordings: Recordings, tmp_path: Path
) -> None:
    model = TwinModel.of("stanley", ["lateral_acceleration", "vehicle.brake_deceleration=7:9"])
    profile = calibrate(recordings, model)
    acceleration, braking = profile.fitted
    assert acceleration.value == pytest.approx(TRUE_ACCELERATION, rel=0.01)
    assert acceleration.from_ <= TRUE_ACCELERATION <= acceleration.to
    assert acceleration.is_determined
    # No drive brakes hard enough to determine the limit.
    assert not braking.is_determined
    assert (braking.from_, braking.to) == pytest.approx((7.0, 9.0))
    assert profile.validation is not None
    assert profile.validation.by == "run"
    assert profile.validation.twin.offset_error is not None
    assert profile.validation.twin.offset_error < 0.05
    profile.write(tmp_path / "twin.json")
    read_profile = TwinProfile.read(tmp_path / "twin.json")
    assert read_profile == profile
    driver: Any = read_profile.spec().make_driver()
    simulator: Any = read_profile.spec().make_simulator()
    values = [acceleration.value, braking.value]
    assert [driver.lateral_acceleration, simulator.vehicle.brake_deceleration] == values


@pytest.mark.heavy
def test_parameters_with_the_same_effect_are_undetermined(recordings: Recordings) -> None:
    fit = ["vehicle.friction=0.5:1.2", "vehicle.tyre_peak=0.5:1.5"]
    model = TwinModel.of("stanley", fit, driver_options={"lateral_acceleration": TRUE_ACCELERATION})
    for parameter in calibrate(recordings, model).fitted:
        assert parameter.to / parameter.from_ > 1.3


@pytest.mark.heavy
def test_an_interval_that_ends_at_a_bound_gives_a_warning(
    tmp_path: Path,
) -> None:
    slow = read_recordings([record_campaign(tmp_path / "slow", 101, 12, 2.5)])
    narrow, usual = (
        calibrate(slow, TwinModel.of("stanley", [f"lateral_acceleration{bounds}"]))
        for bounds in ("=3:12", "")
    )
    (acceleration,) = narrow.fitted
    assert acceleration.from_ == pytest.approx(3.0)
    assert (acceleration.at_bound, acceleration.is_determined) == (True, False)
    assert answer(narrow).endswith(
        "; the bounds decide driver.lateral_acceleration: widen them, and calibrate again"
    )
    (acceleration,) = usual.fitted
    assert acceleration.value == pytest.approx(2.5, rel=0.03)
    assert acceleration.is_determined
    assert "widen" not in answer(usual)


def test_runs_of_a_road_are_held_out_together(recordings: Recordings) -> None:
    run = [d for d in recordings.drives if d.run == recordings.runs[0]]
    fold = folds_of([*run, *run], by_run=False)
    assert (fold[: len(run)] == fold[len(run) :]).all()
    assert sorted(set(fold.tolist())) == [0, 1]
    by_run = folds_of(recordings.drives, by_run=True)
    assert len({(d.run, k) for d, k in zip(recordings.drives, by_run, strict=True)}) == 2
    with pytest.raises(FreneticError, match="of one road"):
        folds_of([run[0], run[0]], by_run=False)


def test_too_few_recordings_and_a_driver_that_raises_are_refused(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few = Recordings(recordings.drives[:9], recordings.terms, 0)
    with pytest.raises(FreneticError, match="9 recorded drives: at least 10"):
        calibrate(few, TwinModel.of("stanley", ["braking"]))
    (tmp_path / "mine.py").write_text(RAISING_DRIVER, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FreneticError, match="the driver broke: the driver raised ValueError: no"):
        calibrate(recordings, TwinModel.of("mine.py:Raises", ["gain"]))


# Figures


def test_figures_of_a_ranking_agree_with_counting() -> None:
    score = np.array([0.9, 0.5, 0.5, 0.5, 0.1, 0.8])
    failed = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    pairs = [(a > b) + 0.5 * (a == b) for a in score[:2] for b in score[2:]]
    assert auc_of(score, failed) == pytest.approx(np.mean(pairs))
    assert auc_of(score, np.ones(6)) is None
    ranks, fails = np.arange(20.0), np.zeros(20)
    fails[[18, 19]] = 1.0  # both roads of the top tenth fail
    assert top_tenth(ranks, fails) == pytest.approx(10.0)
    ranks[17:] = 19.0  # three equal roads, two of which fail, share the two first ranks
    assert top_tenth(ranks, fails) == pytest.approx(10.0 * 2 / 3)


def test_a_difference_has_the_error_of_its_independent_groups() -> None:
    d = np.array([1.0, 1.0, -1.0, -1.0])
    mean, error = mean_difference(d, np.zeros(4), np.arange(4))
    assert (mean, error) == pytest.approx((0.0, math.sqrt(4 / 3) / 2))
    _, in_pairs = mean_difference(d, np.zeros(4), np.array([0, 0, 1, 1]))
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
        (160, 0.8, 0.7, 1.2, 0.6, "good"),  # 1.25 is the highest possible lift
        (9, 0.9, 0.8, 9.0, 0.6, "unknown"),
        (195, 0.9, 0.8, 1.0, 0.6, "unknown"),
    ],
)
def test_the_verdict_follows_from_failures_auc_lift_and_baseline(
    failures: int, auc: float, low: float, lift: float, baseline: float, verdict: str
) -> None:
    twin, baseline_figures = (
        PredictionFigures(auc=auc, top_tenth=lift),
        PredictionFigures(auc=baseline),
    )
    failed = (np.arange(200) < failures).astype(float)
    rating, reason = verdict_of(twin, failed, (low, 0.95), {"length": baseline_figures})
    assert rating == verdict
    assert ("length ranks no worse" in reason) == (baseline >= auc)


def test_the_reason_names_better_baselines_and_a_wrong_number_of_failures() -> None:
    failed = (np.arange(200) < 30).astype(float)
    twin = PredictionFigures(auc=0.8, top_tenth=3.0)
    rating, reason = verdict_of(twin, failed, (0.7, 0.9), {UNFITTED: twin})
    assert rating == "fair"
    assert "the driver as it was ranks no worse" in reason
    rating, reason = verdict_of(twin, failed, (0.7, 0.9), {UNFITTED: twin, "length": twin})
    assert rating == "poor"
    assert "the driver as it was and length rank no worse" in reason
    for twin_failures, has_warning in ((0, True), (29, False), (46, True)):
        twin = PredictionFigures(auc=0.8, top_tenth=3.0, twin_failures=twin_failures)
        _, reason = verdict_of(twin, failed, (0.7, 0.9), {})
        assert ("trust its order, not its outcomes" in reason) == has_warning


# The model


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        (["brakng"], r"no parameter 'brakng' to fit; did you mean 'braking'\? stanley has:"),
        (["braking", "driver.braking"], "driver.braking is to be fitted twice"),
        (["braking=4:1"], "bounds of driver.braking are 4:1: LOW:HIGH"),
        (["braking=1:x"], "bounds of driver.braking are 1:x: LOW:HIGH"),
        (["braking=1"], "bounds of driver.braking are 1: LOW:HIGH"),
        (["braking=-1:1"], "driver.braking cannot be -1: .*braking is -1"),
        (["friction=0.5:9"], "vehicle.friction cannot be 9: .*lifts an axle"),
        (["delay"], "condition.delay is 0, so it has no usual bounds"),
        ([], "nothing is to be fitted"),
    ],
)
def test_parameters_that_cannot_be_fitted_are_refused(fit: list[str], message: str) -> None:
    with pytest.raises(FreneticError, match=message):
        TwinModel.of("stanley", fit)


def test_usual_bounds_end_where_no_car_can_be_made() -> None:
    model = TwinModel.of("planner", ["friction"])
    (friction,) = model.parameters
    assert friction.low == 0.25
    assert 1.0 < friction.high < 2.0
    _, simulator = model.make({"vehicle.friction": friction.high}, Rules())
    assert simulator.friction == friction.high


# Recordings

HUGE = int("9" * 320)
"""A number that fits into JSON, but not into a float."""
MOVES = {"time": [0, 1], "x": [0, 5], "y": [0, 0]}


def row_of(**more: Any) -> str:
    """Return a table's row, a passed test with these entries."""
    return json.dumps({"curvatures": [0.0, 0.01], "outcome": "PASS"} | more)


DRIVE = row_of(
    road_points=[[60, 100], [110, 100]],
    curvatures=None,
    run="a\u2028b",
    trajectory={
        "time": [0.5 * i for i in range(9)],
        "x": [60.0 + 5.0 * i for i in range(9)],
        "y": [100.0] * 9,
    },
)


@pytest.mark.heavy
def test_an_export_reads_like_its_campaign(campaigns: list[Path], tmp_path: Path) -> None:
    export_campaign(campaigns[0], "competition", tmp_path / "out", trajectories="all")
    exported = read_recordings([tmp_path / "out"]).drives
    originals = read_recordings([campaigns[0]]).drives
    assert [drive.failed for drive in exported] == [drive.failed for drive in originals]
    for drive, original in zip(exported, originals, strict=True):
        assert drive.road.pose == pytest.approx(original.road.pose, abs=1e-3)
        m = min(drive.states.shape[1], original.states.shape[1])
        assert abs(drive.states.shape[1] - original.states.shape[1]) <= 1
        assert drive.states[0, :m] == pytest.approx(original.states[0, :m], abs=1e-3)
        assert drive.states[1, :m] == pytest.approx(original.states[1, :m], abs=0.2)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (row_of(outcome=None), "row 1 has no outcome"),
        (row_of(outcome="MAYBE"), r"'MAYBE' - at `\$.outcome`"),
        (row_of(curvatures=None, trajectory=MOVES), "row 1"),
        (row_of(curvatures="x"), r"got `str` - at `\$.curvatures`"),
        (row_of(trajectory={"time": [0, 1]}), r"missing required field `x` - at `\$.trajectory`"),
        (row_of(trajectory=MOVES | {"speed": 5}), r"`\$.trajectory.speed`"),
        (row_of(trajectory=MOVES | {"x": [HUGE] * 2}), r"row 1 says no drive"),
        (row_of(trajectory=MOVES | {"x": [1]}), "as many times as places"),
        (row_of(trajectory=MOVES | {"time": [1, 1]}), "do not grow"),
        (row_of(execution_data=[[1, 2]]), r"`\$.execution_data\[0\]"),
        (row_of(trajectory=MOVES | {"y": [math.nan] * 2}), "row 1 says no drive"),
        ("[{}]", "row 1 says no drive"),
        ("[" * 10**5, "row 1 says no drive"),
    ],
)
def test_a_damaged_table_names_its_row_and_the_place_in_it(
    tmp_path: Path, line: str, message: str
) -> None:
    table = tmp_path / "tests.jsonl"
    table.write_text(line + "\n", encoding="utf-8")
    with pytest.raises(FreneticError, match=message) as caught:
        read_recordings([table])
    assert str(caught.value).startswith(f"{table}, row 1")


def test_a_calibration_without_recordings_is_refused() -> None:
    with pytest.raises(FreneticError, match="there are no recordings"):
        read_recordings([])


def test_recordings_under_different_terms_are_not_mixed(
    campaigns: list[Path], tmp_path: Path
) -> None:
    table = tmp_path / "tests.jsonl"
    table.write_text(f"{DRIVE}\n{row_of()}\n", encoding="utf-8")
    recordings = read_recordings([table])
    assert recordings.skipped == 1  # without a trajectory
    assert recordings.drives[0].run == f"{table}, a\u2028b"
    assert recordings.drives[0].states[1] == pytest.approx([10.0] * 21)  # from places and times
    assert len(read_recordings([campaigns[0], table]).drives) == 9
    faster = tmp_path / "faster"
    Campaign(
        strategy=RandomSearch(seed=1),
        driver=Stanley(),
        simulator=EmbeddedSimulator(rules=Rules(speed_limit=90.0)),
        folder=faster,
    ).run(1)
    with pytest.raises(FreneticError, match="speed limit 70, not 90"):
        read_recordings([campaigns[0], faster])


# The command

FIT_FILE = """
recordings = ["slow"]
driver = "stanley"
fit = ["lateral_acceleration=5:9", "delay=0:0.1"]
"""
FIT = ("--driver", "stanley", "--fit", "lateral_acceleration=5:9,delay=0:0.1")


def test_calibrate_prints_a_verdict_and_writes_a_profile(frenetic: Frenetic) -> None:
    record_campaign(Path("slow"), 101, 12)
    Path("fit.toml").write_text(FIT_FILE, encoding="utf-8")
    result = frenetic("calibrate", "fit.toml", "--fit", "delay=0:0.1", "--out", "new/twin.json")
    assert result.code == 0
    for words in ("condition.delay", "largest curvature", "start from"):
        assert words in result.out
    profile = TwinProfile.read("new/twin.json")
    assert profile.validation is not None
    assert (profile.validation.by, profile.validation.drives) == ("road", 12)


@pytest.mark.parametrize(
    ("entries", "options", "words"),
    [
        ("", ("nowhere", *FIT), ("nowhere",)),
        ("", ("slow", *FIT[:2], "--fit", "brakng"), ("no parameter 'brakng'", "'braking'?")),
        ("", ("slow", *FIT[2:]), ("the twin has no driver",)),
        ("", ("slow", *FIT, "--out", "twin.toml"), ("name ends with .json",)),
        ("", ("slow", *FIT, "--vehicle", "tank"), ("'tank': default, metadrive or etk800",)),
        (
            "terms = {oob_tolerance = 2}",
            ("fit.toml",),
            ("terms.oob_tolerance is 2: a number <= 1 is needed",),
        ),
        ("fold = 1", ("fit.toml",), ("there is no entry 'fold'; there are recordings, terms",)),
    ],
)
def test_calibrate_answers_a_mistake_in_one_line(
    frenetic: Frenetic, entries: str, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    Path("slow").mkdir()
    Path("slow/one.json").write_text(DRIVE, encoding="utf-8")
    Path("fit.toml").write_text(FIT_FILE + entries, encoding="utf-8")
    assert frenetic("calibrate", *options).refuses(*words)
