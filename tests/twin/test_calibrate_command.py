"""`frenetic calibrate`: what it prints and writes, and the one line for each mistake."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.twin.profile import Profile

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

QUICK = ("--evaluations", "4", "--folds", "2", "--workers", "1")
FIT = ("--driver", "stanley", "--fit", "lateral_acceleration=5:9,delay=0:0.1")


def record(frenetic: Frenetic) -> None:
    how = ("--driver", "stanley", "--strategy", "random", "--seed", "101", "--workers", "1")
    assert frenetic("run", *how, "--simulations", "12", "--out", "slow").code == 0


@pytest.mark.usefixtures("drawn")
def test_it_prints_a_verdict_and_writes_profile_page_and_picture(frenetic: Frenetic) -> None:
    record(frenetic)
    named = (*FIT, *QUICK, "--name", r"$\of$")  # no formula, in the picture neither
    answer = frenetic("calibrate", "slow", *named, "--out", "new/twin.json")
    assert answer.code == 0
    assert "12 recorded drives of 1 run" in answer.err
    assert "There is one run only: the cross-validation holds roads out" in answer.err
    for words in ("driver.lateral_acceleration", "layer.delay", "Twin ", "Largest curvature"):
        assert words in answer.out
    assert "screen with" in answer.out
    assert sorted(place.name for place in Path("new").iterdir()) == [
        "twin.html",
        "twin.json",
    ]
    page = Path("new/twin.html").read_text(encoding="utf-8")
    assert r"The twin $\of$" in page
    assert "There is one run only" in page
    profile = Profile.read("new/twin.json")
    assert profile.validation is not None
    assert profile.validation.by == "road"
    assert profile.recordings[0].drives == 12
    assert "delay" in profile.driven["layers"]
    again = frenetic("calibrate", "slow", *named, "--out", "twin.json", "--json")
    assert again.json == json.loads(Path("new/twin.json").read_text(encoding="utf-8"))
    budget = ("--simulations", "2", "--workers", "1", "--out", "fast")
    assert frenetic("run", "--as", "twin.json", *budget).code == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("nowhere", *FIT), ("there is no file or folder nowhere",)),
        (("slow", *FIT[:2], "--fit", "brakng"), ("no parameter 'brakng'", "'braking'?")),
        (("slow", *FIT[:2], "--fit", "braking=1:x"), ("is not NAME=LOW:HIGH, as in braking=1:4",)),
        (("slow", *FIT[:2], "--fit", "braking,,"), ("has an empty name",)),
        (("slow", *FIT[:2]), ("Missing option '--fit'",)),
        (("slow", *FIT, "--out", "twin.toml"), ("name ends with .json",)),
        (("slow", *FIT, "--weight", "grip=1"), ("no term 'grip'",)),
        (("slow", *FIT, "--weight", "speed"), ("--weight speed: NAME=NUMBER is needed",)),
        (
            ("slow", *FIT, "--vehicle", "name=tank"),
            ("vehicle is 'tank': default, metadrive or etk800",),
        ),
        (("slow", *FIT, "--oob-tolerance", "2"), ("oob_tolerance is 2.0",)),
        (("slow", *FIT, "--lane-width", "-1"), ("lane_width",)),
    ],
)
def test_a_mistake_is_one_line(
    frenetic: Frenetic, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    Path("slow").mkdir()
    line = '{"curvatures": [0.0, 0.01], "outcome": "PASS"}\n'
    Path("slow/tests.jsonl").write_text(20 * line, encoding="utf-8")
    assert frenetic("calibrate", *options, *QUICK).refuses(*words)
    assert sorted(place.name for place in Path().iterdir()) == ["slow"]


def test_drives_that_say_nothing_are_refused_before_any_file_is_written(frenetic: Frenetic) -> None:
    rows = [{"curvatures": [0.0, 0.001 * i], "outcome": "PASS"} for i in range(20)]
    Path("slow.jsonl").write_text("\n".join(map(json.dumps, rows)), encoding="utf-8")
    assert frenetic("calibrate", "slow.jsonl", *FIT, *QUICK).refuses("there is nothing to fit to")
    assert [place.name for place in Path().iterdir()] == ["slow.jsonl"]
