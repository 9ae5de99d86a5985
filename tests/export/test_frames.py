"""Data frames hold the campaign's tests, with types of pandas."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from frenetic.analysis.campaign_measures import measure_campaign
from frenetic.analysis.clusters import Clusters, distinct_failures
from frenetic.analysis.curves import campaign_curves
from frenetic.analysis.measures import MEASURES
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.drivers import Planner
from frenetic.errors import CampaignError, Fault
from frenetic.export import TABLES, data_frame
from frenetic.export.table_columns import COLUMNS, FAILURE_COLUMNS
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.road.classes import RoadClass
from frenetic.road.profile import NAMES
from frenetic.search import RandomSearch
from frenetic.search.records import SourceTest
from frenetic.segments.causes import as_text, cause_of
from frenetic.segments.features import FEATURES
from frenetic.simulators import EmbeddedSimulator

if TYPE_CHECKING:
    from sample_campaign import RewriteCampaign

pytest_plugins = ["sample_campaign"]
pytestmark = pytest.mark.heavy
FAILURE_NAMES = [column.name for column in FAILURE_COLUMNS]
PAGE = Path(__file__).parents[2] / "docs" / "files.md"


@pytest.fixture(scope="session")
def campaign(sample_campaign: Path) -> Path:
    return sample_campaign


def rows_on_page(table: str) -> list[str]:
    """Return the rows about a table's columns, without their first bar."""
    text = PAGE.read_text(encoding="utf-8")
    section = text[text.index(f"**{table}**, one row per") :].split("\n\n")[1]
    return re.findall(r"^\| (`.*)$", section, re.MULTILINE)


def expected_segment(test: Test) -> dict[str, Any]:
    """Return what a row is expected to say of the road and the drive around a test's place."""
    values = test.segment_values
    names = ["place", "place_speed", "segment_least_radius", *(f"segment_{n}" for n in FEATURES)]
    if values is None:
        return dict.fromkeys([*names, "slowest", "fastest"])
    assert test.drive is not None
    assert test.segment is not None
    speed, along = test.drive.trajectory.speed, test.segment.assessment.distance
    curvature = values.features["max_curvature"]
    return {
        "place": values.place,
        "place_speed": pytest.approx(np.interp(values.place, along, speed[: len(along)]), abs=0.5),
        "segment_least_radius": 1.0 / curvature if curvature else None,
        **{f"segment_{name}": value for name, value in values.features.items()},
        "slowest": values.slowest,
        "fastest": speed.max(),
    }


def expected_failure(test: Test, clusters: Clusters) -> dict[str, Any]:
    """Return what a row is expected to say of a failure."""
    finding = test.result.finding
    row = dict.fromkeys(FAILURE_NAMES) | {"criterion": finding and finding.criterion}
    if test.outcome is not Outcome.FAIL:
        return row
    numbers = [number for number, cluster in enumerate(clusters, 1) if test.id in cluster.ids]
    row["distinct_failure"] = numbers[0] if numbers else None
    if test.result.fault is not None:
        return row | {"cause": str(test.result.fault)}
    assert test.segment is not None
    cause = cause_of(test.segment)
    return row | {"cause": as_text(cause.kind), "cause_side": cause.bend_side}


