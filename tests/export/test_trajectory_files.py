"""Files of trajectories and documents hold what pandas and Python's JSON write."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from msgspec.json import decode, encode

from frenetic import data_frame
from frenetic.campaign import CampaignStore
from frenetic.export import export_campaign
from frenetic.export.official_format import stored_test_document, stored_test_text

pytest_plugins = ["sample_campaign"]


@pytest.mark.heavy
def test_csv_is_as_pandas_writes_it(sample_campaign: Path, tmp_path: Path) -> None:
    folder = export_campaign(sample_campaign, "csv", tmp_path / "csv")
    frame = data_frame(sample_campaign, "trajectories")
    text = (folder / "trajectories.csv").read_text()
    assert text == frame.to_csv(index=False, lineterminator="\n")


@pytest.mark.heavy
def test_json_has_the_values_of_the_frame(sample_campaign: Path, tmp_path: Path) -> None:
    folder = export_campaign(sample_campaign, "json", tmp_path / "json")
    frame = data_frame(sample_campaign, "trajectories")
    lines = (folder / "trajectories.jsonl").read_bytes().splitlines()
    assert [decode(line) for line in lines] == [
        decode(encode(row)) for row in frame.to_dict("records")
    ]


@pytest.mark.heavy
def test_the_campaigns_of_several_are_named(sample_campaign: Path, tmp_path: Path) -> None:
    folder = export_campaign(sample_campaign.parent, "csv", tmp_path / "several")
    frame = data_frame(sample_campaign.parent, "trajectories")
    assert list(frame)[:2] == ["campaign", "id"]
    assert (folder / "trajectories.csv").read_text() == frame.to_csv(
        index=False, lineterminator="\n"
    )


def test_documents_are_as_json_dumps_writes_them(sample_campaign: Path) -> None:
    with CampaignStore.open(sample_campaign) as store:
        for test in store.tests(with_trajectory=True):
            assert stored_test_text(test) == json.dumps(stored_test_document(test))
