"""A results folder of the competition agrees with the campaign."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.export import competition_folder, data_frame, export_campaign
from frenetic.export.official_format import SimulationRecord
from frenetic.oracle.outcome import Outcome
from frenetic.road.validity import check_validity
from frenetic.search import RandomSearch
from frenetic.testing import DummyDriver, DummySimulator

if TYPE_CHECKING:
    from sample_campaign import RewriteCampaign

pytest_plugins = ["sample_campaign"]


@pytest.fixture(scope="session")
def campaign(sample_campaign: Path) -> Path:
    return sample_campaign


FIELDS = SimulationRecord._fields


@pytest.fixture(scope="module")
def exported(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_campaign(campaign, "competition", tmp_path_factory.mktemp("results") / "out")


def documents_in(folder: Path) -> dict[int, dict[str, Any]]:
    documents = [json.loads(p.read_text(encoding="utf-8")) for p in folder.glob("test.*.json")]
    return {document["id"]: document for document in documents}


def row(path: Path) -> dict[str, str]:
    with path.open(encoding="utf-8", newline="") as file:
        (only,) = csv.DictReader(file)
    return only


def test_every_road_test_has_a_file(campaign: Path, exported: Path) -> None:
    with CampaignStore.open(campaign) as store:
        records = {r.candidate.id: r for r in store.tests() if r.outcome is not Outcome.DROPPED}
    documents = documents_in(exported)
    assert documents.keys() == records.keys()
    assert (exported / "test.0001.json").is_file()
    for number, document in documents.items():
        record = records[number]
        assert document["test_outcome"] == record.outcome
        assert document["description"] == record.reason
        assert document["is_valid"] == (record.outcome is not Outcome.INVALID)
        assert bool(document["validation_message"]) == (record.outcome is Outcome.INVALID)
        assert bool(document["execution_data"]) == record.outcome.is_driven
        if record.outcome is not Outcome.INVALID:
            assert check_validity(document["road_points"])
        if record.departure is not None:
            assert document["description"].startswith("Car drove out of the lane ")
        for point in document["interpolated_points"]:
            assert point[2:] == [-28.0, 8.0]


def test_execution_data_agree_with_the_oracle(campaign: Path, exported: Path) -> None:
    documents = documents_in(exported)
    with CampaignStore.open(campaign) as store:
        for record in store.tests():
            if not record.outcome.is_driven:
                continue
            records = documents[record.candidate.id]["execution_data"]
            data = [dict(zip(FIELDS, values, strict=True)) for values in records]
            assert min(r["oob_distance"] for r in data) == pytest.approx(record.moobd, abs=2e-4)
            assert data[-1]["timer"] == pytest.approx(record.result.duration)
            assert data[-1]["is_oob"] == (record.departure is not None)
            assert data[0]["pos"][2] == -28.0


@pytest.mark.heavy
def test_tables_count_all_tests(campaign: Path, exported: Path) -> None:
    frame = data_frame(campaign)
    number = frame["outcome"].value_counts()
    tests = len(frame) - number["DROPPED"]
    statistics = row(exported / "generation_stats.csv")
    assert {name: float(value) for name, value in statistics.items() if "time" not in name} == {
        "test_generated": tests,
        "test_valid": tests - number["INVALID"],
        "test_invalid": number["INVALID"],
        "test_passed": number["PASS"],
        "test_failed": number["FAIL"],
        "test_in_error": 0,
    }
    assert float(statistics["simulated_time_execution"]) == pytest.approx(
        frame["duration"].sum(), abs=1e-3
    )
    spent = frame["seconds"][frame["outcome"].isin(["PASS", "FAIL"])].sum()
    assert float(statistics["real_time_execution"]) == pytest.approx(spent, abs=1e-3)
    rest = frame["elapsed"].max() - spent
    assert float(statistics["real_time_generation"]) == pytest.approx(rest, abs=2e-3)
    sides = frame["departure_side"].value_counts()
    oob = row(exported / "oob_stats.csv")
    assert int(oob["left_oob"]) == sides["left"]
    assert int(oob["right_oob"]) == sides["right"]
    assert int(oob["total_oob"]) == sides.sum()
    assert 0.0 < float(oob["stdev_sparseness"]) < float(oob["avg_sparseness"])
    experiment = row(exported / "experiment_description.csv")
    assert experiment == {
        "executor": "EmbeddedSimulator",
        "time_budget": "",
        "map_size": "200.0",
        "oob_tolerance": "0.95",
        "speed_limit": "70.0",
        "module_name": "frenetic.search.frenetic_2021",
        "class_name": "Frenetic2021",
    }


def test_a_choice_of_outcomes_changes_the_files_but_not_the_tables(
    campaign: Path, exported: Path, tmp_path: Path
) -> None:
    folder = export_campaign(
        campaign, "competition", tmp_path / "out", outcomes=["FAIL"], trajectories="none"
    )
    documents = documents_in(folder)
    assert {document["test_outcome"] for document in documents.values()} == {"FAIL"}
    assert all(document["execution_data"] == [] for document in documents.values())
    for name in ("generation_stats.csv", "oob_stats.csv", "experiment_description.csv"):
        assert (folder / name).read_text() == (exported / name).read_text()


def test_sparseness_of_too_many_failures_is_left_empty(
    campaign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(competition_folder, "MOST_COMPARED", 2)
    folder = export_campaign(campaign, "competition", tmp_path / "out", trajectories="none")
    oob = row(folder / "oob_stats.csv")
    assert int(oob["total_oob"]) > 2
    assert (oob["avg_sparseness"], oob["stdev_sparseness"]) == ("", "")


def test_generation_time_is_unknown_with_several_workers(
    rewrite_campaign: RewriteCampaign, tmp_path: Path
) -> None:
    folder = rewrite_campaign(lambda test: test, workers=4)
    out = export_campaign(folder, "competition", tmp_path / "out", trajectories="none")
    assert row(out / "generation_stats.csv")["real_time_generation"] == ""


def test_a_campaign_without_failures_has_empty_sparseness(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=DummySimulator(lambda road: 0.5),
        driver=DummyDriver(),
        budget=Budget(simulations=3, time=60.0),
        folder=tmp_path / "c",
    ).run()
    folder = export_campaign(tmp_path / "c", "competition")
    assert row(folder / "oob_stats.csv") == {
        "total_oob": "0",
        "left_oob": "0",
        "right_oob": "0",
        "avg_sparseness": "",
        "stdev_sparseness": "",
    }
    assert row(folder / "experiment_description.csv")["time_budget"] == "60.0"
