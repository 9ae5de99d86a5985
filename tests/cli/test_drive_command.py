"""`frenetic drive` of a road or of a campaign's test: its driver, its result, its limits."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

BENT = {"curvatures": [0.0, 0.02, 0.05, 0.06, 0.02, -0.03, -0.06, -0.06, -0.02, 0.0, 0.03]}
LOOP = {"curvatures": [0.07] * 14}
BOLD_DRIVER = """
from frenetic import Planner

class Bold(Planner):
    def __init__(self, extra=0.0):
        super().__init__(aggression=1.2 + extra)
"""
MOODY_DRIVER = """
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


def test_drive_prints_outcome_reason_and_moobd(frenetic: Frenetic, bent: str) -> None:
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


def test_drive_writes_a_trace_in_its_conditions(frenetic: Frenetic, bent: str) -> None:
    answer = frenetic("drive", bent, "--trace", "run.csv", "--with", "delay=0.05", "--json").json
    assert answer["trace"] == "run.csv"
    table = np.genfromtxt("run.csv", delimiter=",", names=True)
    assert table["oob_distance_m"].min() == pytest.approx(answer["moobd"], rel=1e-8)
    assert table["time_s"][-1] == pytest.approx(answer["duration"])
    assert set(table["condition_delay_s"]) == {0.05}
    printed = frenetic("drive", bent, "--trace", "run.mcap", "--layouts")
    assert "\ntrace " in printed.out
    assert {path.name for path in Path().iterdir()} == {
        *("foxglove-layout.json", "plotjuggler-layout.xml"),
        *("road.json", "run.csv", "run.events.csv", "run.mcap"),
    }


def test_a_road_that_is_not_driven_has_no_trace(frenetic: Frenetic) -> None:
    Path("loop.json").write_text(json.dumps(LOOP))
    answer = frenetic("drive", "loop.json", "--trace", "run.csv", "--json")
    assert answer.code == 1
    assert "trace" not in answer.json
    assert not Path("run.csv").exists()


def test_an_invalid_road_is_not_driven(frenetic: Frenetic, bent: str) -> None:
    Path("loop.json").write_text(json.dumps(LOOP))
    reason = "The road is self-intersecting"
    answer = frenetic("drive", "loop.json", "--json").json
    assert (answer["outcome"], answer["reason"]) == ("INVALID", reason)
    dry = frenetic("drive", bent, "--dry")
    assert (dry.code, dry.out) == (0, "road.json: valid\n")
    dry = frenetic("drive", "loop.json", "--dry")
    assert (dry.code, dry.out) == (1, f"loop.json: INVALID  {reason}\n")
    document = {"road": "loop.json", "valid": False, "message": reason}
    assert frenetic("drive", "loop.json", "--dry", "--json").json == document


def test_a_hilly_road_is_invalid_where_simulator_or_driver_need_flat_roads(
    frenetic: Frenetic, bent: str
) -> None:
    Path("hill.json").write_text(json.dumps(BENT | {"grade": [[0, 0.08], [100, -0.08]]}))
    assert frenetic("drive", "hill.json", "--json").json["outcome"] == "PASS"
    Path("sledge.py").write_text(
        "import frenetic\n\nclass Sledge(frenetic.SteppedSimulator):\n    pass\n"
    )
    for part, refusal in (
        ("--simulator=sledge.py:Sledge", "Sledge drives"),
        ("--driver=marking-follower", "A camera sees"),
    ):
        reason = f"INVALID  {refusal} flat roads of one width only: leave superelevation, grade and"
        for options in ((), ("--dry",)):
            answer = frenetic("drive", "hill.json", part, *options)
            assert answer.code == 1
            assert reason in answer.out.splitlines()[0]
    assert frenetic("drive", "hill.json", "--dry").out == "hill.json: valid\n"
    assert frenetic("drive", bent, part, "--dry").code == 0


