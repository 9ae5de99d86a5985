"""`frenetic calibrate`: what it prints and writes, its file, and the one line for each mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic.twin.profile import Profile

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

FILE = """
recordings = ["slow"]
driver = "stanley"
fit = ["lateral_acceleration=5:9", "delay=0:0.1"]
evaluations = 4
folds = 2
workers = 1
"""
FIT = ("--driver", "stanley", "--fit", "lateral_acceleration=5:9,delay=0:0.1")


def test_it_prints_a_verdict_and_writes_a_profile(frenetic: Frenetic) -> None:
    how = ("--driver", "stanley", "--strategy", "random", "--seed", "101", "--workers", "1")
    assert frenetic("run", *how, "--simulations", "12", "--out", "slow").code == 0
    Path("fit.toml").write_text(FILE, encoding="utf-8")
    answer = frenetic("calibrate", "fit.toml", "--out", "new/twin.json")
    assert answer.code == 0
    assert "12 recorded drives of 1 run" in answer.err
    assert "There is one run only: the cross-validation holds roads out" in answer.err
    for words in ("driver.lateral_acceleration", "layer.delay", "twin ", "largest curvature"):
        assert words in answer.out
    assert "start from" in answer.out
    assert [place.name for place in Path("new").iterdir()] == ["twin.json"]
    profile = Profile.read("new/twin.json")
    assert profile.validation is not None
    assert profile.validation.by == "road"
    assert profile.recordings[0].drives == 12
    assert "delay" in profile.driven["layers"]
    # The same by options, as far as there are any.
    again = frenetic("calibrate", "slow", *FIT, "--evaluations", "4", "--workers", "1", "--json")
    found = json.loads(Path("profile.json").read_text(encoding="utf-8"))
    assert again.json == found
    assert found["settings"] | {"folds": 2} == json.loads(
        Path("new/twin.json").read_text(encoding="utf-8")
    )["settings"] | {"folds": 2}
    budget = ("--simulations", "2", "--workers", "1", "--out", "fast")
    assert frenetic("run", "--as", "profile.json", *budget).code == 0


@pytest.mark.parametrize(
    ("entries", "options", "words"),
    [
        ("", ("nowhere", *FIT), ("there is no file or folder nowhere",)),
        ("", ("slow", *FIT[:2], "--fit", "brakng"), ("no parameter 'brakng'", "'braking'?")),
        ("", ("slow", *FIT[:2]), ("nothing is to be fitted",)),
        ("", ("slow", *FIT[2:]), ("the twin has no driver",)),
        ("", ("slow", *FIT, "--out", "twin.toml"), ("name ends with .json",)),
        (
            "",
            ("slow", *FIT, "--vehicle", "tank"),
            ("vehicle is 'tank': default, metadrive or etk800",),
        ),
        ("", ("no.toml",), ("there is no file no.toml",)),
        ("weights = {grip = 1}", ("fit.toml",), ("'grip' - at `key` in `$.weights`",)),
        ("weights = {speed = -1}", ("fit.toml",), ("at `$.weights[...]`",)),
        ("terms = {oob_tolerance = 2}", ("fit.toml",), ("at `$.terms.oob_tolerance`",)),
        ("terms = {lane_width = -1}", ("fit.toml",), ("at `$.terms.lane_width`",)),
        ("fold = 1", ("fit.toml",), ("unknown field `fold`",)),
        ("sample = 9", ("fit.toml",), ("at `$.sample`",)),
        ("sample", ("fit.toml",), ("fit.toml does not say a calibration",)),
    ],
)
def test_a_mistake_is_one_line(
    frenetic: Frenetic, entries: str, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    Path("slow").mkdir()
    line = '{"curvatures": [0.0, 0.01], "outcome": "PASS"}\n'
    Path("slow/tests.jsonl").write_text(20 * line, encoding="utf-8")
    Path("fit.toml").write_text(FILE + entries, encoding="utf-8")
    assert frenetic("calibrate", *options).refuses(*words)
    assert sorted(place.name for place in Path().iterdir()) == ["fit.toml", "slow"]


def record_outcomes(varied: bool) -> None:
    rows = [
        {"curvatures": [0.0, 0.001 * i], "outcome": "FAIL" if varied and i > 9 else "PASS"}
        for i in range(20)
    ]
    Path("slow.jsonl").write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")


def test_drives_that_say_nothing_are_refused_before_any_file_is_written(frenetic: Frenetic) -> None:
    record_outcomes(varied=False)
    assert frenetic("calibrate", "slow.jsonl", *FIT).refuses("there is nothing to fit to")
    assert [place.name for place in Path().iterdir()] == ["slow.jsonl"]


def test_ctrl_c_keeps_nothing_and_says_so(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    record_outcomes(varied=True)
    monkeypatch.setattr("frenetic.twin.calibration.driving.TwinDriver.rows", interrupted)
    answer = frenetic("calibrate", "slow.jsonl", *FIT, "--workers", "1")
    assert answer.code == 130
    assert "Nothing was kept" in answer.err
    assert [place.name for place in Path().iterdir()] == ["slow.jsonl"]
