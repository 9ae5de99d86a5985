"""Every format holds the same tables, and a folder is complete or missing."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import pandas as pd
import pytest
from pyarrow.parquet import read_schema

from frenetic._support.printable import printable
from frenetic.campaign import CampaignStore, Test
from frenetic.cli import main
from frenetic.errors import FreneticError
from frenetic.export import campaigns, data_frame, export_campaign, table_files, tables
from frenetic.export.metadata import DESCRIPTION
from frenetic.oracle.outcome import Outcome
from frenetic.search.records import SourceTest

if TYPE_CHECKING:
    from sample_campaign import RewriteCampaign

pytest_plugins = ["sample_campaign"]
pytestmark = pytest.mark.heavy

DICTIONARIES = ("source", "notes", "fault")


@pytest.fixture(scope="session")
def campaign(sample_campaign: Path) -> Path:
    return sample_campaign


def change_test(test: Test, **changes: Any) -> Test:
    """Return a test with other fields of test, result, candidate or origin."""
    parts: dict[str, Any] = {"result": test.result, "test": test, "candidate": test.candidate}
    parts["origin"] = test.candidate.origin
    for name, value in changes.items():
        part = next(k for k, v in parts.items() if hasattr(v, name))
        parts[part] = replace(parts[part], **{name: value})
    changed_test: Test = parts["test"]
    return replace(
        changed_test,
        candidate=replace(parts["candidate"], origin=parts["origin"]),
        result=parts["result"],
    )


def change_fifth(**changes: Any) -> Callable[[Test], Test]:
    """Return a function that changes the fifth test and no other."""
    return lambda test: change_test(test, **changes) if test.result_number == 5 else test


@pytest.fixture(params=["a whole batch", "batches of seven"])
def exported(
    request: pytest.FixtureRequest,
    rewrite_campaign: RewriteCampaign,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[Path, dict[str, Path]]:
    """A campaign with a test that has all optional values, and its exports."""
    if request.param == "batches of seven":
        monkeypatch.setattr(table_files, "TESTS_AT_ONCE", 7)
    folder = rewrite_campaign(
        change_fifth(
            conditions={"fog": 60.5},
            repeat=2,
            source=SourceTest("nightly", 31),
            notes={"looked at": [4000, None], "why": "κ"},
            reason='κ → "θ", \n; \u2028',
            worker="w1",
        )
    )
    names: Any = ("parquet", "csv", "json")
    return folder, {name: export_campaign(folder, name, tmp_path / name) for name in names}


def cells_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return value.tolist()
        return value if isinstance(value, dict) or not pd.isna(value) else None

    return [{name: plain(v) for name, v in row.items()} for row in frame.to_dict("records")]


def from_text(text: str, value: Any) -> Any:
    """Read a cell as the type of another value."""
    if value is None:
        return text or None
    if isinstance(value, str):
        return text
    if isinstance(value, (list, dict)):
        return json.loads(text)
    return datetime.fromisoformat(text) if isinstance(value, datetime) else type(value)(text)


@pytest.mark.parametrize("table", ["tests", "trajectories"])
def test_every_format_gives_the_frame_back(
    exported: tuple[Path, dict[str, Path]], table: tables.Table
) -> None:
    folder, files = exported
    frame = data_frame(folder, table)
    parquet = pd.read_parquet(files["parquet"] / f"{table}.parquet")
    for name in DICTIONARIES if table == "tests" else ():
        texts = parquet[name].astype(object)
        parquet[name] = texts.where(texts.notna(), None).map(json.loads, na_action="ignore")
    pd.testing.assert_frame_equal(parquet, frame, check_categorical=False)
    expected = cells_of(frame)
    with (files["csv"] / f"{table}.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [
        {name: from_text(text, value[name]) for name, text in row.items()}
        for row, value in zip(rows, expected, strict=True)
    ] == [
        {name: printable(v) if isinstance(v, str) else v for name, v in row.items()}
        for row in expected
    ]
    lines = (files["json"] / f"{table}.jsonl").read_bytes().splitlines()
    documents = [json.loads(line) for line in lines]
    for document in documents if table == "tests" else ():
        document["finished_at"] = datetime.fromisoformat(document["finished_at"])
    assert documents == expected


READERS: dict[Any, Any] = {
    "parquet": pd.read_parquet,
    "csv": pd.read_csv,
    "json": partial(pd.read_json, lines=True),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize(
    ("outcomes", "which"),
    [(("PASS", "FAIL"), "failures"), (("PASS",), "none")],
)
def test_outcomes_and_trajectories_can_be_chosen(
    campaign: Path, tmp_path: Path, name: Any, outcomes: tuple[str, ...], which: Any
) -> None:
    folder = export_campaign(
        campaign, name, tmp_path / "out", outcomes=outcomes, trajectories=which
    )
    files = sorted(file for file in folder.iterdir() if file.name != DESCRIPTION)
    expected = data_frame(campaign, outcomes=outcomes)
    assert list(READERS[name](files[0])["id"]) == list(expected["id"])
    assert [file.stem for file in files] == ["tests", "trajectories"][: 1 + (which != "none")]
    if which != "none":
        driven = expected["outcome"].isin(["FAIL"] if which == "failures" else ["PASS", "FAIL"])
        rows = READERS[name](files[1])
        assert list(rows.get("id", pd.Series()).unique()) == list(expected["id"][driven])


@pytest.mark.parametrize("which", ["all", "none"])
def test_files_say_units_and_the_box_of_the_car(
    rewrite_campaign: RewriteCampaign, tmp_path: Path, which: Any
) -> None:
    campaign = rewrite_campaign(change_fifth(conditions={"fog": 60.5}))
    names: Any = ("csv", "json", "parquet")
    files = {
        name: export_campaign(campaign, name, tmp_path / name, trajectories=which) for name in names
    }
    assert not (files["parquet"] / DESCRIPTION).exists()
    described = {name: json.loads((files[name] / DESCRIPTION).read_bytes()) for name in names[:2]}
    assert described["csv"] == described["json"]
    document = described["csv"]
    box = {"length": 4.508, "width": 1.61, "centre_ahead": pytest.approx(-0.133, abs=1e-3)}
    assert document.pop("cars") == {campaign.as_posix(): box}
    assert document["tests"]["condition_fog"]["unit"] == "m"
    assert list(document) == ["tests", "trajectories"][: 1 + (which == "all")]
    for table, columns in document.items():
        schema = read_schema(files["parquet"] / f"{table}.parquet")
        assert schema.names == list(columns) == list(data_frame(campaign, table).columns)
        for field in schema:
            metadata = {k.decode(): v.decode() for k, v in (field.metadata or {}).items()}
            assert metadata == columns[field.name]
            assert metadata["about"]
        if table == "trajectories":
            assert json.loads(schema.metadata[b"frenetic"])["cars"] == {campaign.as_posix(): box}


def test_a_candidate_without_curvatures_is_exported(
    campaign: Path, rewrite_campaign: RewriteCampaign, tmp_path: Path
) -> None:
    with CampaignStore.open(campaign) as store:
        invalid = next(store.tests(Outcome.INVALID)).id

    def change(test: Test) -> Test:
        if test.id != invalid:
            return test
        return replace(test, candidate=replace(test.candidate, curvatures=np.empty(0)))

    folder = rewrite_campaign(change)
    frame = data_frame(folder)
    (row,) = frame[frame["length"] == 0.0].to_dict("records")
    assert (row["length"], row["curvatures"].tolist()) == (0.0, [])
    assert pd.isna(row["max_curvature"])
    for name in ("parquet", "csv", "json", "competition"):
        export_campaign(folder, name, tmp_path / name)
    path = tmp_path / "competition" / f"test.{invalid:04d}.json"
    assert json.loads(path.read_text(encoding="utf-8"))["road_points"] == []


# The folder


def test_an_empty_folder_is_accepted_and_progress_ends_at_the_total(
    campaign: Path, tmp_path: Path
) -> None:
    for name in get_args(campaigns.Format):
        steps: list[tuple[int, int]] = []
        (tmp_path / name).mkdir()
        notify = lambda done, total, steps=steps: steps.append((done, total))  # noqa: E731
        folder = export_campaign(
            campaign, name, tmp_path / name, trajectories="none", on_progress=notify
        )
        assert any(folder.iterdir())
        assert steps == sorted(steps)
        assert steps[-1][0] == steps[-1][1] > 0


def test_an_existing_target_is_refused_in_one_line(campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("precious")
    (tmp_path / "file").write_text("precious")
    exists = "exists already: choose another"
    mistakes = {"full": exists, "file": exists, "file/below": "cannot be written"}
    for name, message in mistakes.items():
        with pytest.raises(FreneticError, match=message) as caught:
            export_campaign(campaign, "csv", tmp_path / name)
        assert "\n" not in str(caught.value)
    assert (tmp_path / "full" / "mine").read_text() == "precious"
    assert (tmp_path / "file").read_text() == "precious"


NO_TRAJECTORY = "UPDATE test SET trajectory = NULL WHERE result_number = 1"
NEGATIVE_SECONDS = "UPDATE test SET seconds = -1.0 WHERE result_number = 50"


@pytest.mark.parametrize(
    ("name", "statement", "text"),
    [
        ("csv", NEGATIVE_SECONDS, "test .*seconds"),
        ("parquet", NO_TRAJECTORY, "the trajectory of test 1 is gone"),
        ("json", NEGATIVE_SECONDS, "test .*seconds"),
        ("competition", NEGATIVE_SECONDS, "test .*seconds"),
        ("competition", NO_TRAJECTORY, "the trajectory of test 1 is gone"),
    ],
)
def test_a_failed_export_leaves_no_files(
    damaged: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: Any,
    statement: str,
    text: str,
) -> None:
    monkeypatch.setattr(table_files, "TESTS_AT_ONCE", 7)
    (tmp_path / "out").mkdir()
    with pytest.raises(FreneticError, match=text) as caught:
        export_campaign(damaged(statement), name, tmp_path / "out" / name)
    assert "\n" not in str(caught.value)
    assert list((tmp_path / "out").iterdir()) == []


def test_the_next_export_removes_the_files_of_a_killed_export(
    campaign: Path, tmp_path: Path
) -> None:
    script = (
        "import os, sys; from frenetic.export import export_campaign;"
        "export_campaign(sys.argv[1], 'csv', 'out', on_progress=lambda *_: os._exit(9))"
    )
    killed = subprocess.run([sys.executable, "-c", script, campaign], cwd=tmp_path, check=False)
    assert killed.returncode == 9
    assert list(tmp_path.iterdir())
    (tmp_path / "out.part-1").mkdir()  # a folder of the user
    export_campaign(campaign, "csv", tmp_path / "out")
    assert {path.name for path in tmp_path.iterdir()} == {"out", "out.part-1"}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("excel", {}, "one of parquet, csv, json, competition"),
        ("csv", {"trajectories": "some"}, "one of all, failures, none"),
        ("csv", {"outcomes": ["GREAT"]}, "GREAT"),
    ],
)
def test_unknown_names_are_refused(
    campaign: Path, tmp_path: Path, name: Any, options: dict[str, Any], message: str
) -> None:
    with pytest.raises((ValueError, FreneticError), match=message):
        export_campaign(campaign, name, tmp_path / "out", **options)


def test_frames_and_parquet_need_the_extra_tables_but_other_files_do_not(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("pandas", "pyarrow"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, module, None)
            with pytest.raises(FreneticError, match=r'pip install "\.\[tables\]"'):
                export_campaign(campaign, "parquet", tmp_path / "out")
            with pytest.raises(FreneticError, match=r'pip install "\.\[tables\]"'):
                data_frame(campaign)
            assert not (tmp_path / "out").exists()
            for name in ("csv", "json", "competition"):
                export_campaign(campaign, name, tmp_path / module / name)


UNSAFE_TEXTS = {
    "=HYPERLINK(1)": "'=HYPERLINK(1)",
    "+1": "'+1",
    "-1+1": "'-1+1",
    "@SUM(1)": "'@SUM(1)",
    "\t=1": "\\t=1",
    "\r=1": "\\r=1",
    "\n=1": "'\n=1",
    "a\x1b[31m\x9b\x7f": "a\\x1b[31m\\x9b\\x7f",
    "a\0b": "a\\x00b",
    "a=1, -2": "a=1, -2",
}
"""Text of a test -> its cell."""


def test_cells_hold_neither_formulas_nor_control_characters(
    rewrite_campaign: RewriteCampaign, tmp_path: Path
) -> None:
    texts, names = list(UNSAFE_TEXTS), ("reason", "operator", "worker")

    def change(test: Test) -> Test:
        text = texts[test.result_number % len(texts)]
        return change_test(test, reason=text, operator=text, worker=text)

    folder = rewrite_campaign(change)
    path = export_campaign(folder, "csv", tmp_path / "csv", trajectories="none") / "tests.csv"
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    frame = data_frame(folder)
    for row, number in enumerate(frame["result_number"].tolist()):
        text = texts[number % len(texts)]
        assert [rows[row][name] for name in names] == [UNSAFE_TEXTS[text]] * 3
        assert list(frame.loc[row, list(names)]) == [text] * 3
    assert (
        min(float(row["moobd"]) for row in rows if row["moobd"]) < 0.0
    )  # negative numbers get no apostrophe


# On the command line


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as stop:
        main(["export", *arguments])
    assert isinstance(stop.value.code, int)
    return stop.value.code


def test_the_command_writes_into_the_campaigns_folder_by_default(
    rewrite_campaign: RewriteCampaign, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = rewrite_campaign(lambda test: test)
    for source in (folder, folder.parent):
        assert run(str(source), "--format", "json") == 0
        answer = capsys.readouterr()
        assert answer.out == f"{source / 'exports' / 'json'}\n"
        first = (source / "exports" / "json" / "tests.jsonl").read_text().splitlines()[0]
        assert json.loads(first).get("campaign") == (None if source == folder else str(folder))


@pytest.mark.parametrize(
    "option",
    [
        ("--format", "excel"),
        ("--format", "csv", "--outcome", "x"),
        ("--format", "csv,sides=competition"),
        (),
    ],
)
def test_the_command_refuses_unknown_names(campaign: Path, option: tuple[str, ...]) -> None:
    assert run(str(campaign), *option) == 2
    assert not (campaign / "exports").exists()
