"""`frenetic rerun`: its output, its files and its exit codes."""

from __future__ import annotations

import re
import shlex
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from permissions import bound_by_permissions

from frenetic._support.words import counted
from frenetic.campaign import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.reruns import read_reruns

if TYPE_CHECKING:
    from collections.abc import Callable

    from command_line import Answer, Frenetic

pytest_plugins = ["command_line"]


def failures_of(folder: str) -> list[int]:
    with CampaignStore.open(folder) as store:
        return [test.id for test in store.tests(Outcome.FAIL, order_by="moobd")]


def test_a_deterministic_failure_is_reported_20_of_20(frenetic: Frenetic, copied: str) -> None:
    answer = frenetic("rerun", copied, "--times", "20", "--top", "3")
    assert answer.code == 0
    rows = [line for line in answer.out.splitlines() if line.count("20 of 20") == 2]
    (stored,) = read_reruns(copied)
    assert len(rows) == len(stored.tests) == 3, "each test fails every time, and in the same way"
    assert "20 drives of each, in the same conditions: " in answer.out
    assert "3 repeatable" in answer.out
    (folder,) = re.findall(r"Kept in (\S+);", answer.out)
    assert f"Kept in {folder}; to see it: frenetic report {copied}" in answer.out
    assert frenetic("check", str(folder)).code == 0
    assert frenetic("rerun", copied, "--times", "20", "--top", "3") == answer


def test_a_summary_comes_first_then_the_tests_that_are_named(
    frenetic: Frenetic, copied: str
) -> None:
    ids = [str(number) for number in failures_of(copied)]
    total = 2 * len(ids)
    summary = frenetic("rerun", copied, "--times", "2").out.splitlines()
    assert f"{total} of {total} drives fail ({total} same failure)" in summary[0]
    assert not any("interval" in line for line in summary)
    assert "Test by test: name the IDs, or --top 10" in summary
    with_rows = frenetic("rerun", copied, *ids, "--times", "2").out.splitlines()
    assert with_rows[0] == summary[0]
    assert any("interval" in line for line in with_rows)
    reversed_ids = frenetic("rerun", copied, ids[1], ids[0], "--json").json
    assert [str(test["test"]) for test in reversed_ids["tests"]] == [ids[1], ids[0]]


def test_a_study_of_stability_is_shown_by_the_campaign_and_its_report(
    frenetic: Frenetic, copied: str
) -> None:
    failures = len(failures_of(copied))
    assert "stability" not in frenetic("show", copied).out
    document = frenetic("rerun", copied, "--stability", "--json").json
    folders = set(Path(copied).glob("rerun/*"))
    answer = frenetic("rerun", copied, "--stability")
    assert answer.code == 0, answer.err
    assert set(Path(copied).glob("rerun/*")) == folders, "no drive is made twice"
    passing = len(document["passing_with_more_grip"])
    line = f"f {failures} failures, {passing} pass with 2 % more grip; "
    assert answer.out.startswith(f"O{line}")
    assert f"driven again {failures} of {failures}" in " ".join(answer.out.split())
    assert f"to see it: frenetic report {copied}" in answer.out
    shown = frenetic("show", copied).out
    assert f"stability  o{line}" in shown
    assert frenetic("report", copied).code == 0
    assert f"o{line}" in Path(copied, "report.html").read_text(encoding="utf-8")
    facts = frenetic("show", copied, "--json").json["facts"]
    assert facts["stability"]["total"]["failures"] == failures


def test_an_interrupted_study_goes_on_with_the_same_command(
    frenetic: Frenetic, copied: str, stopping_driver: Callable[[int], str]
) -> None:
    number = str(failures_of(copied)[0])
    command = ("rerun", copied, number, "--stability", "--driver", stopping_driver(2))
    answer = frenetic(*command)
    assert answer.code == 130
    assert "Interrupted: 1 drive to go; the same command continues" in answer.err
    stopping_driver(0)
    whole = frenetic(*command)
    assert whole.code == 0
    assert whole.out.startswith("Of 1 failure, ")
    (folder,) = re.findall(r"Kept in (\S+);", whole.out)
    assert frenetic("check", folder).code == 0


