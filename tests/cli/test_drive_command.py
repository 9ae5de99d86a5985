"""`frenetic drive` of a road or a campaign's test: who drives, and what no file makes it load."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

BENT = {"curvatures": [0.0, 0.02, 0.05, 0.06, 0.02, -0.03, -0.06, -0.06, -0.02, 0.0, 0.03]}
LOOP = {"curvatures": [0.07] * 14}
MINE = """
from frenetic import Planner

class Bold(Planner):
    def __init__(self, extra=0.0):
        super().__init__(aggression=1.2 + extra)
"""
MOODY = """
from pathlib import Path

from frenetic import Planner

class Moody:
    def reset(self, setup):
        self.mind = Planner(aggression=float(Path({mood!r}).read_text()))
        self.mind.reset(setup)

    def act(self, observation):
        return self.mind.act(observation)
"""
PARTS = ("--driver", "mine.py:Bold,extra=0.1")
TERMS = ("--with", "delay=0.02", "--criteria", "speed_limit=75", "--map-size", "210")


@pytest.fixture
def bent(frenetic: Frenetic) -> str:
    """A road that the default driver follows to its end."""
    Path("road.json").write_text(json.dumps(BENT))
    return "road.json"


def test_drive_says_what_happened(frenetic: Frenetic, bent: str) -> None:
    answer = frenetic("drive", bent)
    assert answer.code == 0
    assert answer.out.startswith("PASS  Car reached the end of the road")
    assert "MOOBD" in answer.out
    answer = frenetic("drive", bent, "--driver", "aggression=3")
    assert answer.out.startswith("FAIL  Car drove out of the lane ")
    assert "left lane" in answer.out


@pytest.mark.usefixtures("drawn")
def test_drive_draws_a_picture(frenetic: Frenetic, bent: str) -> None:
    for picture in ("picture.png", "picture.svg"):
        assert frenetic("drive", bent, "--plot", picture, "--json").json["plot"] == picture
        assert Path(picture).stat().st_size > 10_000


def test_an_invalid_road_is_not_driven(frenetic: Frenetic, bent: str) -> None:
    Path("loop.json").write_text(json.dumps(LOOP))
    why = "The road is self-intersecting"
    answer = frenetic("drive", "loop.json", "--json").json
    assert (answer["outcome"], answer["reason"]) == ("INVALID", why)
    dry = frenetic("drive", bent, "--dry")
    assert (dry.code, dry.out) == (0, "road.json: valid\n")
    dry = frenetic("drive", "loop.json", "--dry")
    assert (dry.code, dry.out) == (1, f"loop.json: INVALID  {why}\n")
    said = {"road": "loop.json", "valid": False, "message": why}
    assert frenetic("drive", "loop.json", "--dry", "--json").json == said


def test_a_road_that_leans_or_rises_is_driven_where_it_can_be(
    frenetic: Frenetic, bent: str
) -> None:
    Path("hill.json").write_text(json.dumps(BENT | {"grade": [[0, 0.08], [100, -0.08]]}))
    assert frenetic("drive", "hill.json", "--json").json["outcome"] == "PASS"
    Path("sledge.py").write_text(
        "import frenetic\n\nclass Sledge(frenetic.SteppedSimulator):\n    pass\n"
    )
    for part, who in (
        ("--simulator=sledge.py:Sledge", "Sledge drives"),
        ("--driver=marking-follower", "A camera sees"),
    ):
        why = f"INVALID  {who} flat roads of one width only: leave superelevation, grade and"
        for how in ((), ("--dry",)):
            answer = frenetic("drive", "hill.json", part, *how)
            assert answer.code == 1
            assert why in answer.out.splitlines()[0]
    assert frenetic("drive", "hill.json", "--dry").out == "hill.json: valid\n"
    assert frenetic("drive", bent, part, "--dry").code == 0


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign with a road on which a driver of one's own fails."""
    folder = tmp_path_factory.mktemp("bold")
    budget = ("--failures", "1", "--seed", "1", "--workers", "1", "--out", "c")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("mine.py").write_text(MINE, encoding="utf-8")
        prepare("run", *budget, *PARTS, *TERMS)
    return folder


