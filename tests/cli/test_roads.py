"""Road classes on the command line: what run, show, drive, rerun, check and resume do with them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from frenetic.campaign import CampaignStore
from frenetic.road import Road
from frenetic.road.classes import RoadClass
from frenetic.spec import SPEC_FILE, Spec

if TYPE_CHECKING:
    from collections.abc import Callable

    from command_line import Frenetic

pytest_plugins = ["command_line"]

CLASS = "rural-80,length=800"
SEARCH = ("run", "--roads", CLASS, "--simulator", "embedded,friction=0.25", "--workers", "1")
SLIPPERY_SEARCH = (*SEARCH, "--simulations", "12", "--seed", "3")


@pytest.fixture(scope="module")
def slippery_campaign(
    tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]
) -> Path:
    """A campaign on icy roads of a class, on which most drives fail."""
    folder = tmp_path_factory.mktemp("slippery") / "c"
    prepare(*SLIPPERY_SEARCH, "--out", str(folder))
    return folder


def test_all_roads_of_a_search_keep_the_rules_of_their_class(slippery_campaign: Path) -> None:
    road_class = RoadClass.of("rural-80", {"length": 800})
    with CampaignStore.open(slippery_campaign) as store:
        setting = store.setting
        assert (setting.road_class, setting.map_size, setting.lane_width) == (road_class, 900, 3.5)
        assert setting.rules.speed_limit == 80.0
        tests = list(store.tests())
    assert {test.outcome for test in tests} <= {"PASS", "FAIL"}
    for test in tests:
        assert road_class.breach(test.road) == ""
        assert test.road.grade.any()
    assert Spec.read(slippery_campaign / SPEC_FILE).road_class == road_class


def test_metres_inside_the_lane_are_shown_with_half_the_lane_width(frenetic: Frenetic) -> None:
    calm = ("--driver", "aggression=0.3", "--simulations", "4", "--seed", "3", "--workers", "1")
    ran = frenetic("run", "--roads", "urban-50", *calm, "--out", "calm")
    assert re.search(r", at least 1\.\d\d of 1\.62 m inside its lane\n", ran.out)
    assert "inside (m, at most 1.62)" in ran.out, "heading of the near misses"
    stayed = r"m: the car's centre stayed 1\.\d\d of 1\.62 m inside its lane\n"
    for shown in (("show", "calm", "1"), ("drive", "calm", "1")):
        assert re.search(stayed, frenetic(*shown).out), shown
    assert "MOOBD (m, at most 1.62)" in frenetic("show", "calm", "--outcome", "PASS").out
    frenetic("run", "--roads", "urban-50", *calm, "--strategy", "random", "--out", "other")
    assert "MOOBD (m, at most 1.62)" in frenetic("compare", "calm", "other").out
    rerun = " ".join(frenetic("rerun", "calm", "1").out.split())
    assert "MOOBD (m, at most 1.62)" in rerun


def test_roads_of_a_class_are_driven_again_with_their_grades(
    frenetic: Frenetic, slippery_campaign: Path
) -> None:
    with CampaignStore.open(slippery_campaign) as store:
        (worst, *_) = [test.id for test in store.tests("FAIL", "moobd")]  # type: ignore[arg-type]
    repeated = frenetic("drive", str(slippery_campaign), str(worst), "--json")
    assert repeated.json["differs"] == ""
    road = next((slippery_campaign / "failures").glob("test-*.json"))
    assert json.loads(road.read_text())["grade"]
    driven = frenetic("drive", str(road), "--json")
    assert driven.json["outcome"] == "FAIL"
    assert frenetic("drive", str(road), "--dry").code == 0
    assert frenetic("rerun", str(slippery_campaign), str(worst), "--times", "1").code == 0
    assert "rerun/" not in frenetic("check", str(slippery_campaign)).out
    assert frenetic("show", str(slippery_campaign)).code == 0


def test_show_names_the_class_and_the_grade_and_superelevation_of_a_road(
    frenetic: Frenetic, slippery_campaign: Path
) -> None:
    assert "roads      rural-80, 80 km/h\n" in frenetic("show", str(slippery_campaign)).out
    assert (
        frenetic("show", str(slippery_campaign), "--json").json["config"]["road_class"]["length"]
        == 800
    )
    with CampaignStore.open(slippery_campaign) as store:
        road = store.test(1).road
    radius, lean = (1.0 / abs(road.curvatures).max(), abs(road.superelevation[:, 1]).max())
    line = f"{road.length:.0f} m, sharpest radius {radius:.0f} m, grade up to "
    shown = frenetic("show", str(slippery_campaign), "1").out
    assert f"road       {line}" in shown
    assert f" %, superelevation up to {100.0 * lean:.1f} %\n" in shown
    words = Road([0.0, -0.01, 0.0], grade=0.02, widening=0.5).as_text()
    assert words == "20 m, sharpest radius 100 m, grade up to +2.0 %, lanes up to 0.50 m wider"
    words = Road([0.0, 0.0], grade=np.array([[0.0, 0.01], [5.0, -0.04]])).as_text()
    assert words == "10 m, straight, grade up to −4.0 %"


def test_a_campaigns_file_repeats_its_search_and_resume_goes_on(
    frenetic: Frenetic, slippery_campaign: Path
) -> None:
    assert frenetic("run", str(slippery_campaign / SPEC_FILE), "--out", "again", "--json").code == 0
    first, repeated = (
        (folder / SPEC_FILE).read_text() for folder in (slippery_campaign, Path("again"))
    )
    assert first == repeated
    assert frenetic("resume", "again", "--simulations", "3", "--json").json["simulations"] == 15
    assert "roads" not in Path("again", SPEC_FILE).read_text().replace("[roads", "")


def test_options_win_over_the_class(frenetic: Frenetic) -> None:
    options = ("--roads", "urban-50", "--criteria", "speed_limit=80", "--map-size", "1500")
    frenetic("run", *options, "--simulations", "2", "--seed", "1", "--out", "town")
    with CampaignStore.open(Path("town")) as store:
        assert store.setting.rules.speed_limit == 80.0
        assert store.setting.map_size == 1500.0


def test_a_dry_drive_says_which_rule_a_road_breaks(frenetic: Frenetic) -> None:
    Path("road.json").write_text('{"curvatures": [0, 0.01, 0.01, 0, 0], "lane_width": 3.5}')
    answer = frenetic("drive", "road.json", "--dry", "--roads", "rural-80")
    assert answer.code == 1
    assert "INVALID  A radius of 100 m at 10 m: rural-80 needs at least 240 m" in answer.out
    assert frenetic("drive", "road.json", "--dry").code == 0
    Path("lane.toml").write_text("design_speed = 20\nmin_radius = 50\nmin_clothoid = 20\nmin_arc=0")
    answer = frenetic("drive", "road.json", "--dry", "--roads", "lane.toml", "--json")
    assert "A side friction of" in answer.json["message"] or answer.json["valid"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "--roads", "rural-90"), ("'--roads'", "rural-90", "choose competition, urban-50")),
        (("run", "--roads", "rural-80,radius=3"), ("there is no radius",)),
        (("run", "--roads", "length=3"), ("names no road class",)),
        (("run", "--roads", "nowhere.toml"), ("nowhere.toml",)),
        (("drive", "c", "1", "--roads", "rural-80"), ("a campaign has its own road class",)),
        (
            ("run", "--roads", "urban-50", "--driver", "marking-follower"),
            ("choose another driver, or --roads urban-50,max_superelevation=0,max_grade=0,widen",),
        ),
    ],
)
def test_unusable_road_classes_are_refused(
    frenetic: Frenetic, copied: str, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert frenetic(*arguments).refuses(*words)


def test_a_simulator_that_needs_flat_roads_refuses_a_class_before_it_drives(
    frenetic: Frenetic,
) -> None:
    Path("sledge.py").write_text(
        "import frenetic\n\nclass Sledge(frenetic.SteppedSimulator):\n    pass\n"
    )
    Path("lane.toml").write_text("design_speed = 80")
    run = ("run", "--simulator", "sledge.py:Sledge", "--out", "c", "--roads")
    one_width = "Sledge drives flat roads of one width only: choose another simulator, or --roads "
    for road_class, advice in (("rural-80", "rural-80"), ("lane.toml", "CLASS")):
        advice += ",max_superelevation=0,max_grade=0"
        answer = frenetic(*run, road_class)
        assert (answer.code, answer.err) == (2, f"frenetic: {one_width}{advice}\n")
        assert not Path("c").exists()
    flat = ("--roads", "rural-80,max_superelevation=0,max_grade=0", "--driver", "marking-follower")
    answer = frenetic("run", *flat, "--simulations", "1", "--seed", "1", "--out", "flat", "--json")
    assert answer.json["simulations"] == 1


def test_a_road_of_a_users_strategy_that_breaks_the_class_is_invalid(frenetic: Frenetic) -> None:
    Path("mine.py").write_text(
        "import numpy as np\n"
        "from frenetic.search import Origin, Strategy\n"
        "from frenetic.search.strategy import Ledger, SearchEnded\n"
        "class Mine(Strategy):\n"
        "    def __init__(self): self.ledger = Ledger()\n"
        "    def ask(self):\n"
        "        if self.ledger.issued == 2: raise SearchEnded('done')\n"
        "        sharp = 0.01 if self.ledger.issued else 0.0\n"
        "        return self.ledger.issue(np.array([0, sharp, sharp, 0]), 16.0, Origin('x'))\n"
        "    def tell(self, evaluation): self.ledger.settle(evaluation)\n"
    )
    run = ("run", "--strategy", "mine.py:Mine", "--roads", "rural-80", "--workers", "1")
    assert frenetic(*run, "--out", "mine", "--json").code == 0
    with CampaignStore.open(Path("mine")) as store:
        valid, broken = store.tests()
    assert valid.outcome == "PASS"
    assert broken.reason.startswith("A radius of 100 m at 16 m: rural-80 needs at least 240 m")
