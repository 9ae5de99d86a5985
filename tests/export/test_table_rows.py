"""Rows of tests in CSV and JSON files, which need no data frames: causes, places, conditions."""

from __future__ import annotations

import csv
import json
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import frenetic
from frenetic._support.arrays import FloatArray
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.explained import explained_causes
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.campaign.database import DATABASE
from frenetic.criteria.criterion import CriteriaSet, Signal, signal_named
from frenetic.drivers import Planner
from frenetic.export import (
    TRACE_COLUMNS,
    export_campaign,
    failure_values,
    record_columns,
    trace_of_test,
)
from frenetic.export.metadata import DESCRIPTION
from frenetic.export.trace_columns import TracedDrive, derived_values
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.minimised_roads import minimised_drives, minimised_tests
from frenetic.search import Frenetic
from frenetic.simulators import EmbeddedSimulator

if TYPE_CHECKING:
    from sample_campaign import RewriteCampaign

pytest_plugins = ["sample_campaign"]


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with trials of its causes and minimised roads."""
    folder = tmp_path_factory.mktemp("rows") / "searched"
    frenetic.run(
        Campaign(
            strategy=Frenetic(seed=1),
            simulator=EmbeddedSimulator(),
            driver=Planner(),
            budget=Budget(simulations=60),
            folder=folder,
        )
    )
    return folder


def rows_of(campaign: Path, out: Path, **options: Any) -> list[dict[str, Any]]:
    """Export a campaign as JSON; return the rows of its tests."""
    options = {"trajectories": "none"} | options
    folder = export_campaign(campaign, "json", out, **options)
    return [json.loads(line) for line in (folder / "tests.jsonl").read_bytes().splitlines()]


def test_failures_have_what_show_says_of_them(searched: Path, tmp_path: Path) -> None:
    rows = rows_of(searched, tmp_path / "json")
    with CampaignStore.open(searched) as store:
        clusters = distinct_failures(store)
        certainties = {
            cause.group.clusters[0].cause.kind: str(cause.certainty)  # type: ignore[union-attr]
            for cause in explained_causes(store, clusters)
        }
        minimised = minimised_drives(store, minimised_tests(searched))
        texts = {kind.value.format(""): text for kind, text in certainties.items()}
    failures = [row for row in rows if row["outcome"] == "FAIL"]
    for row in failures:
        assert row["criterion"] == "lane"
        assert row["distinct_failure"] == clusters.clusters.index(clusters.of(row["id"])) + 1
        assert row["cause_certainty"] == texts.get(row["cause"])
        length = minimised[row["id"]].road.length if row["id"] in minimised else None
        assert row["minimised_length"] == length
    assert {row["cause_certainty"] for row in failures} >= {"certain"}
    assert len(minimised) > 0
    names = ("criterion", "cause", "cause_side", "cause_certainty", "distinct_failure")
    assert all(row[name] is None for row in rows if row["outcome"] == "PASS" for name in names)


def test_driven_tests_have_the_road_and_the_speed_at_their_place(
    searched: Path, tmp_path: Path
) -> None:
    with CampaignStore.open(searched) as store:
        tests = {test.id: test for test in store.tests(with_trajectory=True)}
    for row in rows_of(searched, tmp_path / "json"):
        test = tests[row["id"]]
        if not test.outcome.is_driven:
            assert row["place"] is row["segment_least_radius"] is row["fastest"] is None
            continue
        assert test.trajectory is not None
        along = np.arange(max(row["place"] - 30.0, 0.0), row["place"] + 30.0, 0.01)
        curvatures = np.abs(test.road.curvature_at(along[along <= test.road.length]))
        assert 1.0 / row["segment_least_radius"] == pytest.approx(curvatures.max(), abs=1e-4)
        assert row["fastest"] == test.trajectory.speed.max()


def test_csv_has_the_same_values(searched: Path, tmp_path: Path) -> None:
    rows = rows_of(searched, tmp_path / "json")
    folder = export_campaign(searched, "csv", tmp_path / "csv", trajectories="none")
    with (folder / "tests.csv").open(encoding="utf-8", newline="") as file:
        cells = list(csv.DictReader(file))
    for name in ("cause", "distinct_failure", "segment_least_radius", "minimised_length"):
        texts = ["" if row[name] is None else str(row[name]) for row in rows]
        assert [row[name] for row in cells] == texts
    assert list(cells[0]) == list(json.loads((folder / DESCRIPTION).read_bytes())["tests"])


def test_failures_are_analysed_once_and_only_if_they_are_exported(
    searched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def counted(store: CampaignStore) -> Any:
        calls.append(store.folder)
        return distinct_failures(store)

    monkeypatch.setattr(failure_values, "distinct_failures", counted)
    rows_of(searched, tmp_path / "passed", outcomes="PASS")
    assert calls == []
    rows_of(searched, tmp_path / "all", trajectories="all")
    assert calls == [searched]


def test_a_failure_that_repeats_an_earlier_road_has_a_cause_and_no_number(
    searched: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(searched, tmp_path / "repeated"))
    first, repeat = (row["id"] for row in rows_of(searched, tmp_path / "f", outcomes="FAIL")[:2])
    columns = "curvatures, step, points, superelevation, grade, widening, speed_limits"
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        connection.execute(
            f"UPDATE test SET ({columns}) = (SELECT {columns} FROM test WHERE id = ?) WHERE id = ?",
            (first, repeat),
        )
        connection.commit()
    rows = {row["id"]: row for row in rows_of(folder, tmp_path / "json")}
    assert rows[repeat]["distinct_failure"] is None
    assert rows[repeat]["cause"]
    assert rows[first]["distinct_failure"] is not None


def test_conditions_are_those_of_the_campaign_and_of_the_drive(tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as stop:
        frenetic_command(
            *("run", "--simulations", "3", "--seed", "1", "--out", str(tmp_path / "c")),
            *("--with", "friction=0.7", "--with", "noise=0.1", "--strategy", "random"),
        )
    assert stop.value.code == 0
    for row in rows_of(tmp_path / "c", tmp_path / "json"):
        assert (row["condition_friction"], row["condition_noise"]) == (0.7, 0.1)


def frenetic_command(*words: str) -> None:
    from frenetic.cli import main

    main(list(words))


def test_conditions_of_a_drive_win(rewrite_campaign: RewriteCampaign, tmp_path: Path) -> None:
    def change(test: Test) -> Test:
        if test.result_number != 5:
            return test
        return replace(test, candidate=replace(test.candidate, conditions={"friction": 0.5}))

    folder = rewrite_campaign(change, conditions={"friction": 0.7})
    amounts = {
        row["result_number"]: row["condition_friction"] for row in rows_of(folder, tmp_path / "j")
    }
    assert amounts.pop(5) == 0.5
    assert set(amounts.values()) == {0.7}


def test_a_failure_in_which_time_stands_still_is_exported(
    rewrite_campaign: RewriteCampaign, tmp_path: Path
) -> None:
    def change(test: Test) -> Test:
        if test.trajectory is None or test.outcome is not Outcome.FAIL:
            return test
        rows = test.trajectory.to_rows()
        rows[:, 0] = 0.0
        return replace(test, trajectory=Trajectory.from_rows(rows))

    folder = rewrite_campaign(change)
    rows = rows_of(folder, tmp_path / "json", trajectories="all")
    assert "FAIL" in {row["outcome"] for row in rows}


def test_trajectories_have_all_signals_of_a_trace(searched: Path, tmp_path: Path) -> None:
    folder = export_campaign(searched, "csv", tmp_path / "csv", outcomes="FAIL")
    with (folder / "trajectories.csv").open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file)
        rows = list(reader)
    names = [column.name for column in TRACE_COLUMNS]
    assert reader.fieldnames == ["id", *names]
    with CampaignStore.open(searched) as store:
        for test in store.tests(Outcome.FAIL, with_trajectory=True):
            trace = trace_of_test(test)
            cells = (
                [row[name] or "nan" for name in names] for row in rows if row["id"] == str(test.id)
            )
            values = np.array([[*map(float, texts)] for texts in cells])
            assert values[: len(trace)] == pytest.approx(
                trace.values.T, abs=6e-5, rel=1e-12, nan_ok=True
            )
            after = values[len(trace) :, len(Trajectory.names()) :]
            assert np.isnan(after).all()


def test_values_that_are_too_large_to_be_exact_are_missing(
    searched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def with_large_values(traced: TracedDrive, signals: Sequence[str]) -> FloatArray:
        values = derived_values(traced, signals)
        values[0], values[1] = 1e300, -1e12
        return values

    monkeypatch.setattr(record_columns, "derived_values", with_large_values)
    with CampaignStore.open(searched) as store:
        test = next(store.tests(Outcome.FAIL, with_trajectory=True))
    values = record_columns.record_values(test, ())
    assert np.isnan(values[0]).all()
    assert np.isnan(values[1]).all()
    assert not np.isnan(values[2]).all()


def test_signals_of_other_packages_have_columns(
    sample_campaign: Path,
    rewrite_campaign: RewriteCampaign,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    signal = Signal(
        "twice", "m/s", "of the speed", 1.0, series=lambda located, _: 2.0 * located.path.speed
    )
    for module in ("criteria.criterion", "oracle.signals", "export.trace_columns"):
        monkeypatch.setattr(
            f"frenetic.{module}.signal_named",
            lambda name: signal if name == "twice" else signal_named(name),
        )
    criteria = CriteriaSet.of("competition", {"twice": 99.0}).as_json()
    with CampaignStore.open(sample_campaign) as store:
        rules: Any = store.config["rules"]
    folder = rewrite_campaign(lambda test: test, rules={**rules, "criteria": criteria})
    out = export_campaign(folder, "json", tmp_path / "json", outcomes="PASS")
    lines = (out / "trajectories.jsonl").read_bytes().splitlines()
    for row in map(json.loads, lines[:100]):
        assert row["signal_twice"] == pytest.approx(2.0 * row["speed"])
    described = json.loads((out / DESCRIPTION).read_bytes())["trajectories"]["signal_twice"]
    assert described == {"about": "of the speed", "unit": "m/s"}