def expected(test: Test, clusters: Clusters) -> dict[str, Any]:
    """Return a test's expected row of the table."""
    candidate, result = test.candidate, test.result
    curvatures = candidate.curvatures.tolist()
    x, y, heading = test.pose or (None, None, None)
    departure = test.departure
    return {
        "id": candidate.id,
        "result_number": test.result_number,
        "outcome": test.outcome.value,
        "reason": result.reason,
        "operator": candidate.origin.operator,
        "parents": list(candidate.origin.parents),
        "generation": candidate.origin.generation,
        "length": (len(curvatures) - 1) * candidate.step,
        "max_curvature": max(map(abs, curvatures)),
        "largest_change": max(abs(b - a) for a, b in pairwise([0.0, *curvatures])),
        "curvatures": curvatures,
        "step": candidate.step,
        "x": x,
        "y": y,
        "heading": heading,
        **dict.fromkeys(NAMES),
        "moobd": result.moobd,
        "moobd_distance": result.moobd_distance,
        "max_oob_share": result.max_oob_share,
        "objective": test.objective,
        "duration": result.duration and round(result.duration, 6),
        "distance": result.distance,
        "departure_time": departure and round(departure.time, 6),
        "departure_distance": departure and departure.distance,
        "departure_x": departure and departure.x,
        "departure_y": departure and departure.y,
        "departure_side": departure and departure.side,
        **expected_failure(test, clusters),
        **expected_segment(test),
        "seconds": test.seconds,
        "elapsed": test.elapsed,
        "attempts": test.attempts,
        "worker": test.worker,
        "budget_spent": test.budget_spent,
        "finished_at": datetime.fromisoformat(test.finished_at),
        "repeat": candidate.repeat,
        "source": candidate.source
        and {"campaign": candidate.source.campaign, "test": candidate.source.test},
        "notes": candidate.notes or None,
        "fault": result.fault and vars(result.fault),
        "records": test.records,
    }


def plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value if isinstance(value, dict) or not pd.isna(value) else None


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    return [{name: plain(value) for name, value in row.items()} for row in frame.to_dict("records")]


def expected_rows(folder: Path) -> list[dict[str, Any]]:
    with CampaignStore.open(folder) as store:
        clusters = distinct_failures(store)
        return [expected(test, clusters) for test in store.tests(with_trajectory=True)]


def test_a_frame_has_the_values_of_the_tests(campaign: Path) -> None:
    frame = data_frame(campaign)
    rows = expected_rows(campaign)
    assert rows_of(frame) == rows
    assert list(frame.columns) == list(rows[0])
    for table, columns in TABLES.items():  # the page names every column and no other
        named = [row.partition("|")[0] for row in rows_on_page(table)]
        assert {name for row in named for name in re.findall(r"`(\w+)`", row)} == {*columns}
    assert {row["outcome"] for row in rows} == {"PASS", "FAIL", "INVALID", "DROPPED"}


def test_a_frame_has_values_that_only_some_tests_have(
    rewrite_campaign: RewriteCampaign,
) -> None:
    def change(test: Test) -> Test:
        if test.result_number != 5:
            return test
        fault = Fault("driver", "ValueError", "mine.py", 7)
        return replace(
            test,
            candidate=replace(
                test.candidate,
                conditions={"noise_seed": 2**31 - 1, "fog": 60.5},
                repeat=2,
                source=SourceTest("nightly", 31),
                notes={"looked at": [4000, None]},
            ),
            worker="w1",
            result=replace(test.result, findings=(), fault=fault),
            objective=-0.5,
        )

    folder = rewrite_campaign(change)
    frame = data_frame(folder)
    rows, expected_values = rows_of(frame), expected_rows(folder)
    conditions = {"condition_fog": 60.5, "condition_noise_seed": 2**31 - 1}
    row = rows[4]
    assert row == expected_values[4] | conditions
    assert rows[3] == expected_values[3] | dict.fromkeys(conditions)
    assert list(frame.columns)[-2:] == list(conditions)
    assert [str(kind) for kind in frame.dtypes.iloc[-2:]] == ["Float64", "Int64"]
    assert row["source"] == {"campaign": "nightly", "test": 31}
    assert row["fault"]["kind"] == "ValueError"
    assert (row["worker"], row["objective"], row["departure_time"]) == ("w1", -0.5, None)


TYPES = {
    "id": "int64",
    "reason": "string",
    "outcome": "category",
    "operator": "string",
    "worker": "string",
    "departure_side": "category",
    "cause": "string",
    "cause_certainty": "category",
    "distinct_failure": "Int64",
    "segment_bends": "Float64",
    "length": "float64",
    "seconds": "float64",
    "moobd": "Float64",
    "objective": "Float64",
    "records": "Int64",
    "finished_at": "datetime64[ms, UTC]",
    "curvatures": "object",
}