@pytest.fixture
def road(made: Path, tmp_path: Path, frenetic: Frenetic) -> Path:
    """The file of the road in a copy of it, in the folder of the command line."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    (found,) = Path("c/failures").glob("test-*.json")
    return found


def changed(road: Path, **entries: Any) -> str:
    """The file with other entries of its record."""
    document = json.loads(road.read_text(encoding="utf-8"))
    document["driven"] |= entries
    Path("changed.json").write_text(json.dumps(document), encoding="utf-8")
    return "changed.json"


def test_which_program_is_started_no_file_says(frenetic: Frenetic, road: Path) -> None:
    there = f"beamng,home={Path.cwd()},host=203.0.113.1,port=1"
    answer = frenetic("drive", changed(road, simulator=there))
    assert answer.code == 2
    assert str(Path.cwd()) not in answer.err
    assert "203.0.113.1" not in answer.err


def test_a_failing_road_is_driven_as_the_campaign_drove_it(frenetic: Frenetic, road: Path) -> None:
    document = json.loads(road.read_text(encoding="utf-8"))
    again = frenetic("drive", str(road), "--json").json
    assert (again["moobd"], again["findings"]) == (document["moobd"], [document["departure"]])
    assert again["outcome"] == "FAIL"
    assert again["driver"] == document["driver"]
    shown = frenetic("drive", str(road)).out
    assert "driver     mine.py:Bold,extra=0.1 in embedded" in shown
    assert "conditions delay 0.02 s" in shown
    options = ("--max-drives", "3", "--out", "least.json", "--json")
    frenetic("minimise", str(road), *options)
    least = json.loads(Path("least.json").read_text(encoding="utf-8"))
    assert least["driver"]["class"] == "mine.py:Bold"
    assert frenetic("drive", "least.json", "--json").json["moobd"] == least["moobd"]


def test_a_campaigns_test_is_driven_as_its_file_is(frenetic: Frenetic, road: Path) -> None:
    number = str(int(road.stem.removeprefix("test-")))
    one, by_file = (
        frenetic("drive", *what, "--json").json for what in (("c", number), (str(road),))
    )
    assert (one.pop("road"), one.pop("differs")) == (f"c {number}", "")
    del by_file["road"]
    assert one == by_file
    assert frenetic("drive", "c", number, "--dry").out == f"c {number}: valid\n"
    changed = frenetic(
        "drive", "c", number, "--driver", "planner", "--criteria", "speed_limit=20"
    ).out
    assert changed.startswith("PASS")


def test_it_is_said_whether_a_campaigns_test_ends_as_it_did_there(
    frenetic: Frenetic, road: Path
) -> None:
    number = str(int(road.stem.removeprefix("test-")))
    again = frenetic("drive", "c", number)
    assert again.code == 0
    assert " as in the campaign\n" in again.out
    assert "result " not in frenetic("drive", str(road)).out, "a file holds no drive"
    Path("moody.py").write_text(MOODY.format(mood=str(Path("mood").resolve())))
    Path("mood").write_text("3")
    search = ("run", "--driver", "moody.py:Moody", "--failures", "1", "--seed", "1")
    assert frenetic(*search, "--workers", "1", "--out", "moody").code == 0
    failed = str(frenetic("show", "moody", "--json").json["distinct_failures"][0]["most_severe"])
    Path("mood").write_text("0.3")
    answer = frenetic("drive", "moody", failed)
    assert answer.code == 0, "a driver that differs is no mistake"
    assert " differs from the campaign: PASS, not FAIL\n" in answer.out
    assert frenetic("drive", "moody", failed, "--json").json["differs"] == "PASS, not FAIL"


@pytest.mark.parametrize(
    "other",
    [
        ("--driver", "planner"),
        ("--driver", "mine.py:Bold,extra=0.2"),
        ("--simulator", "friction=0.9999"),
        ("--with", "delay=0.01"),
        ("--with", "friction=0.99"),
        ("--criteria", "speed_limit=74"),
    ],
)
def test_what_is_driven_otherwise_is_compared_with_nothing(
    frenetic: Frenetic, road: Path, other: tuple[str, str]
) -> None:
    number = str(int(road.stem.removeprefix("test-")))
    assert "differs" not in frenetic("drive", "c", number, *other, "--json").json
    assert "the campaign" not in frenetic("drive", "c", number, *other).out


def test_a_driver_that_breaks_before_it_drives_fails(frenetic: Frenetic, road: Path) -> None:
    methods = "    def reset(self, setup):\n        1 / 0\n    def act(self, seen):\n        pass\n"
    Path("broken.py").write_text(f"class Broken:\n{methods}")
    number = str(int(road.stem.removeprefix("test-")))
    answer = frenetic("drive", "c", number, "--driver", "broken.py:Broken")
    assert answer.out.startswith("FAIL  the driver raised ZeroDivisionError")
    assert "the campaign" not in answer.out
    # Its campaign holds nothing to start from.
    search = ("run", "--driver", "broken.py:Broken", "--simulations", "12", "--workers", "1")
    crashed = frenetic(*search, "--out", "broken")
    assert (
        "mend it, then start it anew, with the same seed: frenetic run broken/campaign.toml"
        in crashed.err
    )


def test_a_test_of_a_rerun_is_driven_in_its_own_conditions(frenetic: Frenetic, road: Path) -> None:
    done = frenetic("rerun", "c", "--vary", "friction=0.2:0.4", "--times", "2", "--json").json
    folder = done["folder"]
    tests = frenetic("show", folder, "--limit", "9", "--json").json["listed"]
    ids = [str(test["id"]) for test in tests]
    parts = (*PARTS, *TERMS[:2], "--simulator", "embedded")  # a rerun's record has no names
    answer = frenetic("drive", folder, *ids, *parts, "--json")
    assert not answer.err
    assert [one["moobd"] for one in answer.json] == [test["moobd"] for test in tests]
