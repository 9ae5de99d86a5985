"""Every format holds the same tables, and a folder is there completely or not at all."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from frenetic.campaign import CampaignStore
from frenetic.cli import main
from frenetic.cli.export import FORMATS, SIDES
from frenetic.cli.export import TRAJECTORIES as OFFERED
from frenetic.errors import CampaignError, FreneticError
from frenetic.export import campaigns, data_frame, export_campaign
from frenetic.export.competition import Sides
from frenetic.export.tables import TABLES, TESTS, TRAJECTORIES, Which

pytest_plugins = ["made_campaign"]


@pytest.fixture(scope="session")
def campaign(made_campaign: Path) -> Path:
    return made_campaign


@pytest.fixture(scope="module")
def exported(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    parent = tmp_path_factory.mktemp("all")
    return {
        name: export_campaign(campaign, name, parent / name) for name in ("parquet", "csv", "json")
    }


def same(one: pd.DataFrame, other: pd.DataFrame, *, relative: float = 0.0) -> None:
    """Frames whose values are the same, whatever their types; numbers but for a relative error."""
    assert list(one.columns) == list(other.columns)
    for name in one.columns:
        for a, b in zip(one[name], other[name], strict=True):
            if isinstance(a, (np.ndarray, list)):
                assert list(a) == list(b)
            elif isinstance(a, float) and not pd.isna(b):
                assert a == pytest.approx(b, rel=relative, abs=0.0)
            else:
                assert (pd.isna(a) and pd.isna(b)) or a == b


def test_parquet_comes_back(campaign: Path, exported: dict[str, Path]) -> None:
    for table in ("tests", "trajectories"):
        path = exported["parquet"] / f"{table}.parquet"
        same(pd.read_parquet(path), data_frame(campaign, table))


def test_parquet_knows_units_types_and_row_groups(exported: dict[str, Path]) -> None:
    for table, columns in TABLES.items():
        schema = pq.read_schema(exported["parquet"] / f"{table}.parquet")
        for column in columns:
            field = schema.field(column.name)
            assert field.metadata.get(b"unit", b"").decode() == column.unit
            assert field.metadata[b"description"].decode() == column.description
            assert field.nullable == column.optional
    tests = pd.read_parquet(exported["parquet"] / "tests.parquet")
    assert isinstance(tests["outcome"].dtype, pd.CategoricalDtype)
    assert str(tests["finished_at"].dtype).endswith("UTC]")


def test_csv_comes_back(campaign: Path, exported: dict[str, Path]) -> None:
    tests = pd.read_csv(
        exported["csv"] / "tests.csv",
        converters={"curvatures": json.loads, "parents": json.loads},
        parse_dates=["finished_at"],
    )
    # What is written is exact; pandas reads it a few units in the last place beside.
    same(tests, data_frame(campaign), relative=1e-14)
    driven = pd.read_csv(exported["csv"] / "trajectories.csv")
    same(driven, data_frame(campaign, "trajectories"), relative=1e-14)
    with (exported["csv"] / "tests.csv").open(encoding="utf-8", newline="") as file:
        written = [float(row["seconds"]) for row in csv.DictReader(file)]
    assert written == list(data_frame(campaign)["seconds"])


def test_json_comes_back(campaign: Path, exported: dict[str, Path]) -> None:
    path = exported["json"] / "tests.jsonl"
    documents = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    frame = pd.DataFrame(documents)
    same(
        frame[[column.name for column in TESTS]].assign(
            finished_at=pd.to_datetime(frame["finished_at"])
        ),
        data_frame(campaign),
    )
    assert list(pd.read_json(path, lines=True)["id"]) == list(frame["id"])
    with CampaignStore.open(campaign) as store:
        for document in documents:
            test = store.test(document["id"])
            assert np.allclose(document["road_points"], test.road.road_points, atol=1e-6)
            if test.drive is None:
                assert document["trajectory"] is None
                continue
            assert list(document["trajectory"]) == [column.name for column in TRAJECTORIES[1:]]
            rows = np.array(list(document["trajectory"].values())).T
            assert np.array_equal(rows, test.drive.trajectory.to_rows())


@pytest.mark.parametrize("name", ["parquet", "csv"])
@pytest.mark.parametrize("outcomes", [(), ("PASS", "FAIL"), ("PASS",)])
@pytest.mark.parametrize("which", ["all", "failures", "none"])
def test_only_some_outcomes_and_trajectories(
    campaign: Path, tmp_path: Path, name: Any, outcomes: tuple[str, ...], which: Any
) -> None:
    folder = export_campaign(
        campaign, name, tmp_path / "out", outcomes=outcomes, trajectories=which
    )
    read: Any = {"parquet": pd.read_parquet, "csv": pd.read_csv}[name]
    wanted = data_frame(campaign, outcomes=outcomes)
    assert list(read(folder / f"tests.{name}")["id"]) == list(wanted["id"])
    if which == "none":
        assert [path.name for path in folder.iterdir()] == [f"tests.{name}"]
        return
    driven = wanted["outcome"].isin(["FAIL"] if which == "failures" else ["PASS", "FAIL"])
    rows = read(folder / f"trajectories.{name}")
    assert list(rows["id"].unique()) == list(wanted["id"][driven])


def test_json_without_trajectories(campaign: Path, tmp_path: Path) -> None:
    folder = export_campaign(campaign, "json", tmp_path / "none", trajectories="none")
    for line in (folder / "tests.jsonl").read_text(encoding="utf-8").splitlines():
        assert "trajectory" not in json.loads(line)
    folder = export_campaign(campaign, "json", tmp_path / "some", trajectories="failures")
    for line in (folder / "tests.jsonl").read_text(encoding="utf-8").splitlines():
        test = json.loads(line)
        assert (test["trajectory"] is not None) == (test["outcome"] == "FAIL")


def test_a_candidate_that_is_no_road_is_exported(
    damaged: Callable[[str], Path], tmp_path: Path
) -> None:
    folder = damaged(
        "UPDATE candidate SET curvatures = X'' WHERE id ="
        " (SELECT min(candidate_id) FROM test WHERE outcome = 'INVALID')"
    )
    frame = data_frame(folder)
    (row,) = frame[frame["curvature_count"] == 0].to_dict("records")
    assert (row["length"], row["curvatures"].tolist()) == (0.0, [])
    assert pd.isna(row["max_curvature"])
    for name in ("parquet", "csv", "json", "competition"):
        export_campaign(folder, name, tmp_path / name)
    lines = (tmp_path / "json" / "tests.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(line)["road_points"] for line in lines].count(None) == 1
    path = tmp_path / "competition" / f"test.{row['id']:04d}.json"
    assert json.loads(path.read_text(encoding="utf-8"))["road_points"] == []


def test_texts_with_everything_in_them_come_back(
    damaged: Callable[[str], Path], tmp_path: Path
) -> None:
    reason = 'κ → "θ", \n; \u2028'
    folder = damaged(
        "UPDATE test SET reason = 'κ → \"θ\", ' || char(10) || '; ' || char(8232) WHERE told = 5"
    )
    assert data_frame(folder)["reason"][4] == reason
    path = export_campaign(folder, "csv", tmp_path / "csv") / "tests.csv"
    with path.open(encoding="utf-8", newline="") as file:
        assert list(csv.DictReader(file))[4]["reason"] == reason
    path = export_campaign(folder, "json", tmp_path / "json") / "tests.jsonl"
    assert json.loads(path.read_text(encoding="utf-8").split("\n")[4])["reason"] == reason


def test_progress_ends_at_all(campaign: Path, tmp_path: Path) -> None:
    for name in ("parquet", "csv", "json", "competition"):
        steps: list[tuple[int, int]] = []
        export_campaign(
            campaign,
            name,
            tmp_path / name,
            on_progress=lambda done, total, steps=steps: steps.append((done, total)),  # type: ignore[misc]
        )
        assert [done for done, _ in steps] == sorted(done for done, _ in steps)
        assert steps[-1][0] == steps[-1][1] > 0


# The folder


def test_an_empty_folder_will_do(campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    assert export_campaign(campaign, "csv", tmp_path / "out", trajectories="none")
    assert (tmp_path / "out" / "tests.csv").is_file()


def test_what_is_there_is_refused_in_one_line(campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("precious")
    (tmp_path / "file").write_text("precious")
    for name in ("full", "file"):
        with pytest.raises(FreneticError, match="exists already: choose another") as caught:
            export_campaign(campaign, "csv", tmp_path / name)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "full" / "mine").read_text() == "precious"
    assert (tmp_path / "file").read_text() == "precious"
    with pytest.raises(FreneticError, match="cannot be written"):
        export_campaign(campaign, "csv", tmp_path / "file" / "below")


def test_nothing_is_left_of_an_export_that_broke(
    damaged: Callable[[str], Path], tmp_path: Path
) -> None:
    folder = damaged("UPDATE test SET finished_at = 'now' WHERE told = 50")
    for name in ("parquet", "csv", "json"):
        with pytest.raises(CampaignError, match="finished_at"):
            export_campaign(folder, name, tmp_path / "out" / name)
    assert list((tmp_path / "out").iterdir()) == []


def test_nothing_is_left_of_an_export_that_was_interrupted(campaign: Path, tmp_path: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_campaign(campaign, "json", tmp_path / "out" / "json", on_progress=interrupt)
    assert list((tmp_path / "out").iterdir()) == []


def test_what_there_is_not(campaign: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="one of parquet, csv, json, competition"):
        export_campaign(campaign, "excel", tmp_path / "out")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="one of all, failures, none"):
        export_campaign(campaign, "csv", tmp_path / "out", trajectories="some")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="one of geometry, competition"):
        export_campaign(campaign, "competition", tmp_path / "out", sides="both")  # type: ignore[arg-type]
    with pytest.raises(FreneticError, match="the format json counts no sides"):
        export_campaign(campaign, "json", tmp_path / "out", sides="competition")
    with pytest.raises(ValueError, match="GREAT"):
        export_campaign(campaign, "csv", tmp_path / "out", outcomes=["GREAT"])


def test_only_parquet_needs_pyarrow(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "pyarrow"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(FreneticError, match=r'pip install "frenetic-roads\[tables\]"'):
        export_campaign(campaign, "parquet", tmp_path / "out")
    for name in ("csv", "json", "competition"):
        export_campaign(campaign, name, tmp_path / name)  # type: ignore[arg-type]


NASTY = {
    "=HYPERLINK(1)": "'=HYPERLINK(1)",
    "+1": "'+1",
    "-1+1": "'-1+1",
    "@SUM(1)": "'@SUM(1)",
    "\t=1": "\\t=1",
    "\r=1": "\\r=1",
    "\n=1": "'\n=1",
    "a\x1b[31m\x9b\x7f": "a\\x1b[31m\\x9b\\x7f",
    "a=1, -2": "a=1, -2",
}
"""Text of a test -> its cell."""


@pytest.mark.parametrize("text", NASTY)
def test_no_text_is_a_formula_or_controls_a_terminal(
    damaged: Callable[[str], Path], tmp_path: Path, text: str
) -> None:
    folder = damaged(
        f"UPDATE test SET reason = CAST(X'{text.encode().hex()}' AS TEXT) WHERE told = 5"
    )
    path = export_campaign(folder, "csv", tmp_path / "csv", trajectories="none") / "tests.csv"
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert rows[4]["reason"] == NASTY[text]
    assert min(float(row["moobd"]) for row in rows if row["moobd"]) < 0.0  # numbers stay numbers
    assert data_frame(folder)["reason"][4] == text


def test_nul_is_no_byte_of_a_table(damaged: Callable[[str], Path], tmp_path: Path) -> None:
    folder = damaged("UPDATE test SET reason = 'a' || char(0) || 'b' WHERE told = 5")
    path = export_campaign(folder, "csv", tmp_path / "csv", trajectories="none") / "tests.csv"
    assert b"\0" not in path.read_bytes()
    assert pd.read_csv(path)["reason"][4] == "a\\x00b"


# On the command line


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["export", *arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_command(campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out")
    options = ("--outcome", "fail", "--outcome", "DROPPED", "--trajectories", "none")
    assert run(str(campaign), "--format", "csv", "--out", out, *options) == 0
    assert capsys.readouterr().out == f"{out}\n"
    read = pd.read_csv(Path(out) / "tests.csv")
    assert set(read["outcome"]) == {"FAIL", "DROPPED"}
    assert run(str(campaign), "--format", "csv", "--out", out) == 2
    answer = capsys.readouterr()
    assert answer.out == ""
    assert len(answer.err.splitlines()) == 1
    assert "exists already" in answer.err


def test_command_writes_into_the_campaigns_folder_by_default(
    damaged: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = damaged("UPDATE test SET reason = 'Because' WHERE told = 1")
    assert run(str(folder), "--format", "json") == 0
    assert capsys.readouterr().out == f"{folder / campaigns.EXPORTS / 'json'}\n"
    assert (folder / "exports" / "json" / "tests.jsonl").is_file()


@pytest.mark.parametrize(
    "option",
    [
        ("--format", "excel"),
        ("--format", "csv", "--outcome", "x"),
        ("--format", "csv", "--sides", "competition"),
        ("--format", "competition", "--sides", "x"),
        (),
    ],
)
def test_command_with_what_there_is_not(campaign: Path, option: tuple[str, ...]) -> None:
    assert run(str(campaign), *option) == 2
    assert not (campaign / "exports").exists()


def test_the_command_offers_what_the_library_does() -> None:
    assert get_args(campaigns.Format) == FORMATS
    assert get_args(Which) == OFFERED
    assert get_args(Sides) == SIDES
