"""`frenetic minimise` as a user meets it: what it prints and writes, and with which exit code."""

from __future__ import annotations

import json
import shlex
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.analysis.failures import representative_failures
from frenetic.campaign import CampaignStore
from frenetic.outcome import Outcome
from frenetic.road import Road, check_validity

if TYPE_CHECKING:
    from command_line import Frenetic


pytest_plugins = ["command_line"]

# One that the default driver leaves to the right.
FAILING = [0.0, 0.01, 0.0, 0.0, 0.01, 0.012, -0.03, -0.036, -0.05, 0.0, 0.0, 0.0, 0.02, 0.02]
# One that it no longer leaves with all curvatures 2 % smaller or larger.
EDGE = [
    *(0.043, 0.009, 0.037, 0.035, 0.028, -0.02, -0.054, -0.05, -0.009, -0.028, -0.01, -0.003),
    *(0.007, -0.015, -0.016, -0.02, 0.029, 0.007, -0.005, -0.017, -0.035, 0.002, -0.019, 0.025),
    *(0.022, -0.022, 0.013, 0.05),
]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign whose driver and map are not the default ones."""
    folder = tmp_path_factory.mktemp("made") / "c"
    options = ["--driver", "aggression=1.1", "--with", "noise=0.03", "--map-size", "210"]
    budget = ["--failures", "4", "--seed", "1", "--workers", "1"]
    prepare("run", *budget, *options, "--out", str(folder))
    return folder


@pytest.fixture
def campaign(frenetic: Frenetic, made: Path) -> None:
    """That campaign in the folder c."""
    shutil.copytree(made, "c")


def road_file(name: str, curvatures: list[float] = FAILING) -> str:
    Path(name).write_text(json.dumps({"curvatures": curvatures}), encoding="utf-8")
    return name


# Of a campaign


@pytest.mark.usefixtures("campaign")
def test_the_most_severe_failure_of_a_campaign(frenetic: Frenetic) -> None:
    (item,) = frenetic("minimise", "c", "--json").json
    with CampaignStore.open(Path("c")) as store:
        (worst,) = store.tests(Outcome.FAIL, order_by="moobd", limit=1)
    assert item["test"] == worst.candidate.id
    assert worst.departure is not None
    assert item["reason"] == f"left the lane to the {worst.departure.side}"
    assert Path(item["road"]) == Path("c", "minimised", f"test-{item['test']:05d}.json")
    assert item["length"] < item["length_before"]
    assert (item["ending"], item["match"]) == ("minimal", "same failure")
    assert item["drives"] >= item["improvements"][-1]["drives"]
    assert Path(item["picture"]).is_file()
    assert Path(item["comparison"]).is_file()
    assert not list(Path("c/minimised").glob("*.part"))

    stored = json.loads(Path(item["road"]).read_text(encoding="utf-8"))
    assert (stored["id"], stored["test_outcome"]) == (item["test"], Outcome.FAIL)
    assert stored["origin"] == {"operator": "minimise", "parents": [item["test"]]}
    for key in ("reason", "drives", "guard"):
        assert stored["minimised"][key] == item[key]
    assert stored["rules"]["oob_tolerance"] == 0.95
    assert stored["driver"]["class"].endswith(":Noisy")
    assert check_validity(stored["road_points"], 210.0).valid
    assert Road(stored["curvatures"], stored["step"]).length == item["length"]

    command = shlex.split(item["repeat"])
    assert command == ["frenetic", "drive", item["road"]]
    again = frenetic(*command[1:], "--json").json
    assert (again["outcome"], again["reason"]) == ("FAIL", stored["description"])
    assert (again["moobd"], again["findings"]) == (stored["moobd"], [stored["departure"]])

    one = ("minimise", "c", str(item["test"]))
    for how in ((), ("--max-drives", "1")):  # it is there already
        assert frenetic(*one, *how, "--json").json == [item]
    assert len(list(Path("c/again").iterdir())) == 1
    (other,) = frenetic(*one, "--guard", "0.04", "--json").json
    assert other["curvatures"] != item["curvatures"]
    assert len(list(Path("c/again").iterdir())) == 2


@pytest.mark.usefixtures("campaign")
def test_several_failures_in_a_table(frenetic: Frenetic) -> None:
    shutil.rmtree("c/again")
    two = ("minimise", "c", "--top", "2", "--max-drives", "30")
    answer = frenetic(*two)
    assert answer.code == 0
    assert "2 failures come down to" in answer.out
    assert "left the lane to the" in answer.out
    items = frenetic(*two, "--json").json
    assert [item["drives"] <= 30 for item in items] == [True, True]
    roads = {item["road"] for item in items}
    assert roads <= {str(path) for path in Path("c/minimised").glob("*.json")}


@pytest.mark.usefixtures("campaign")
def test_with_other_parts_than_the_campaigns(frenetic: Frenetic) -> None:
    other = ("--driver", "aggression=1.3", "--with", "noise=0.1", "--max-drives", "20")
    (item,) = frenetic("minimise", "c", *other, "--json").json
    assert frenetic(*shlex.split(item["repeat"])[1:], "--json").json["outcome"] == "FAIL"
    assert Path(item["road"]).name == f"test-{item['test']:05d}-other.json"
    icy = ("minimise", "c", "--simulator", "friction=0.7", "--max-drives", "1")
    answer = frenetic(*icy)
    assert "is a different failure than recorded (" in answer.err
    assert "not the one recorded: " in answer.out
    (item,) = frenetic(*icy, "--json").json
    assert item["match"] in ("elsewhere", "other side", "other mechanism")
    document = json.loads(Path(item["road"]).read_text(encoding="utf-8"))
    assert document["minimised"]["match"] == item["match"]


# Of a road file


@pytest.mark.usefixtures("drawn")
def test_road_file_is_minimised_beside_it(frenetic: Frenetic) -> None:
    answer = frenetic("minimise", road_file("bend.json"))
    assert answer.code == 0
    first, *_ = answer.out.splitlines()
    assert first.startswith("bend.json: 130 m -> ")
    assert "nothing smaller was found to fail" in first
    for word in ("curvatures", "repeat     frenetic drive bend.min.json"):
        assert word in answer.out
    for name in ("bend.min.json", "bend.min.png", "bend.min-before-after.png"):
        assert Path(name).stat().st_size > 500
    assert frenetic("drive", "bend.min.json", "--json").json["outcome"] == "FAIL"
    assert json.loads(Path("bend.json").read_text()) == {"curvatures": FAILING}  # as it was


def test_a_road_whose_neighbours_pass_says_so(frenetic: Frenetic) -> None:
    edge = ("minimise", road_file("edge.json", EDGE), "--max-drives", "5", "--out", "least.json")
    answer, (item,) = frenetic(*edge), frenetic(*edge, "--json").json
    assert "5 drives, all drives are spent" in answer.out
    assert (item["road"], item["guard"]) == ("least.json", 0.0)
    assert "2 % smaller" in item["note"]
    assert item["note"] in answer.out.splitlines()


def test_ctrl_c_keeps_the_smallest_road(
    frenetic: Frenetic, stopping_driver: Callable[[int], str]
) -> None:
    before = signal.getsignal(signal.SIGINT)
    driver = ("--driver", stopping_driver(12), "--json")
    answer = frenetic("minimise", road_file("bend.json"), *driver)
    assert signal.getsignal(signal.SIGINT) is before
    assert answer.code == 130
    (item,) = answer.json
    assert (item["ending"], item["drives"]) == ("stopped", 12)
    assert item["length"] < 130.0
    assert frenetic("drive", item["road"], "--json").json["outcome"] == "FAIL"


@pytest.mark.usefixtures("campaign")
def test_ctrl_c_says_which_failures_are_not_begun(
    frenetic: Frenetic, stopping_driver: Callable[[int], str]
) -> None:
    with CampaignStore.open(Path("c")) as store:
        *_, last = representative_failures(store, 2)
    driver = ("--driver", f"{stopping_driver(3)},aggression=1.1")
    answer = frenetic("minimise", "c", "--top", "2", *driver)
    assert answer.code == 130
    assert f"Interrupted: 1 failure not begun: {last.candidate.id}" in answer.err
    assert "1 failure comes down to 1 different road\n" in answer.out
