"""The command line of replay: what a continuous integration sees of it."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from command_line import Frenetic

pytest_plugins = ["command_line"]

DRIVER = """
from frenetic import Planner


class Fixed(Planner):
    def __init__(self):
        super().__init__(aggression=0.5)


class Crashing(Planner):
    def act(self, observation):
        raise ValueError("<not> finished & \\x07 done")
"""


def test_the_campaigns_own_driver_still_fails_and_exits_1(
    frenetic: Frenetic, campaign: str
) -> None:
    answer = frenetic("regression", campaign, "--junit", "replay.xml")
    assert answer.code == 1
    assert "still failing" in answer.out
    suite = ET.parse("replay.xml").getroot()
    assert int(suite.get("failures", "0")) == int(suite.get("tests", "0")) > 0
    assert f"{suite.get('tests')} of {suite.get('tests')} ended exactly as before" in answer.out


def test_a_summary_comes_first_and_rows_on_request(frenetic: Frenetic, campaign: str) -> None:
    summary = frenetic("regression", campaign).out.splitlines()
    with_rows = frenetic("regression", campaign, "--rows").out.splitlines()
    assert "driven again" in summary[0]
    assert summary[-1] == "Test by test: --rows"
    assert with_rows[0] == summary[0]
    failures = int(summary[0].split()[0])
    assert sum("still failing" in line for line in with_rows[1:]) == failures > len(summary)


def test_a_fixed_driver_exits_0(frenetic: Frenetic, campaign: str) -> None:
    Path("mine.py").write_text(DRIVER)
    answer = frenetic("regression", campaign, "--driver", "mine.py:Fixed", "--junit", "replay.xml")
    assert answer.code == 0
    assert "fixed" in answer.out
    assert "exactly as before" not in answer.out, "another driver is not asked to reproduce"
    suite = ET.parse("replay.xml").getroot()
    assert (suite.get("failures"), suite.get("errors")) == ("0", "0")
    assert not list(Path().glob("*.part"))


def test_a_driver_that_crashes_is_an_error_and_exits_1(frenetic: Frenetic, campaign: str) -> None:
    Path("mine.py").write_text(DRIVER)
    answer = frenetic(
        "regression", campaign, "--driver", "mine.py:Crashing", "--junit", "replay.xml"
    )
    assert answer.code == 1
    assert "not judged" in answer.out
    assert "Not passing: " in answer.out
    suite = ET.parse("replay.xml").getroot()
    assert suite.get("errors") == suite.get("tests")
    messages = {error.get("message", "") for error in suite.iter("error")}
    assert all("ValueError: <not> finished & \\x07 done" in message for message in messages)


def test_all_looks_for_new_failures(frenetic: Frenetic, campaign: str) -> None:
    answer = frenetic(
        "regression", campaign, "--all", "--driver-option", "aggression=2.0", "--json"
    )
    assert answer.code == 1
    document = answer.json
    assert len(document["tests"]) == 60
    assert document["changes"]["newly failing"] > 0
    assert document["passed"] is False
    assert document["driver"]["driver"]["options"]["aggression"] == 2.0
    assert document["driver"]["options"] == {"seconds": 0.05}, "the recorded delay stays"
    assert sum(document["changes"].values()) == 60


def test_what_is_given_takes_the_place_of_what_is_recorded(
    frenetic: Frenetic, campaign: str
) -> None:
    document = frenetic(
        *("regression", campaign, "--driver", "stanley", "--delay", "0.1", "--noise", "0.01"),
        *("--simulator-option", "friction=0.9", "--oob-tolerance", "0.5", "--json"),
    ).json
    assert document["driver"]["class"].endswith(":Delayed")
    assert document["driver"]["options"] == {"seconds": 0.1}
    assert document["driver"]["driver"]["class"].endswith(":Noisy")
    assert document["driver"]["driver"]["driver"]["class"].endswith(":Stanley")
    assert document["simulator"]["options"]["vehicle"]["friction"] == 0.9
    reasons = [test["reason"] for test in document["tests"] if test["after"] == "FAIL"]
    assert all("50% tolerated" in reason for reason in reasons if "lane" in reason)


def test_another_simulator_is_asked(frenetic: Frenetic, campaign: str) -> None:
    # Its car cannot leave the lane, so the failures are those of the other simulator.
    answer = frenetic("regression", campaign, "--simulator", "frenetic.testing:DummySimulator")
    assert answer.code == 0
    assert "fixed" in answer.out


def test_ctrl_c_exits_130_and_leaves_no_report_that_looks_complete(
    frenetic: Frenetic, campaign: str, stopping_driver: Callable[[int], str]
) -> None:
    again = ("regression", campaign, "--junit", "replay.xml", "--driver", stopping_driver(1))
    answer = frenetic(*again)
    assert answer.code == 130
    assert "1 failure driven again" in answer.out
    assert re.search(r"Interrupted: \d+ roads to go; the same command goes on", answer.err)
    assert not Path("replay.xml").exists()
    stopping_driver(0)
    whole = frenetic(*again)
    assert (whole.code, Path("replay.xml").exists()) == (1, True)
    assert frenetic(*again) == whole


def test_mistakes_are_one_line(frenetic: Frenetic, campaign: str) -> None:
    assert frenetic("regression", "nowhere").refuses("nowhere does not exist")
    assert frenetic("regression", campaign, "--junit", "no/such/a.xml").refuses("no folder")
    Path("folder").mkdir()
    answer = frenetic("regression", campaign, "--junit", "folder")
    assert answer.refuses("--junit", "folder cannot be written: Is a directory")
    assert not Path(campaign, "again").exists(), "nothing is driven before that"
    assert frenetic("regression", campaign, "--speed-limit", "-3").refuses("speed_limit is -3")
    assert frenetic("regression", campaign, "--driver-option", "courage=1").refuses("courage")