@pytest.fixture(scope="session")
def bold_campaign(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """The folder of a campaign with one failing road, of a user's own driver."""
    folder = tmp_path_factory.mktemp("bold")
    budget = ("--failures", "1", "--seed", "1", "--workers", "1", "--out", "c")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("mine.py").write_text(BOLD_DRIVER, encoding="utf-8")
        prepare("run", *budget, *PARTS, *TERMS)
    return folder


@pytest.fixture
def failing_road(bold_campaign: Path, tmp_path: Path, frenetic: Frenetic) -> Path:
    """The file of the failing road, in a copy of the campaign in the folder of the command line."""
    shutil.copytree(bold_campaign, tmp_path, dirs_exist_ok=True)
    (file,) = Path("c/failures").glob("test-*.json")
    return file


def with_other_record(failing_road: Path, **entries: Any) -> str:
    """Write a copy of the file with other entries in `driven`; return its name."""
    document = json.loads(failing_road.read_text(encoding="utf-8"))
    document["driven"] |= entries
    Path("changed.json").write_text(json.dumps(document), encoding="utf-8")
    return "changed.json"


def test_no_road_file_says_which_program_is_started(frenetic: Frenetic, failing_road: Path) -> None:
    there = f"beamng,home={Path.cwd()},host=203.0.113.1,port=1"
    answer = frenetic("drive", with_other_record(failing_road, simulator=there))
    assert answer.code == 2
    assert str(Path.cwd()) not in answer.err
    assert "203.0.113.1" not in answer.err


def test_a_failing_road_is_driven_as_the_campaign_drove_it(
    frenetic: Frenetic, failing_road: Path
) -> None:
    document = json.loads(failing_road.read_text(encoding="utf-8"))
    result = frenetic("drive", str(failing_road), "--json").json
    assert (result["moobd"], result["findings"]) == (document["moobd"], [document["departure"]])
    assert result["outcome"] == "FAIL"
    assert result["driver"] == document["driver"]
    shown = frenetic("drive", str(failing_road)).out
    assert "driver     mine.py:Bold,extra=0.1 in embedded" in shown
    assert "conditions delay 0.02 s" in shown
    options = ("--max-drives", "3", "--out", "least.json", "--json")
    frenetic("minimise", str(failing_road), *options)
    minimised = json.loads(Path("least.json").read_text(encoding="utf-8"))
    assert minimised["driver"]["class"] == "mine.py:Bold"
    assert frenetic("drive", "least.json", "--json").json["moobd"] == minimised["moobd"]


def test_a_campaigns_test_is_driven_like_its_file(frenetic: Frenetic, failing_road: Path) -> None:
    number = str(int(failing_road.stem.removeprefix("test-")))
    by_number, by_file = (
        frenetic("drive", *words, "--json").json for words in (("c", number), (str(failing_road),))
    )
    assert (by_number.pop("road"), by_number.pop("differs")) == (f"c {number}", "")
    del by_file["road"]
    assert by_number == by_file
    assert frenetic("drive", "c", number, "--dry").out == f"c {number}: valid\n"
    with_options = frenetic(
        "drive", "c", number, "--driver", "planner", "--criteria", "speed_limit=20"
    ).out
    assert with_options.startswith("PASS")


def test_drive_says_whether_a_test_ends_as_in_its_campaign(
    frenetic: Frenetic, failing_road: Path
) -> None:
    number = str(int(failing_road.stem.removeprefix("test-")))
    repeated = frenetic("drive", "c", number)
    assert repeated.code == 0
    assert " as in the campaign\n" in repeated.out
    assert "result " not in frenetic("drive", str(failing_road)).out, "a file holds no drive"
    Path("moody.py").write_text(MOODY_DRIVER.format(mood=str(Path("mood").resolve())))
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
def test_a_drive_with_other_parts_is_not_compared_with_the_campaign(
    frenetic: Frenetic, failing_road: Path, other: tuple[str, str]
) -> None:
    number = str(int(failing_road.stem.removeprefix("test-")))
    assert "differs" not in frenetic("drive", "c", number, *other, "--json").json
    assert "the campaign" not in frenetic("drive", "c", number, *other).out


def test_a_driver_that_raises_in_reset_fails_the_test(
    frenetic: Frenetic, failing_road: Path
) -> None:
    methods = "    def reset(self, setup):\n        1 / 0\n    def act(self, seen):\n        pass\n"
    Path("broken.py").write_text(f"class Broken:\n{methods}")
    number = str(int(failing_road.stem.removeprefix("test-")))
    answer = frenetic("drive", "c", number, "--driver", "broken.py:Broken")
    assert answer.out.startswith("FAIL  the driver raised ZeroDivisionError")
    assert "the campaign" not in answer.out
    # A campaign of this driver holds nothing to start from.
    search = ("run", "--driver", "broken.py:Broken", "--simulations", "12", "--workers", "1")
    crashed = frenetic(*search, "--out", "broken")
    assert (
        "mend it, then start it anew, with the same seed: frenetic run broken/campaign.toml"
        in crashed.err
    )


def test_a_test_of_a_rerun_is_driven_in_the_conditions_of_that_test(
    frenetic: Frenetic, failing_road: Path
) -> None:
    rerun = frenetic("rerun", "c", "--vary", "friction=0.2:0.4", "--times", "2", "--json").json
    folder = rerun["folder"]
    tests = frenetic("show", folder, "--limit", "9", "--json").json["listed"]
    ids = [str(test["id"]) for test in tests]
    parts = (*PARTS, *TERMS[:2], "--simulator", "embedded")  # a rerun's record has no names
    answer = frenetic("drive", folder, *ids, *parts, "--json")
    assert not answer.err
    assert [drive["moobd"] for drive in answer.json] == [test["moobd"] for test in tests]