def test_columns_have_pandas_types_even_without_tests(campaign: Path, tmp_path: Path) -> None:
    with CampaignStore.create(tmp_path / "empty", {}):
        pass
    frame, empty = data_frame(campaign), data_frame(tmp_path / "empty")
    assert len(empty) == 0
    assert list(empty.columns) == list(frame.columns)
    for rows in (frame, empty):
        assert {name: str(rows[name].dtype) for name in TYPES} == TYPES
        assert list(rows["outcome"].cat.categories) == [str(outcome) for outcome in Outcome]
        assert list(rows["departure_side"].cat.categories) == ["left", "right"]
    paths, none = (data_frame(f, "trajectories") for f in (campaign, tmp_path / "empty"))
    assert len(none) == 0
    assert paths.dtypes.equals(none.dtypes)


def test_outcomes_can_be_chosen(campaign: Path) -> None:
    whole = data_frame(campaign)
    for outcomes in (["FAIL"], [Outcome.FAIL, "INVALID"]):
        frame = data_frame(campaign, outcomes=outcomes)
        assert list(frame["id"]) == list(whole["id"][whole["outcome"].isin(outcomes)])


@pytest.mark.parametrize("outcome", ["FAIL", Outcome.FAIL])
def test_a_single_outcome_equals_a_list_of_this_outcome(campaign: Path, outcome: str) -> None:
    assert data_frame(campaign, outcomes=outcome).equals(data_frame(campaign, outcomes=["FAIL"]))


def test_tests_can_be_chosen_by_their_ids(campaign: Path) -> None:
    whole = data_frame(campaign)
    chosen = whole.iloc[[7, 3]]
    for ids in (chosen["id"], chosen["id"].tolist()):
        frame = data_frame(campaign, tests=ids)
        pd.testing.assert_frame_equal(frame, chosen.reset_index(drop=True))
    records = data_frame(campaign, "trajectories", tests=chosen["id"].iloc[0])
    everything = data_frame(campaign, "trajectories")
    expected_records = everything[everything["id"] == chosen["id"].iloc[0]]
    pd.testing.assert_frame_equal(records, expected_records.reset_index(drop=True))
    assert len(data_frame(campaign, tests=[])) == 0
    with pytest.raises(CampaignError, match="999"):
        data_frame(campaign, tests=999)


@pytest.mark.parametrize("outcomes", ["FAILED", ["FAILED"], 5, None])
def test_an_error_about_an_unknown_outcome_lists_the_known_outcomes(
    campaign: Path, outcomes: Any
) -> None:
    known = "one of PASS, FAIL, INVALID, ERROR, DROPPED is needed"
    with pytest.raises(ValueError, match=f"outcome is .*: {known}"):
        data_frame(campaign, outcomes=outcomes)


def test_several_campaigns_make_a_frame_that_names_their_folders(
    campaign: Path, tmp_path: Path
) -> None:
    bench = tmp_path / "bench"
    for name in ("f/01", "f/02", "r/01"):
        shutil.copytree(campaign, bench / name)
    alone, whole = data_frame(campaign), data_frame(bench)
    assert list(whole.columns) == ["campaign", *alone.columns]
    places = [(bench / name).as_posix() for name in ("f/01", "f/02", "r/01")]
    assert [str(name) for name in whole["campaign"].unique()] == places
    for _, rows in whole.groupby("campaign"):
        rows_alone = rows.drop(columns="campaign").reset_index(drop=True)
        pd.testing.assert_frame_equal(rows_alone, alone)
    listed = data_frame([str(campaign), bench / "r"], "trajectories", outcomes=["FAIL"])
    assert set(listed["campaign"]) == {campaign.as_posix(), places[-1]}
    driven = (alone["outcome"] == "FAIL").sum()
    assert listed.groupby("campaign")["id"].nunique().tolist() == [driven, driven]
    with pytest.raises(CampaignError, match="holds no campaign"):
        data_frame([tmp_path])


def test_trajectories_of_a_frame_are_the_tests_trajectories(campaign: Path) -> None:
    by_id = {int(n): rows for n, rows in data_frame(campaign, "trajectories").groupby("id")}
    with CampaignStore.open(campaign) as store:
        driven = [test for test in store.tests(with_trajectory=True) if test.trajectory is not None]
    assert list(by_id) == sorted(test.id for test in driven)
    for test in driven:
        assert test.trajectory is not None
        rows = by_id[test.id][list(Trajectory.names())].to_numpy()
        assert np.array_equal(rows, test.trajectory.to_rows())


