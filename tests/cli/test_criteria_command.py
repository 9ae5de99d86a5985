"""Criteria on the command line, from a search over its files to driving them again."""

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

GENTLE = ("--driver", "planner,lateral_acceleration=2.2,braking=1.8", "--seed", "1")
ISO = ("--criteria", "after-iso-11270")


@pytest.fixture(scope="module")
def gentle(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign in which some drives exceed a limit and no car leaves its lane."""
    folder = tmp_path_factory.mktemp("gentle") / "c"
    prepare("run", *GENTLE, *ISO, "--simulations", "40", "--workers", "1", "--out", str(folder))
    return folder


def test_show_check_and_drive_know_them(frenetic: Frenetic, gentle: Path) -> None:
    shown = frenetic("show", str(gentle))
    assert "after-iso-11270: edge distance at least 0 m" in shown.out
    assert "driven for" in shown.out
    assert "exceeds the limit of" in shown.out
    assert "criteria: least distance" in shown.out, "which is what the search makes worse"
    document = frenetic("show", str(gentle), "--json").json
    assert document["failed"] > 0
    assert document["config"]["rules"]["criteria"]["name"] == "after-iso-11270"
    assert frenetic("check", str(gentle)).out.splitlines()[-1].endswith("nothing is wrong")
    margin = (
        r"; worst margin to a criterion -[\d.]+: [a-z ]+ [\d.]+ m/s.? \(at most .*\), in test \d+"
    )
    assert re.search(margin, shown.out), "the worst value says which criterion it is"
    assert "best" not in shown.out
    number = str(document["causes"][0]["example"])
    again = frenetic("drive", str(gentle), number)
    assert "as in the campaign" in again.out
    assert "  exceeded\n" in again.out
    other = frenetic("drive", str(gentle), number, "--criteria", "competition", "--json").json
    assert (other["outcome"], other["findings"]) == ("PASS", [])
    assert all(row["limit"] is None for row in other["measures"])


def test_two_versions_are_compared_by_what_they_exceed(frenetic: Frenetic, gentle: Path) -> None:
    answer = frenetic("compare", str(gentle), "--driver", "braking=1.7", "--fresh", "5")
    assert answer.code in (0, 1, 3), answer.err
    assert "exceeds the limit of" in answer.out
    assert answer.out.startswith(("better", "worse", "no difference"))


def test_a_minimised_road_exceeds_the_same_limit(frenetic: Frenetic, gentle: Path) -> None:
    files = sorted((gentle / "minimised").glob("test-?????.json"))
    assert files
    told = json.loads(files[0].read_text(encoding="utf-8"))
    driven = frenetic("drive", str(files[0]), "--json").json
    assert driven["outcome"] == "FAIL"
    assert driven["findings"] == told["findings"] != []
    number = files[0].stem.removeprefix("test-").lstrip("0")
    found = frenetic("show", str(gentle), number, "--json").json
    assert {one["criterion"] for one in driven["findings"]} <= {
        one["criterion"] for one in found["findings"]
    } | {driven["findings"][0]["criterion"]}


@pytest.mark.heavy
def test_its_file_and_resume_go_on_with_them(
    frenetic: Frenetic, gentle: Path, tmp_path: Path
) -> None:
    file = str(gentle / "campaign.toml")
    again = frenetic("run", file, "--workers", "1", "--out", str(tmp_path / "again"), "--json")
    before = frenetic("show", str(gentle), "--json").json
    assert again.json["failed"] == before["failed"]
    more = frenetic("resume", str(tmp_path / "again"), "--simulations", "4", "--json").json
    assert (more["objective"], more["worst"] < 0.0) == ("criteria", True)
    assert more["simulations"] == 44
    as_file = frenetic("run", *GENTLE, "--as", file, "--simulations", "3", "--out", "d", "--json")
    config = frenetic("show", as_file.json["folder"], "--json").json["config"]
    assert config["rules"]["criteria"]["name"] == "after-iso-11270"


def test_the_report_tells_what_was_exceeded_and_what_was_kept(gentle: Path) -> None:
    text = (gentle / "report.html").read_text(encoding="utf-8")
    assert "or exceeds another criterion" in text
    assert "(at most 5 m/s³ in the mean of 0.5 s)" in text
    assert '"kept"' in text


def test_the_list_has_limits_and_what_was_left_out(frenetic: Frenetic) -> None:
    out = frenetic("list", "criteria").out
    assert "lateral acceleration  -            3  " in out
    assert "Left out: " in out
    documents = frenetic("list", "criteria", "--json").json
    assert [one["name"] for one in documents][:2] == ["competition", "after-iso-11270"]


@pytest.mark.parametrize(
    ("criteria", "words"),
    [("iso", "there are no criteria 'iso'"), ("none.toml", "there is no file none.toml")],
)
def test_mistakes(frenetic: Frenetic, criteria: str, words: str) -> None:
    answer = frenetic("run", "--criteria", criteria)
    assert answer.code == 2
    assert words in answer.err
