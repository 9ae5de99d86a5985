"""`frenetic minimise` as a user meets it: what it prints and writes, and with which exit code."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic.again.minimise import Minimised, minimise_test
from frenetic.analysis.failures import representative_failures
from frenetic.campaign import Budget, Campaign, CampaignStore, Event
from frenetic.outcome import Outcome
from frenetic.road import Road, check_validity
from frenetic.search import RandomSearch
from frenetic.testing import DummyDriver, DummySimulator

if TYPE_CHECKING:
    from command_line import Answer, Frenetic


pytest_plugins = ["command_line"]

# One that the default driver leaves to the right; the next one it follows to its end.
FAILING = [0.0, 0.01, 0.0, 0.0, 0.01, 0.012, -0.03, -0.036, -0.05, 0.0, 0.0, 0.0, 0.02, 0.02]
# One that it no longer leaves with all curvatures 2 % smaller or larger.
EDGE = [
    *(0.043, 0.009, 0.037, 0.035, 0.028, -0.02, -0.054, -0.05, -0.009, -0.028, -0.01, -0.003),
    *(0.007, -0.015, -0.016, -0.02, 0.029, 0.007, -0.005, -0.017, -0.035, 0.002, -0.019, 0.025),
    *(0.022, -0.022, 0.013, 0.05),
]
STRAIGHT = [0.0] * 12


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


def failing_file(name: str = "bend.json") -> str:
    Path(name).write_text(json.dumps({"curvatures": FAILING}), encoding="utf-8")
    return name


def refused(answer: Answer, *words: str) -> None:
    """A mistake: exit code 2, one line on stderr that says what is wrong, no traceback."""
    assert answer.code == 2
    lines = [line for line in answer.err.splitlines() if line.startswith("frenetic: ")]
    assert len(lines) == 1
    assert "Traceback" not in answer.err
    for word in words:
        assert word in lines[0]


# Of a campaign


def test_most_severe_failure_of_a_campaign(frenetic: Frenetic, campaign: None) -> None:
    answer = frenetic("minimise", "c", "--json")
    assert answer.code == 0
    (item,) = answer.json
    with CampaignStore.open(Path("c")) as store:
        (worst,) = store.tests(Outcome.FAIL, order_by="moobd", limit=1)
    assert item["test"] == worst.candidate.id
    assert worst.departure is not None
    assert item["reason"] == f"left the lane to the {worst.departure.side}"
    assert frenetic("minimise", "c", str(item["test"]), "--json").json == [item]
    assert Path(item["road"]) == Path("c", "minimised", f"test-{item['test']:05d}.json")
    assert item["length"] < item["length_before"]
    assert item["ending"] == "minimal"
    assert item["drives"] >= item["improvements"][-1]["drives"]
    for key in ("picture", "comparison"):
        assert Path(item[key]).is_file()
    assert not list(Path("c/minimised").glob("*.part"))


def test_printed_line_repeats_the_failure(frenetic: Frenetic, campaign: None) -> None:
    (item,) = frenetic("minimise", "c", "--max-drives", "40", "--json").json
    command = shlex.split(item["repeat"])
    assert command == ["frenetic", "drive", item["road"]]
    again = frenetic(*command[1:], "--json").json
    stored = json.loads(Path(item["road"]).read_text(encoding="utf-8"))
    assert again["outcome"] == "FAIL"
    assert again["reason"] == stored["description"]
    assert again["moobd"] == stored["moobd"]
    assert again["findings"] == [stored["departure"]]


def test_road_file_says_what_it_is(frenetic: Frenetic, campaign: None) -> None:
    (item,) = frenetic("minimise", "c", "--max-drives", "40", "--json").json
    document = json.loads(Path(item["road"]).read_text(encoding="utf-8"))
    assert document["id"] == item["test"]
    assert document["test_outcome"] == Outcome.FAIL
    assert document["origin"] == {"operator": "minimise", "parents": [item["test"]]}
    assert document["minimised"]["reason"] == item["reason"]
    assert document["minimised"]["drives"] == item["drives"]
    assert document["rules"]["oob_tolerance"] == 0.95
    assert document["driver"]["class"].endswith(":Noisy")
    assert check_validity(document["road_points"], 210.0).valid
    road = Road(document["curvatures"], document["step"])
    assert road.length == item["length"]


def test_several_failures_in_a_table(frenetic: Frenetic, campaign: None) -> None:
    answer = frenetic("minimise", "c", "--top", "2", "--max-drives", "30")
    assert answer.code == 0
    assert "2 failures come down to" in answer.out
    assert "left the lane to the" in answer.out
    assert len(list(Path("c/minimised").glob("*.json"))) == 2
    items = frenetic("minimise", "c", "--top", "2", "--max-drives", "30", "--json").json
    assert len(items) == 2
    assert all(item["drives"] <= 30 for item in items)


def test_other_driver_than_the_campaigns(frenetic: Frenetic, campaign: None) -> None:
    (item,) = frenetic(
        "minimise",
        "c",
        "--driver",
        "aggression=1.3",
        "--with",
        "noise=0.1",
        "--max-drives",
        "20",
        "--json",
    ).json
    assert frenetic(*shlex.split(item["repeat"])[1:], "--json").json["outcome"] == "FAIL"
    assert Path(item["road"]).name == f"test-{item['test']:05d}-other.json"
    assert not Path("c", "minimised", f"test-{item['test']:05d}.json").exists()


def test_a_failure_that_is_not_the_recorded_one_is_said_to_be_another(
    frenetic: Frenetic, campaign: None
) -> None:
    (own,) = frenetic("minimise", "c", "--max-drives", "1", "--json").json
    assert (own["match"], own["difference"]) == ("same failure", 0.0)
    options = ("minimise", "c", "--simulator", "friction=0.7", "--max-drives", "1")
    answer = frenetic(*options)
    assert "is a different failure than recorded (" in answer.err
    assert "not the one recorded: " in answer.out
    (item,) = frenetic(*options, "--json").json
    assert item["match"] in ("elsewhere", "other side", "other mechanism")
    document = json.loads(Path(item["road"]).read_text(encoding="utf-8"))
    assert document["minimised"]["match"] == item["match"]


def test_the_same_command_shows_what_is_there_and_another_guard_drives_anew(
    frenetic: Frenetic, campaign: None
) -> None:
    (best,) = frenetic("minimise", "c", "--json").json
    number = str(best["test"])
    for drives in ("500", "1"):  # it is there already
        assert frenetic("minimise", "c", number, "--max-drives", drives, "--json").json == [best]
    assert len(list(Path("c/again").iterdir())) == 1
    (other,) = frenetic("minimise", "c", number, "--guard", "0.04", "--json").json
    assert other["curvatures"] != best["curvatures"]
    assert len(list(Path("c/again").iterdir())) == 2


# Of a road file


@pytest.mark.usefixtures("drawn")
def test_road_file_is_minimised_beside_it(frenetic: Frenetic) -> None:
    answer = frenetic("minimise", failing_file())
    assert answer.code == 0
    first, *_ = answer.out.splitlines()
    assert first.startswith("bend.json: 130 m -> ")
    assert "nothing smaller was found to fail" in first
    for word in ("cut behind", "curvatures", "repeat     frenetic drive bend.min.json"):
        assert word in answer.out
    for name in ("bend.min.json", "bend.min.png", "bend.min-before-after.png"):
        assert Path(name).stat().st_size > 500
    assert frenetic("drive", "bend.min.json", "--json").json["outcome"] == "FAIL"
    assert json.loads(Path("bend.json").read_text()) == {"curvatures": FAILING}  # as it was


def test_a_road_that_fails_only_as_it_is_says_so(frenetic: Frenetic) -> None:
    Path("edge.json").write_text(json.dumps({"curvatures": EDGE}), encoding="utf-8")
    answer = frenetic("minimise", "edge.json")
    assert answer.code == 0
    (item,) = frenetic("minimise", "edge.json", "--json").json
    assert item["length"] < 0.7 * item["length_before"]
    assert item["guard"] == 0.0
    assert item["note"] in answer.out.splitlines()
    assert "2 % smaller" in item["note"]
    assert json.loads(Path("edge.min.json").read_text())["minimised"]["guard"] == 0.0


def test_drives_are_bounded(frenetic: Frenetic) -> None:
    answer = frenetic("minimise", failing_file(), "--max-drives", "5", "--out", "least.json")
    assert answer.code == 0
    assert "5 drives, all drives are spent" in answer.out
    assert Path("least.json").is_file()


def test_ctrl_c_keeps_the_smallest_road(frenetic: Frenetic) -> None:
    # A driver that presses it, during the drives on its twelfth road.
    Path("pressing.py").write_text(
        "import os, signal\n"
        "from frenetic import Planner\n"
        "class Pressing:\n"
        "    roads = 0\n"
        "    def __init__(self):\n"
        "        self.planner = Planner()\n"
        "    def reset(self, setup):\n"
        "        self.planner.reset(setup)\n"
        "        self.roads += 1\n"
        "        if self.roads == 12:\n"
        f"            os.kill({os.getpid()}, signal.SIGINT)\n"
        "    def act(self, observation):\n"
        "        return self.planner.act(observation)\n",
        encoding="utf-8",
    )
    before = signal.getsignal(signal.SIGINT)
    answer = frenetic("minimise", failing_file(), "--driver", "pressing.py:Pressing", "--json")
    assert signal.getsignal(signal.SIGINT) is before
    assert answer.code == 130
    (item,) = answer.json
    assert item["ending"] == "stopped"
    assert item["drives"] == 12
    assert item["length"] < 130.0
    assert frenetic("drive", item["road"], "--json").json["outcome"] == "FAIL"


def test_ctrl_c_says_which_failures_are_not_begun(
    frenetic: Frenetic, campaign: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pressing(*arguments: Any, on_event: Callable[[Event], None], **options: Any) -> Minimised:
        def on_result(event: Event) -> None:
            on_event(event)
            if event.kind == "result":
                os.kill(os.getpid(), signal.SIGINT)

        return minimise_test(*arguments, on_event=on_result, **options)

    monkeypatch.setattr("frenetic.again.minimise.minimise_test", pressing)
    with CampaignStore.open(Path("c")) as store:
        *_, last = representative_failures(store, 2)
    answer = frenetic("minimise", "c", "--top", "2")
    assert answer.code == 130
    assert f"Interrupted: 1 failure not begun: {last.candidate.id}" in answer.err
    assert "1 failure comes down to 1 different road\n" in answer.out


# Mistakes


def test_only_failing_roads_can_be_minimised(frenetic: Frenetic) -> None:
    Path("straight.json").write_text(json.dumps({"curvatures": STRAIGHT}), encoding="utf-8")
    refused(frenetic("minimise", "straight.json"), "only a road that fails", "PASS")
    assert not list(Path().glob("*.min*"))


def test_tests_that_did_not_fail_are_refused(frenetic: Frenetic, campaign: None) -> None:
    failed = {int(path.stem[5:]) for path in Path("c/failures").glob("test-*.json")}
    passed = next(number for number in range(1, 99) if number not in failed)
    refused(frenetic("minimise", "c", str(passed)), f"test {passed} is", "only a failing road")
    refused(frenetic("minimise", "c", "99999"), "99999")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.json"], ["no file nowhere.json"]),
        (["bend.json", "3"], ["bend.json is no folder", "a campaign"]),
        (["bend.json", "--top", "3"], ["bend.json is no folder"]),
        (["bend.json", "--out", "bend.json"], ["bend.json is the road itself"]),
        (["bend.json", "--max-drives", "0"], ["--max-drives"]),
        (["bend.json", "--guard", "1"], ["--guard"]),
        (["bend.json", "--guard", "nan"], ["guard is nan"]),
        (["bend.json", "--driver", "plannr"], ["unknown driver 'plannr'"]),
        (["bend.json", "--map-size", "5"], ["--map-size is 5"]),
        (["bend.json", "--oob-tolerance", "7"], ["oob_tolerance is 7"]),
        (["."], ["holds no campaign"]),
    ],
)
def test_mistakes_are_one_line(frenetic: Frenetic, arguments: list[str], words: list[str]) -> None:
    failing_file()
    refused(frenetic("minimise", *arguments), *words)


def test_options_that_exclude_each_other(frenetic: Frenetic, campaign: None) -> None:
    refused(frenetic("minimise", "c", "1", "--top", "2"), "--top", "exclude each other")
    refused(frenetic("minimise", "c", "1", "2", "--out", "x.json"), "--out is for one road")
    refused(frenetic("minimise", "c", "--map-size", "300"), "--map-size is for a ROAD file")


def test_place_that_cannot_be_written_is_found_out_before_driving(frenetic: Frenetic) -> None:
    Path("file").write_text("in the way", encoding="utf-8")
    refused(
        frenetic("minimise", failing_file(), "--out", "file/road.json"),
        "cannot be made",
        "--out",
    )
    Path("folder").mkdir()
    Path("name.png").mkdir()
    for out in ("folder", "name.json"):
        answer = frenetic("minimise", "bend.json", "--out", out)
        refused(answer, "cannot be written: Is a directory; choose another place with --out")
    assert sorted(path.name for path in Path().iterdir()) == [
        "bend.json",
        "file",
        "folder",
        "name.png",
    ]


def test_campaign_without_a_failure(frenetic: Frenetic) -> None:
    frenetic("run", "--simulations", "1", "--seed", "3", "--out", "none", "--workers", "1")
    refused(frenetic("minimise", "none"), "holds no failing road")


def test_campaign_from_python_needs_its_parts(frenetic: Frenetic) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=DummySimulator(lambda road: 4.0),
        driver=DummyDriver(),
        budget=Budget(simulations=2),
        folder="python",
    ).run()
    refused(frenetic("minimise", "python"), "started from Python")