def test_records_are_located_on_their_road(campaign: Path) -> None:
    by_id = {int(n): rows for n, rows in data_frame(campaign, "trajectories").groupby("id")}
    ends = set()
    with CampaignStore.open(campaign) as store:
        for test in store.tests(with_trajectory=True):
            if not test.outcome.is_driven or test.trajectory is None:
                continue
            rows, result = by_id[test.id], test.result
            driven = rows[rows["time"] <= (result.duration or 0.0) + 1e-3]
            along = test.road.track(driven[["x", "y"]].to_numpy())
            offsets = along[:, 1] + 0.5 * test.lane_width
            assert driven["distance"].to_numpy() == pytest.approx(along[:, 0], abs=1e-4)
            assert driven["lateral_offset"].to_numpy() == pytest.approx(offsets, abs=1e-4)
            assert driven["distance"].iloc[-1] == pytest.approx(result.distance, abs=5e-4)
            moobd = (0.5 * test.lane_width - driven["lateral_offset"].abs()).min()
            assert moobd == pytest.approx(result.moobd, abs=5e-4)
            assert driven["oob_share"].max() == pytest.approx(result.max_oob_share, abs=5e-4)
            after = rows[rows["time"] > (result.duration or 0.0) + 1e-3]
            assert after[["distance", "lateral_offset", "oob_share"]].isna().all(axis=None)
            ends.add(test.outcome)
    assert ends == {Outcome.PASS, Outcome.FAIL}


def test_records_after_the_end_of_a_drive_and_of_an_unknown_road_are_missing(
    rewrite_campaign: RewriteCampaign,
) -> None:
    def change(test: Test) -> Test:
        path = test.trajectory
        if path is None or test.result_number not in (1, 2):
            return test
        if test.result_number == 2:
            return replace(test, pose=None)
        goes_on = {name: np.append(getattr(path, name), 0.0) for name in Trajectory.names()}
        goes_on["time"][-1] = path.time[-1] + 0.05
        return replace(test, trajectory=Trajectory(**goes_on))

    frame = data_frame(rewrite_campaign(change), "trajectories")
    longer, nowhere = (frame[frame["id"] == number] for number in frame["id"].unique()[:2])
    assert longer["oob_share"].isna().tolist() == [False] * (len(longer) - 1) + [True]
    assert nowhere["distance"].isna().all()


def test_frames_have_units_and_the_box_of_the_car(campaign: Path) -> None:
    tests, records = data_frame(campaign), data_frame(campaign, "trajectories")
    assert tests.attrs["units"]["moobd"] == "m"
    assert "outcome" not in tests.attrs["units"]
    assert records.attrs["units"]["lateral_speed"] == "m/s"
    assert tests.attrs["definitions"]["cause"] == "what the driver did wrong first"
    for frame in (tests, records):
        assert frame.attrs["definitions"].keys() == {*frame}
    body = EmbeddedSimulator().car
    assert records.attrs["cars"] == {campaign.as_posix(): asdict(body)}
    assert body.centre_ahead == pytest.approx(-0.133, abs=1e-3)


def test_the_page_has_the_unit_of_each_column() -> None:
    for table, columns in COLUMNS.items():
        texts = {
            name: row.partition("|")[2]
            for row in rows_on_page(table)
            for name in re.findall(r"`(\w+)`", row.partition("|")[0])
        }
        for column in columns:
            text = texts[column.name]
            for unit in filter(None, column.unit.split(", ")):
                assert re.search(rf"(?<![\w/]){re.escape(unit)}(?![\w/²])", text), column