def test_a_study_with_another_driver_is_not_shown_by_the_campaign(
    frenetic: Frenetic, copied: str
) -> None:
    answer = frenetic("rerun", copied, "--stability", "--driver", "aggression=0.9", "--top", "2")
    assert answer.code == 0, answer.err
    assert "; the same command shows it" in answer.out
    assert "stability" not in frenetic("show", copied).out


@pytest.mark.parametrize("stop", [3, 4, 6])
def test_ctrl_c_exits_130_and_the_same_command_goes_on(
    frenetic: Frenetic, copied: str, stopping_driver: Callable[[int], str], stop: int
) -> None:
    ids = [str(number) for number in failures_of(copied)[:3]]
    options = ("--times", "2", "--junit", "rerun.xml", "--driver", stopping_driver(stop))
    command = ("rerun", copied, *ids, *options)
    before = len(list(Path(copied).glob("rerun/*")))
    answer = frenetic(*command)
    assert answer.code == (130 if stop < 6 else 0)
    assert "Finishing what runs" in answer.err
    left = f"Interrupted: {counted(6 - stop, 'drive')} to go; the same command continues"
    assert (left in answer.err) is (stop < 6)
    assert (f"{left}: frenetic {shlex.join(command)}\n" in answer.err) is (stop < 6)
    assert ("up to 2 drives of each" in answer.out) is (stop < 6)
    assert Path("rerun.xml").exists() is (stop == 6), (
        "a file of a part of the drives would look complete"
    )
    stopping_driver(0)
    whole = frenetic(*command)
    assert (whole.code, Path("rerun.xml").exists()) == (0, True)
    assert frenetic(*command) == whole
    tests = frenetic(*command, "--json").json["tests"]
    assert [len(test["drives"]) for test in tests] == [2, 2, 2]
    assert len(list(Path(copied).glob("rerun/*"))) == before + 1


@pytest.mark.skipif(sys.platform == "win32", reason="folders have no such permissions there")
def test_reruns_of_a_read_only_campaign_go_to_another_folder(
    frenetic: Frenetic, copied: str, tmp_path: Path
) -> None:
    command = ("rerun", copied, "--simulator", "friction=0.8", "--top", "1")
    tmp_path.chmod(0o777)
    Path(copied).chmod(0o555)
    with bound_by_permissions(Path(copied).resolve()):
        assert frenetic(*command).refuses("Permission denied", "--out")
        answer = frenetic(*command, "--out", "out")
    Path(copied).chmod(0o755)
    assert answer.code == 0
    assert "Kept in out; the same command shows it\n" in answer.out


MOVING = """
import os
import shutil
from frenetic import Planner


class Moving(Planner):
    drives = 0

    def reset(self, setup):
        Moving.drives += 1
        if Moving.drives == 3:
            {deed}
        super().reset(setup)

    def act(self, observation):
        return super().act(observation)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows moves no folder that is in use")
@pytest.mark.parametrize("command", ["rerun {} --all", "minimise {} --top 2 --max-drives 8"])
def test_a_campaign_that_moves_meanwhile_ends_the_command_in_one_line(
    command: str, frenetic: Frenetic, copied: str, tmp_path: Path
) -> None:
    (tmp_path / "moving.py").write_text(MOVING.format(deed=f"os.rename({copied!r}, 'moved')"))
    words = [*command.format(copied).split(), "--driver", f"{tmp_path / 'moving.py'}:Moving"]
    answer = frenetic(*words)
    place = f"{copied} was moved to {tmp_path / 'moved'} while its roads were driven again"
    assert answer.refuses(place if sys.platform == "linux" else f"{copied} was moved"), answer.err
    assert not Path(copied).exists()
    assert frenetic("check", "moved").code == 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows deletes no file that is in use")
@pytest.mark.parametrize("command", ["rerun {} --all", "minimise {} --top 2 --max-drives 8"])
def test_a_campaign_that_is_deleted_meanwhile_is_not_made_again(
    command: str, frenetic: Frenetic, copied: str, tmp_path: Path
) -> None:
    (tmp_path / "moving.py").write_text(MOVING.format(deed=f"shutil.rmtree({copied!r})"))
    words = [*command.format(copied).split(), "--driver", f"{tmp_path / 'moving.py'}:Moving"]
    assert frenetic(*words).refuses(f"{copied} was deleted while its roads were driven again")
    assert not Path(copied).exists()


# Other parts, exit codes and the JUnit file


DRIVER = """
from frenetic import Planner


