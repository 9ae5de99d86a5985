"""The command line of confirm and doctor."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from permissions import bound_by_permissions

from frenetic.redrive.confirm import read_confirmations

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


@pytest.mark.usefixtures("drawn")
def test_failing_otherwise_is_no_confirmation(frenetic: Frenetic, campaign: str) -> None:
    answer = frenetic("confirm", campaign, "--simulator-option", "friction=0.8", "--top", "3")
    assert answer.code == 0
    assert re.search(r"3 failures: 3 failing otherwise \(\d .*elsewhere\)", answer.out)
    assert "rank correlation of MOOBD:" in answer.out
    (kept,) = Path(campaign).glob("again/*")
    assert f"Kept in {kept}; to see it: frenetic report c\n" in answer.out
    assert [len(one.tests) for one in read_confirmations(Path(campaign))] == [3]
    (gallery,) = (Path(campaign) / "confirmed").glob("*/gallery.png")
    assert gallery.stat().st_size > 10_000
    assert f"At a glance: {gallery}" in answer.out
    assert "own simulator" not in answer.err


def test_where_no_drive_can_be_judged_there_is_no_picture_and_the_exit_code_is_1(
    frenetic: Frenetic, campaign: str
) -> None:
    Path("broken.py").write_text(
        "from frenetic import Planner\n\n"
        "class Broken(Planner):\n"
        "    def reset(self, setup):\n"
        "        raise RuntimeError('no idea')\n"
    )
    parts = ["--simulator", "embedded", "--driver", "broken.py:Broken"]
    answer = frenetic("confirm", campaign, *parts, "--top", "2")
    assert answer.code == 1
    assert "no idea" in answer.out
    assert not (Path(campaign) / "confirmed").exists()


def test_ctrl_c_while_it_draws_loses_no_result(
    frenetic: Frenetic, campaign: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("frenetic.report.confirmation.write_confirmation", interrupted)
    options = ("confirm", campaign, "--simulator-option", "friction=0.8", "--top", "1")
    answer = frenetic(*options)
    assert answer.code == 130
    assert "1 failure: " in answer.out
    assert len(frenetic(*options, "--json").json["tests"]) == 1


def test_chosen_tests_as_json(frenetic: Frenetic, campaign: str) -> None:
    everything = frenetic("confirm", campaign, "--simulator", "embedded", "--json").json
    ids = [str(test["test"]) for test in everything["tests"]]
    answer = frenetic("confirm", campaign, *ids[:2], "--simulator", "embedded", "--json")
    assert [str(test["test"]) for test in answer.json["tests"]] == ids[:2]
    assert answer.json["confirmed"] == answer.json["alike"] == 2
    assert "trajectory" not in answer.json["tests"][0]
    assert "own simulator and driver" in answer.err


def test_confirming_some_tests_replaces_nothing_of_the_others(
    frenetic: Frenetic, campaign: str
) -> None:
    again = ("confirm", campaign, "--simulator-option", "friction=0.8", "--json")
    first = frenetic(*again, "--top", "3").json["tests"]
    (second,) = frenetic(*again, str(first[0]["test"])).json["tests"]
    assert second == first[0]
    (kept,) = read_confirmations(Path(campaign))
    assert sorted(one.test_id for one in kept.tests) == sorted(one["test"] for one in first)
    assert kept.missing == 0


@pytest.mark.skipif(sys.platform == "win32", reason="folders have no such permissions there")
def test_a_campaign_that_cannot_be_written_is_confirmed_elsewhere(
    frenetic: Frenetic, campaign: str, tmp_path: Path
) -> None:
    again = ("confirm", campaign, "--simulator", "embedded", "--top", "1")
    tmp_path.chmod(0o777)
    Path(campaign).chmod(0o555)
    with bound_by_permissions(Path(campaign).resolve()):
        assert frenetic(*again).refuses("Permission denied", "--out")
        answer = frenetic(*again, "--out", "out")
    Path(campaign).chmod(0o755)
    assert answer.code == 0
    assert "Kept in out; to see it: frenetic report out\n" in answer.out
    assert "At a glance: out/confirmed/" in answer.out


def test_it_has_to_be_another_simulator(frenetic: Frenetic, campaign: str) -> None:
    assert frenetic("confirm", campaign).refuses("say in which simulator", "frenetic regression")
    both = frenetic("confirm", campaign, "1", "--top", "2", "--simulator", "embedded")
    assert both.refuses("--top and the ID of a test exclude each other")
    other = frenetic("confirm", campaign, "--simulator", "embedded", "--headless")
    assert other.refuses("--headless is for --simulator beamng")


def test_campaign_without_failures(frenetic: Frenetic) -> None:
    assert frenetic("run", "--simulations", "1", "--seed", "1", "--out", "c").code == 0
    answer = frenetic("confirm", "c", "--simulator", "embedded")
    assert (answer.code, answer.out) == (0, "c holds no failure\n")


def test_doctor_of_the_embedded_simulator(frenetic: Frenetic) -> None:
    answer = frenetic("doctor", "--simulator", "embedded")
    assert answer.code == 0
    assert "ok    curve, Stanley: 120 m in" in answer.out
    assert answer.out.endswith("embedded: all is well\n")


def test_doctor_finds_what_is_wrong_and_exits_1(frenetic: Frenetic) -> None:
    arguments = ("doctor", "--simulator", "embedded", "--simulator-option", "friction=0.2")
    answer = frenetic(*arguments)
    assert answer.code == 1
    assert "WRONG curve, Stanley: Car drove out of the lane" in answer.out
    assert answer.out.endswith("embedded: 1 of the checks failed\n")
    (examination,) = frenetic(*arguments, "--json").json
    assert examination["health"] == "something is wrong"
    assert [check["name"] for check in examination["checks"] if not check["is_ok"]] == [
        "curve, Stanley"
    ]


def test_doctor_of_a_users_own_simulator(frenetic: Frenetic) -> None:
    Path("mine.py").write_text(
        "from frenetic.testing import DummySimulator\n"
        "class Mine(DummySimulator):\n"
        "    def __init__(self):\n"
        "        super().__init__()\n"
    )
    answer = frenetic("doctor", "--simulator", "mine.py:Mine", "--json")
    assert answer.code == 0
    assert [check["name"] for check in answer.json[0]["checks"]] == [
        "start",
        "straight road, Stanley",
        "curve, Stanley",
    ]


def test_options_need_a_simulator(frenetic: Frenetic) -> None:
    assert frenetic("doctor", "--headless").refuses("options of a simulator need --simulator")
    assert json.loads(frenetic("doctor", "--simulator", "embedded", "--json").out)