@pytest.mark.parametrize(
    ("statement", "table", "text"),
    [
        ("UPDATE test SET seconds = -1.0 WHERE id = 9", "tests", "test 9: .*seconds"),
        ("UPDATE test SET reason = CAST(X'FF' AS TEXT) WHERE id = 9", "tests", "damaged"),
        ("UPDATE test SET trajectory = NULL WHERE result_number = 1", "trajectories", "is gone"),
        (
            "UPDATE test SET trajectory = X'00' WHERE result_number = 1",
            "trajectories",
            "is damaged",
        ),
    ],
)
def test_damage_is_an_error_in_one_line(
    damaged: Callable[[str], Path], statement: str, table: Any, text: str
) -> None:
    folder = damaged(statement)
    with pytest.raises(CampaignError, match=text) as caught:
        data_frame(folder, table)
    assert "\n" not in str(caught.value)
    if table == "trajectories":
        assert len(data_frame(folder)) > 0


def test_measures_have_a_row_per_campaign(campaign: Path, tmp_path: Path) -> None:
    shutil.copytree(campaign, tmp_path / "b" / "01")
    with CampaignStore.create(tmp_path / "b" / "02", {}):
        pass
    frame = data_frame(tmp_path / "b", "measures")
    assert list(frame.columns) == ["campaign", *TABLES["measures"]]
    assert frame["campaign"].tolist() == [(tmp_path / "b" / n).as_posix() for n in ("01", "02")]
    full, empty = frame.to_dict("records")
    measured = measure_campaign(campaign)
    for name, measure in MEASURES.items():
        assert (None if pd.isna(full[name]) else full[name]) == measure.of(measured)
    assert (full["simulations"], full["seed"]) == (measured.simulations, measured.seed)
    assert (empty["failures"], empty["simulations_to_failure"]) == (0.0, np.inf)
    assert pd.isna(empty["seed"])
    assert pd.isna(empty["min_moobd"])
    types = {"campaign": "string", "seed": "Int64", "is_finished": "bool", "failures": "Float64"}
    assert {name: str(frame[name].dtype) for name in types} == types
    with CampaignStore.open(campaign) as store:
        alone = data_frame(store, "measures")
    assert list(alone.columns) == list(TABLES["measures"])


def test_curves_have_a_row_per_point(campaign: Path, tmp_path: Path) -> None:
    frame = data_frame(campaign, "curves")
    assert {name: str(dtype) for name, dtype in frame.dtypes.items()} == {
        "curve": "string",
        "x": "float64",
        "y": "int64",
    }
    curves = campaign_curves(measure_campaign(campaign))
    assert frame["curve"].unique().tolist() == list(curves)
    for name, (x, y) in curves.items():
        rows = frame[frame["curve"] == name]
        assert (rows["x"].tolist(), rows["y"].tolist()) == (x.tolist(), y.tolist())
    shutil.copytree(campaign, tmp_path / "c")
    both = data_frame([campaign, tmp_path / "c"], "curves")
    assert both.groupby("campaign").size().tolist() == [len(frame)] * 2


@pytest.mark.parametrize("table", ["measures", "curves"])
def test_tables_of_campaigns_take_no_outcomes(campaign: Path, table: Any) -> None:
    with pytest.raises(ValueError, match="is of all tests: leave out outcomes"):
        data_frame(campaign, table, outcomes="FAIL")


def test_an_unknown_table_is_refused(campaign: Path) -> None:
    with pytest.raises(ValueError, match="one of tests, trajectories, measures, curves is needed"):
        data_frame(campaign, "roads")  # type: ignore[arg-type]


def test_roads_of_a_class_come_with_their_slopes(tmp_path: Path) -> None:
    road_class = RoadClass.of("urban-50", {"length": 300})
    campaign = Campaign(
        strategy=RandomSearch(seed=1, road_class=road_class),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=2),
        folder=tmp_path / "c",
    )
    campaign.run()
    frame = data_frame(campaign)
    with CampaignStore.open(campaign.folder) as store:
        for row, test in zip(frame.to_dict("records"), store.tests(), strict=True):
            profiles: dict[str, Any] = {name: row[name] or () for name in NAMES}
            assert (
                road_class.breach(
                    Road(
                        row["curvatures"],
                        row["step"],
                        lane_width=3.25,
                        **profiles,
                    )
                )
                == ""
            )
            assert row["widening"] == test.road.widening.tolist()