class Fixed(Planner):
    def __init__(self):
        super().__init__(aggression=0.5)


class Crashing(Planner):
    def act(self, observation):
        raise ValueError("<not> finished & \\x07 done")
"""


def test_exit_code_and_junit_file_say_how_many_tests_fail_again(
    frenetic: Frenetic, copied: str
) -> None:
    def driven(*driver: str) -> tuple[Answer, list[int], set[str]]:
        """The answer, the numbers of tests, failures and errors, and their messages."""
        answer = frenetic("rerun", copied, "--junit", "a.xml", "--fail-on-failure", *driver)
        suite = ET.parse("a.xml").getroot()
        numbers = [int(suite.get(key, "-1")) for key in ("tests", "failures", "errors")]
        return answer, numbers, {failure.get("message", "") for failure in suite.iter("failure")}

    Path("mine.py").write_text(DRIVER)
    count = len(failures_of(copied))
    answer, numbers, _ = driven()
    assert (answer.code, numbers) == (1, [count, count, 0])
    assert frenetic("rerun", copied).code == 0, "without --fail-on-failure"
    assert " fail again (" in answer.out
    assert f"{count} of {count} drives ended exactly as before" in answer.out

    answer, numbers, _ = driven("--driver", "mine.py:Fixed")
    assert (answer.code, numbers) == (0, [count, 0, 0])
    assert " pass now\n" in answer.out
    assert "exactly as before" not in answer.out, "another driver is not asked to reproduce"

    answer, numbers, messages = driven("--driver", "mine.py:Crashing")
    assert (answer.code, numbers) == (1, [count, count, 0])
    assert "other mechanism" in answer.out
    assert all("ValueError: <not> finished & \\x07 done" in message for message in messages)
    assert not list(Path().glob("*.part"))

    worse = frenetic("rerun", copied, "--all", "--driver", "aggression=2.0", "--json").json
    assert len(worse["tests"]) == sum(worse["changes"].values()) == 60
    assert worse["changes"]["fails now"] > 0
    assert worse["driver"]["options"]["aggression"] == 2.0
    assert worse["conditions"] == {"delay": 0.05}, "the recorded delay stays"


def test_errors_of_steering_and_sensors_are_varied(frenetic: Frenetic, copied: str) -> None:
    usual = ("--vary", "steering_gain", "--vary", "speed_bias")
    answer = frenetic("rerun", copied, "--top", "1", "--times", "2", *usual)
    assert answer.code == 0, answer.err
    assert "steering_gain 0.8 to 1.2, speed_bias -5 to 5 km/h: " in answer.out
    with CampaignStore.open(copied) as store:
        best = max(store.tests(Outcome.PASS), key=lambda test: test.moobd or 0.0)
    worse = ("--vary", "steering_gain=0.4:1", "--times", "12")
    answer = frenetic("rerun", copied, str(best.id), *worse)
    assert "a lower steering gain is worse" in answer.out


def test_a_file_that_names_only_a_driver_drives_in_the_default_simulator(
    frenetic: Frenetic, copied: str
) -> None:
    Path("new.toml").write_text('driver = "stanley"\n')
    answer = frenetic("rerun", copied, "--top", "1", "--as", "new.toml")
    assert answer.code == 0
    assert answer.out.startswith("1 test, 1 drive of each: ")
