"""The order of roads, and the command rank."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from frenetic.outcome import Outcome
from frenetic.road.files import find_roads
from frenetic.spec import Part, Spec
from frenetic.twin import Prospect, rank
from frenetic.twin.profile import Profile

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

GENTLE = [0.0, 0.01, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0]
SHARP = [0.0, 0.0, 0.0, 0.0, 0.05, 0.05, 0.05, 0.0, 0.0, 0.0]
MIRRORED = [-value for value in SHARP]
CIRCLE = [0.08] * 15
FAST = ("--driver", "aggression=3")


@pytest.fixture
def roads(tmp_path: Path) -> Path:
    """A folder of roads and of a file that is none."""
    folder = tmp_path / "roads"
    (folder / "deeper").mkdir(parents=True)
    named = {"gentle": GENTLE, "sharp": SHARP, "deeper/mirrored": MIRRORED, "circle": CIRCLE}
    named["again"] = SHARP
    for name, curvatures in named.items():
        (folder / f"{name}.json").write_text(json.dumps({"curvatures": curvatures}))
    (folder / "settings.json").write_text("{}")
    (folder / "notes.txt").write_text("none")
    return folder


def prospect(name: str, share: float, moobd: float, *at: float, side: str = "left") -> Prospect:
    approach = np.array(at) if at else None
    kind = Outcome.FAIL if share > 0.95 else Outcome.PASS
    return Prospect(name, 100.0, kind, "so", (share, -moobd), 50.0, side, approach)  # type: ignore[arg-type]


def test_the_largest_share_comes_first_then_the_lowest_moobd() -> None:
    broken = Prospect("broken", 100.0, Outcome.ERROR, "it broke")
    mild, worse, worst = (
        prospect("mild", 0.0, 1.0, 0.0),
        prospect("worse", 0.0, 0.5, 9.0),
        prospect("worst", 0.2, 0.9, 99.0),
    )
    ranked = rank([broken, mild, worst, worse])
    assert [one.name for one, _ in ranked] == ["worst", "worse", "mild", "broken"]


def test_roads_that_promise_the_same_are_named_and_left_out_of_the_top() -> None:
    prospects = [
        prospect("a", 1.0, -3.0, 0.0),
        prospect("like a", 1.0, -2.0, 1.9),
        prospect("other side", 0.9, -1.0, 0.0, side="right"),
        prospect("other place", 0.8, -0.5, 2.1),
        Prospect("broken", 100.0, Outcome.ERROR, "it broke"),
    ]
    assert [like for _, like in rank(prospects)] == [None, 1, None, None, None]
    assert [one.name for one, _ in rank(prospects, 5)] == ["a", "other side", "other place"]
    assert [one.name for one, _ in rank(prospects, 1)] == ["a"]


def test_folders_are_searched_and_what_holds_no_road_is_told(roads: Path, tmp_path: Path) -> None:
    missing = tmp_path / "missing.json"
    found = find_roads([roads, missing])
    names = [Path(name).relative_to(roads).as_posix() for name in found.roads]
    assert names == [
        "again.json",
        "circle.json",
        "deeper/mirrored.json",
        "gentle.json",
        "sharp.json",
    ]
    (skipped,) = found.skipped
    assert skipped.startswith(f"{roads / 'settings.json'} has neither")
    assert found.faults == (f"there is no file {missing}",)


def test_roads_are_ranked_by_what_drive_says_of_them(frenetic: Frenetic, roads: Path) -> None:
    ranked = frenetic("rank", str(roads), *FAST, "--json").json
    names = [Path(one["road"]).stem for one in ranked]
    assert names[-1] == "circle"
    assert ranked[-1]["outcome"] == "INVALID"
    assert names[-2] == "gentle"
    assert set(names[:3]) == {"sharp", "again", "mirrored"}
    by_name = dict(zip(names, ranked, strict=True))
    assert {by_name["again"]["like"], by_name["sharp"]["like"]} == {
        None,
        min(by_name["again"]["rank"], by_name["sharp"]["rank"]),
    }
    assert by_name["mirrored"]["like"] is None
    for name in ("gentle", "sharp"):
        driven = frenetic("drive", by_name[name]["road"], *FAST, "--json").json
        assert by_name[name]["outcome"] == driven["outcome"]
        assert by_name[name]["moobd"] <= driven["moobd"]  # which ends where the lane is left
    assert by_name["gentle"]["outcome"] == "PASS"
    assert by_name["sharp"]["outcome"] == "FAIL"
    assert by_name["sharp"]["side"] != by_name["mirrored"]["side"]


def test_the_table_the_top_and_invalid_roads(frenetic: Frenetic, roads: Path) -> None:
    answer = frenetic("rank", str(roads), *FAST, "--top", "9")
    assert answer.code == 0
    assert "Different problems: 3 of the 9 asked for." in answer.out
    assert "1 other file without such a road left out" in answer.err
    assert "circle" not in answer.out
    circle, sharp = str(roads / "circle.json"), str(roads / "sharp.json")
    assert "INVALID" in frenetic("rank", circle).out
    (tolerant,) = frenetic("rank", sharp, *FAST, "--criteria", "oob_tolerance=1", "--json").json
    assert tolerant["outcome"] in ("PASS", "FAIL")
    Profile.of("twin", Spec(driver=Part("stanley", {"aggression": 3.0}))).write("twin.json")
    by_profile = frenetic("rank", sharp, "--as", "twin.json", "--json").json
    assert by_profile == frenetic("rank", sharp, "--driver", "stanley,aggression=3", "--json").json
    assert by_profile != frenetic("rank", sharp, "--json").json


def test_a_named_file_without_a_road_is_a_mistake_that_keeps_the_others(
    frenetic: Frenetic, roads: Path
) -> None:
    bad = roads / "settings.json"
    answer = frenetic("rank", str(bad), str(roads / "gentle.json"))
    assert answer.code == 2
    assert "gentle.json" in answer.out
    assert f"frenetic: {bad} has neither 'curvatures' nor 'road_points'" in answer.err
    assert frenetic("rank", str(bad)).refuses("settings.json")
    assert frenetic("rank", str(roads), "--top", "0").refuses("--top")
    assert frenetic("rank", "nowhere", "--json").refuses("there is no file nowhere")
