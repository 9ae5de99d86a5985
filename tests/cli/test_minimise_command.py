"""`frenetic minimise`: its output, its files and its exit codes."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.analysis.clusters import representative_failures
from frenetic.campaign import CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road, check_validity

if TYPE_CHECKING:
    from command_line import Frenetic


pytest_plugins = ["command_line"]

# The default driver leaves this road to the right.
FAILING = [0.0, 0.01, 0.0, 0.0, 0.01, 0.012, -0.03, -0.036, -0.05, 0.0, 0.0, 0.0, 0.02, 0.02]
# The default driver leaves this road, but not with all curvatures 2 % smaller or larger.
EDGE = [
    *(0.043, 0.009, 0.037, 0.035, 0.028, -0.02, -0.054, -0.05, -0.009, -0.028, -0.01, -0.003),
    *(0.007, -0.015, -0.016, -0.02, 0.029, 0.007, -0.005, -0.017, -0.035, 0.002, -0.019, 0.025),
    *(0.022, -0.022, 0.013, 0.05),
]


@pytest.fixture(scope="module")
def noisy_campaign(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    """A campaign whose driver and map are not the default ones."""
    folder = tmp_path_factory.mktemp("made") / "c"
    options = ["--driver", "aggression=1.1", "--with", "noise=0.03", "--map-size", "210"]
    budget = ["--failures", "4", "--seed", "1", "--workers", "1"]
    prepare("run", *budget, *options, "--out", str(folder))
    return folder


@pytest.fixture
def campaign(frenetic: Frenetic, noisy_campaign: Path) -> None:
    """A copy of that campaign in the folder c."""
    shutil.copytree(noisy_campaign, "c")


def road_file(name: str, curvatures: list[float] = FAILING) -> str:
    Path(name).write_text(json.dumps({"curvatures": curvatures}), encoding="utf-8")
    return name


@pytest.mark.usefixtures("campaign")
def test_a_failure_of_a_campaign_is_minimised_once(frenetic: Frenetic) -> None:
    (item,) = frenetic("minimise", "c", "--json").json
    road = Path("c", "minimised", f"test-{item['test']:05d}.json")
    assert (item["road"], item["ending"], item["match"]) == (str(road), "minimal", "same failure")
    assert item["length"] < item["length_before"]
    stored = json.loads(road.read_text(encoding="utf-8"))
    assert (stored["id"], stored["test_outcome"]) == (item["test"], Outcome.FAIL)
    assert stored["origin"] == {"operator": "minimise", "parents": [item["test"]]}
    assert stored["driver"]["class"].endswith(":Planner")
    assert stored["driven"]["with"].keys() == {"noise"}
    assert check_validity(stored["road_points"], 210.0).valid
    assert Road(stored["curvatures"], stored["step"]).length == item["length"]
    driven = frenetic("drive", item["road"], "--json").json
    assert (driven["outcome"], driven["reason"]) == ("FAIL", stored["description"])
    assert (driven["moobd"], driven["findings"]) == (stored["moobd"], [stored["departure"]])
    command = ("minimise", "c", str(item["test"]))
    repeated = frenetic(*command, "--max-drives", "1", "--json").json
    assert repeated == [item | {"new_drives": 0}], "the stored drives suffice"
    assert f", 0 drives now, {item['drives']} before, " in frenetic(*command).out
    assert len(list(Path("c/rerun").iterdir())) == 2, "trials of the causes, and the minimised road"


@pytest.mark.usefixtures("campaign")
def test_minimise_with_another_simulator_says_which_failures_are_others(frenetic: Frenetic) -> None:
    icy = ("minimise", "c", "--top", "2", "--simulator", "friction=0.7", "--max-drives", "1")
    text = frenetic(*icy).out
    assert text.count(" 1 drive, all drives are spent\n") == 2
    items = frenetic(*icy, "--json").json
    others = [item for item in items if item["match"] not in ("same failure", "same place")]
    assert others
    assert text.count("it is not the failure that the campaign recorded: ") == len(others)
    assert [Path(item["road"]).name for item in items] == [
        f"test-{item['test']:05d}-other.json" for item in items
    ]
    assert frenetic("drive", items[0]["road"], "--json").json["outcome"] == "FAIL"


# Road files


@pytest.mark.usefixtures("drawn")
def test_the_minimised_road_is_written_beside_its_road_file(frenetic: Frenetic) -> None:
    answer = frenetic("minimise", road_file("bend.json"))
    assert answer.code == 0
    assert answer.out.startswith("bend.json: 130 m -> ")
    assert "nothing smaller was found to fail\n" in answer.out
    (repeat,) = re.findall("repeat +frenetic (.*)", answer.out)
    for name in ("bend.min.json", "bend.min.png", "bend.min-before-after.png"):
        assert Path(name).stat().st_size > 500
    assert frenetic(*repeat.split(), "--json").json["outcome"] == "FAIL"
    assert json.loads(Path("bend.json").read_text()) == {"curvatures": FAILING}
    edge = ("minimise", road_file("edge.json", EDGE), "--max-drives", "5", "--out", "least.json")
    assert "a slight change makes it pass" in frenetic(*edge).out
    assert "a slight change" not in answer.out


def test_ctrl_c_keeps_the_smallest_road(
    frenetic: Frenetic, stopping_driver: Callable[[int], str]
) -> None:
    driver = ("--driver", stopping_driver(12), "--json")
    answer = frenetic("minimise", road_file("bend.json"), *driver)
    assert answer.code == 130
    (item,) = answer.json
    begin = "the drives on a ROAD file are not kept; begin again: frenetic minimise bend.json"
    assert f"Interrupted: {begin} --driver stopping.py:Stopping --json\n" in answer.err
    assert (item["ending"], item["drives"], item["new_drives"]) == ("stopped", 12, 12)
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
