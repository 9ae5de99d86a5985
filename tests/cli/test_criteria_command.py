"""Criteria on the command line: run, show, check, drive, compare, minimise, resume and list."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

GENTLE_DRIVER = ("--driver", "planner,lateral_acceleration=2.2,braking=1.8", "--seed", "1")
ISO = ("--criteria", "after-iso-11270")


@pytest.fixture(scope="module")
def gentle_campaign(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign in which some drives exceed a limit and no car leaves its lane."""
    folder = tmp_path_factory.mktemp("gentle_campaign") / "c"
    prepare(
        "run", *GENTLE_DRIVER, *ISO, "--simulations", "40", "--workers", "1", "--out", str(folder)
    )
    return folder


def test_show_check_and_drive_judge_by_the_campaigns_criteria(
    frenetic: Frenetic, gentle_campaign: Path
) -> None:
    shown = frenetic("show", str(gentle_campaign))
    assert "after-iso-11270: edge distance at least 0 m" in shown.out
    assert "driven for" in shown.out
    assert "exceeds the limit of" in shown.out
    assert "criteria: least distance" in shown.out, "the objective of the search"
    document = frenetic("show", str(gentle_campaign), "--json").json
    assert document["failed"] > 0
    assert document["config"]["rules"]["criteria"]["name"] == "after-iso-11270"
    assert frenetic("check", str(gentle_campaign)).out.splitlines()[-1].endswith("nothing is wrong")
    margin = (
        r"; worst margin to a criterion -[\d.]+: [a-z ]+ [\d.]+ m/s.? \(at most .*\), in test \d+"
    )
    assert re.search(margin, shown.out), "the worst value says which criterion it is"
    assert "best" not in shown.out
    number = str(document["causes"][0]["example"])
    repeated = frenetic("drive", str(gentle_campaign), number)
    assert "as in the campaign" in repeated.out
    assert "  exceeded\n" in repeated.out
    without_limits = frenetic(
        "drive", str(gentle_campaign), number, "--criteria", "competition", "--json"
    ).json
    assert (without_limits["outcome"], without_limits["findings"]) == ("PASS", [])
    assert all(row["limit"] is None for row in without_limits["measures"])


def test_two_versions_are_compared_by_the_limits_that_they_exceed(
    frenetic: Frenetic, gentle_campaign: Path
) -> None:
    answer = frenetic("compare", str(gentle_campaign), "--driver", "braking=1.7", "--fresh", "5")
    assert answer.code in (0, 1, 3), answer.err
    assert "exceeds the limit of" in answer.out
    assert answer.out.startswith(("better", "worse", "no difference"))


def test_a_minimised_road_exceeds_the_same_limit(frenetic: Frenetic, gentle_campaign: Path) -> None:
    files = sorted((gentle_campaign / "minimised").glob("test-?????.json"))
    assert files
    stored = json.loads(files[0].read_text(encoding="utf-8"))
    driven = frenetic("drive", str(files[0]), "--json").json
    assert driven["outcome"] == "FAIL"
    assert driven["findings"] == stored["findings"] != []
    number = files[0].stem.removeprefix("test-").lstrip("0")
    shown = frenetic("show", str(gentle_campaign), number, "--json").json
    assert {finding["criterion"] for finding in driven["findings"]} <= {
        finding["criterion"] for finding in shown["findings"]
    } | {driven["findings"][0]["criterion"]}


@pytest.mark.heavy
def test_a_campaigns_file_and_resume_keep_the_criteria(
    frenetic: Frenetic, gentle_campaign: Path, tmp_path: Path
) -> None:
    file = str(gentle_campaign / "campaign.toml")
    repeated = frenetic("run", file, "--workers", "1", "--out", str(tmp_path / "again"), "--json")
    before = frenetic("show", str(gentle_campaign), "--json").json
    assert repeated.json["failed"] == before["failed"]
    resumed = frenetic("resume", str(tmp_path / "again"), "--simulations", "4", "--json").json
    assert (resumed["objective"], resumed["worst"] < 0.0) == ("criteria", True)
    assert resumed["simulations"] == 44
    as_file = frenetic(
        "run", *GENTLE_DRIVER, "--as", file, "--simulations", "3", "--out", "d", "--json"
    )
    config = frenetic("show", as_file.json["folder"], "--json").json["config"]
    assert config["rules"]["criteria"]["name"] == "after-iso-11270"


def test_the_report_says_which_limits_were_exceeded_and_which_were_kept(
    gentle_campaign: Path,
) -> None:
    text = (gentle_campaign / "report.html").read_text(encoding="utf-8")
    assert "or exceeds another criterion" in text
    assert "(at most 5 m/s³ in the mean of 0.5 s)" in text
    assert '"kept"' in text


def test_list_criteria_shows_limits_and_what_was_left_out(frenetic: Frenetic) -> None:
    out = frenetic("list", "criteria").out
    assert "lateral acceleration  -            3  " in out
    assert "Left out: " in out
    documents = frenetic("list", "criteria", "--json").json
    assert [criteria["name"] for criteria in documents][:2] == ["competition", "after-iso-11270"]


@pytest.mark.parametrize(
    ("criteria", "words"),
    [("iso", "there are no criteria 'iso'"), ("none.toml", "there is no file none.toml")],
)
def test_unknown_criteria_are_refused(frenetic: Frenetic, criteria: str, words: str) -> None:
    answer = frenetic("run", "--criteria", criteria)
    assert answer.code == 2
    assert words in answer.err
