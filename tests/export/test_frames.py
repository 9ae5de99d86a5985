"""Data frames say what the campaign's records say, with pandas' own types."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import frenetic
from frenetic.campaign import CampaignStore
from frenetic.errors import CampaignError, FreneticError
from frenetic.export import data_frame, tables
from frenetic.export.tables import TESTS, TRAJECTORIES, Kind
from frenetic.outcome import Outcome

pytest_plugins = ["made_campaign"]


@pytest.fixture(scope="session")
def campaign(made_campaign: Path) -> Path:
    return made_campaign


def expected(record: Any) -> dict[str, Any]:
    """A row of the table, made from a record."""
    candidate, place = record.candidate, record.pose or (None, None, None)
    return {
        "id": candidate.id,
        "outcome": str(record.outcome),
        "operator": candidate.origin.operator,
        "parents": list(candidate.origin.parents),
        "generation": candidate.origin.generation,
        "length": (len(candidate.curvatures) - 1) * candidate.step,
        "curvature_count": len(candidate.curvatures),
        "max_curvature": abs(candidate.curvatures).max(),
        "curvatures": candidate.curvatures.tolist(),
        "step": candidate.step,
        "x": place[0],
        "y": place[1],
        "heading": place[2],
        **{
            column.name: getattr(record, column.name)
            for column in TESTS
            if hasattr(record, column.name) and column.name != "outcome"
        },
    }


def plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return None if pd.isna(value) else value


def test_tests_are_the_records(campaign: Path) -> None:
    frame = data_frame(campaign)
    assert list(frame.columns) == [column.name for column in TESTS]
    with CampaignStore.open(campaign) as store:
        records = list(store.tests())
        asked_after = [place for _, place in store.candidates_with_place()]
    assert len(frame) == len(records)
    for row, record in zip(frame.to_dict("records"), records, strict=True):
        wanted = expected(record)
        assert {name: plain(row[name]) for name in wanted} == wanted
        assert row["asked_after"] == asked_after[row["id"] - 1]
    assert frame["objective"].isna().all()  # the MOOBD is minimised
    others = {"asked_after", "finished_at", "objective"}
    assert set(frame.columns) - set(expected(records[0])) == others


def test_types_are_those_of_pandas(campaign: Path) -> None:
    frame = data_frame(campaign)
    for column in TESTS:
        dtype = frame[column.name].dtype
        match column.kind:
            case Kind.WHOLE:
                assert dtype == "int64"
            case Kind.REAL:
                assert dtype == ("Float64" if column.optional else "float64")
            case Kind.CHOICE:
                assert isinstance(dtype, pd.CategoricalDtype)
            case Kind.TEXT:
                assert dtype == "string"
            case Kind.MOMENT:
                assert isinstance(dtype, pd.DatetimeTZDtype)
                assert str(dtype.tz) == "UTC"
            case _:
                assert str(dtype) == "object"
    assert list(frame["outcome"].cat.categories) == [str(outcome) for outcome in Outcome]
    assert list(frame["departure_side"].cat.categories) == ["left", "right"]


def test_only_some_outcomes(campaign: Path) -> None:
    whole = data_frame(campaign)
    frame = data_frame(campaign, outcomes=[Outcome.FAIL, "INVALID"])
    assert set(frame["outcome"]) == {"FAIL", "INVALID"}
    assert list(frame["id"]) == list(whole["id"][whole["outcome"].isin(["FAIL", "INVALID"])])


def test_an_open_campaign_stays_open(campaign: Path) -> None:
    with CampaignStore.open(campaign) as store:
        assert len(data_frame(store)) == store.counts().told


def test_trajectories_are_those_of_the_records(campaign: Path) -> None:
    frame = data_frame(campaign, "trajectories")
    assert list(frame.columns) == [column.name for column in TRAJECTORIES]
    by_id = {int(number): rows for number, rows in frame.groupby("id", sort=False)}
    with CampaignStore.open(campaign) as store:
        driven = [r for r in store.tests(with_trajectory=True) if r.trajectory is not None]
    assert list(by_id) == [record.candidate.id for record in driven]
    for record in driven:
        assert record.trajectory is not None
        rows = by_id[record.candidate.id].drop(columns="id").to_numpy()
        assert np.array_equal(rows, record.trajectory.to_rows())


def test_rows_do_not_depend_on_the_batches(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = [data_frame(campaign), data_frame(campaign, "trajectories")]
    monkeypatch.setattr(tables, "RECORDS_AT_ONCE", 700)
    for name in ("_SELECT_TESTS", "_SELECT_TRAJECTORIES"):
        select = getattr(tables, name)
        monkeypatch.setattr(tables, name, select[: select.index("LIMIT")] + "LIMIT 7")
    again = [data_frame(campaign), data_frame(campaign, "trajectories")]
    for one, other in zip(frames, again, strict=True):
        pd.testing.assert_frame_equal(one, other)


def test_a_campaign_without_tests_has_the_same_columns(campaign: Path, tmp_path: Path) -> None:
    with CampaignStore.create(tmp_path / "empty", {}) as store:
        store.finish()
    full = data_frame(campaign)
    empty = data_frame(tmp_path / "empty")
    assert len(empty) == 0
    assert list(empty.columns) == list(full.columns)
    for column in TESTS:
        if column.kind is not Kind.CHOICE:
            assert empty[column.name].dtype == full[column.name].dtype
    assert len(data_frame(tmp_path / "empty", "trajectories")) == 0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ("candidate SET curvatures = X'01' WHERE id = 9", "curvatures of the result"),
        ("candidate SET curvatures = X'000000000000F87F' WHERE id = 9", "curvatures of the result"),
        ("candidate SET parents = '[true]' WHERE id = 9", "parents of the result"),
        ("candidate SET parents = '[' WHERE id = 9", "parents of the result"),
        ("test SET budget_spent = 9e999 WHERE told = 9", "budget_spent of the result that was"),
        ("test SET finished_at = 'now' WHERE told = 9", "finished_at .* told as number 9 is 'now'"),
        ("test SET finished_at = '2026-13-01T00:00:00+00:00' WHERE told = 9", "finished_at"),
        ("test SET departure_side = 'up' WHERE told = 9", "departure_side .* is 'up'"),
        ("test SET outcome = 'GREAT' WHERE told = 9", "GREAT"),
        ("test SET reason = CAST(X'FF' AS TEXT) WHERE told = 9", "damaged"),
    ],
)
def test_damage_is_one_line(damaged: Callable[[str], Path], change: str, text: str) -> None:
    folder = damaged(f"UPDATE {change}")
    with pytest.raises(CampaignError, match=text) as caught:
        data_frame(folder)
    assert "\n" not in str(caught.value)


def test_a_missing_candidate_is_not_left_out(damaged: Callable[[str], Path]) -> None:
    with pytest.raises(CampaignError, match="id of the result that was told as number"):
        data_frame(damaged("DELETE FROM candidate WHERE id = 9"))


def test_a_damaged_trajectory_is_one_line(damaged: Callable[[str], Path]) -> None:
    folder = damaged(
        "UPDATE trajectory SET data = X'00' WHERE candidate_id ="
        " (SELECT min(candidate_id) FROM trajectory)"
    )
    with pytest.raises(CampaignError, match=r"damaged: test 1: .*frenetic check"):
        data_frame(folder, "trajectories")
    assert len(data_frame(folder)) > 0


def test_what_there_is_not(campaign: Path) -> None:
    with pytest.raises(ValueError, match="one of tests, trajectories is needed"):
        data_frame(campaign, "roads")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="GREAT"):
        data_frame(campaign, outcomes=["GREAT"])


def test_without_pandas_the_extra_is_named(campaign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(FreneticError, match=r'pip install "frenetic-roads\[tables\]"'):
        data_frame(campaign)


def test_the_package_knows_it() -> None:
    assert frenetic.data_frame is data_frame
