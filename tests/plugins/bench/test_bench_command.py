"""The command `frenetic bench`."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.analysis.failure_stability import FailureStability
from frenetic.campaign import CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.oracle.outcome import Outcome

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]
pytestmark = pytest.mark.usefixtures("new_process_server")

WIGGLY = """
import random
from code_pipeline.tests_generation import RoadTestFactory

class Wiggly:
    def __init__(self, executor=None, map_size=None):
        self.executor, self.map_size = executor, map_size

    def start(self):
        print("off we go")
        while not self.executor.is_over():
            xs = range(20, self.map_size - 10, 25)
            points = [(x, self.map_size / 2 + random.uniform(-8, 8)) for x in xs]
            self.executor.execute_test(RoadTestFactory.create_road_test(points))


class Broken(Wiggly):
    def start(self):
        raise RuntimeError("no idea")
"""
SMALL = ("--simulations", "12", "--repeats", "2", "--out", "b")
LEAST = ("--simulations", "3", "--repeats", "1", "--out", "b")


@pytest.fixture
def wiggly(tmp_path: Path) -> str:
    (tmp_path / "wiggly.py").write_text(WIGGLY, encoding="utf-8")
    return "wiggly.py:Wiggly"


@pytest.mark.heavy
def test_a_generator_and_a_strategy_are_compared(frenetic: Frenetic, wiggly: str) -> None:
    answer = frenetic("bench", "--generator", wiggly, "--strategy", "random", *SMALL)
    assert answer.code == 0, answer.err
    assert "Wiggly" in answer.out
    assert "random" in answer.out
    assert "b/index.html" in answer.out
    for name in ("wiggly", "random"):
        for repeat in ("01", "02"):
            folder = Path("b", name, repeat)
            assert check_campaign(folder).findings == ()
    assert Path("b/wiggly/01/generator.log").read_text() == "off we go\n"
    assert Path("b/index.html").is_file()
    listed = frenetic("bench", "--resume", "--out", "b", "--json")
    assert [(run["generator"], run["run"], run["seed"]) for run in listed.json["runs"]] == [
        ("Wiggly", 1, 1),
        ("random", 1, 1),
        ("Wiggly", 2, 2),
        ("random", 2, 2),
    ]
    assert {run["ending"]["end"] for run in listed.json["runs"]} == {"over"}


def test_a_single_generator_is_measured(frenetic: Frenetic, wiggly: str) -> None:
    answer = frenetic("bench", "--generator", f'{wiggly},name="[/x] mine"', *LEAST)
    assert answer.code == 0, answer.err
    assert "[/x] mine" in answer.out
    assert "simulations to first failure" in answer.out
    assert "[/x] mine" in Path("b/index.html").read_text(encoding="utf-8")


def test_the_exit_code_is_1_if_no_run_has_a_judged_drive(frenetic: Frenetic, wiggly: str) -> None:
    answer = frenetic("bench", "--generator", "wiggly.py:Broken", *LEAST, "--json")
    assert (answer.code, answer.json["runs"][0]["ending"]["end"]) == (1, "crashed")
    assert "no idea" in answer.err


STABILITY = {
    "passes_with_more_grip": "share that passes with 2 % more grip",
    "keeps_cause": "share that keeps its cause",
}


@pytest.mark.heavy
def test_the_stability_of_failures_is_measured_if_asked_for(frenetic: Frenetic) -> None:
    strategies = ("--strategy", "frenetic-2021", "--strategy", "random,name=other")
    options = ("--simulations", "30", "--repeats", "1", "--seed", "3", "--out", "b")
    answer = frenetic("bench", *strategies, *options, "--stability", "3")
    assert answer.code == 0, answer.err
    assert tomllib.loads(Path("b/bench.toml").read_text(encoding="utf-8"))["stability"] == 3
    again = frenetic("bench", "--resume", "--out", "b", "--json").json
    measured = {measure["name"]: measure for measure in again["measures"]}
    page = Path("b/index.html").read_text(encoding="utf-8")
    for name, title in STABILITY.items():
        assert title in answer.out
        assert title in page
        assert set(measured[name]["groups"]) == {"frenetic-2021", "other"}
    with CampaignStore.open("b/frenetic-2021/01") as store:
        stability = FailureStability.read(store.facts)
        failed = [test.id for test in store.tests(Outcome.FAIL)]
    assert stability is not None
    assert stability.total.failures == min(3, len(failed))
    assert stability.total.failures > 0
    share = measured["passes_with_more_grip"]["groups"]["frenetic-2021"]["values"]
    assert share == [stability.total.passes_with_more_grip.value]
    study = frenetic("rerun", "b/frenetic-2021/01", "--stability", "--json").json
    assert study["stability"]["failures"] == len(failed), "the run's failures are all driven"


@pytest.mark.heavy
def test_without_studies_no_stability_is_measured(frenetic: Frenetic) -> None:
    answer = frenetic("bench", "--strategy", "random", *LEAST, "--json")
    assert STABILITY.keys().isdisjoint(measure["name"] for measure in answer.json["measures"])
    assert not any(title in Path("b/index.html").read_text() for title in STABILITY.values())
    assert "stability" not in Path("b/bench.toml").read_text(encoding="utf-8")


@pytest.mark.heavy
@pytest.mark.parametrize("strategy", ["frenetic", "foresight"])
def test_a_strategys_run_gives_the_same_tests_as_frenetic_run(
    frenetic: Frenetic, strategy: str
) -> None:
    frenetic("bench", "--strategy", strategy, *SMALL)
    Path("run.toml").write_text("max_in_flight = 1\n")
    frenetic(
        *("run", "run.toml", "--strategy", strategy, "--simulations", "12", "--seed", "2"),
        *("--workers", "1"),
        *("--out", "alone"),
    )
    exported = []
    for folder in (f"b/{strategy}/02", "alone"):
        answer = frenetic("export", folder, "--format", "json", "--out", f"{folder}-json")
        assert answer.code == 0, answer.err
        lines = Path(f"{folder}-json/tests.jsonl").read_text().splitlines()
        others = {"seconds", "finished_at", "elapsed", "worker"}
        others |= {"cause_certainty", "minimised_length"}  # a bench tries and shortens nothing
        exported.append(
            [{k: v for k, v in json.loads(line).items() if k not in others} for line in lines]
        )
    assert exported[0] == exported[1]


def test_a_warning_of_too_few_repeats_comes_before_the_first_drive(frenetic: Frenetic) -> None:
    three = [text for seed in (1, 2, 3) for text in ("--strategy", f"random,max_redraws={seed}")]
    few = frenetic("bench", *three, "--simulations", "1", "--repeats", "1", "--out", "few")
    warning = "3 generators need up to 7 repeats for a difference to be shown: 1 may be too few"
    assert few.err.index("1 run of 1 simulation") < few.err.index(warning)
    assert warning not in frenetic("bench", "--resume", "--out", "few").err
    alone = frenetic("bench", "--strategy", "random", *LEAST)
    assert "too few" not in alone.err


def test_options_follow_their_entrant(frenetic: Frenetic, tmp_path: Path) -> None:
    repository = tmp_path / "a repository"
    repository.mkdir()
    (repository / "road_maker.py").write_text(WIGGLY, encoding="utf-8")
    answer = frenetic(
        *("bench", "--generator", f"road_maker:Wiggly,path={repository},name=Theirs"),
        *("--strategy", "random,name=Ours", "--strategy", "frenetic,random_roads=20,step=8"),
        *LEAST,
    )
    assert answer.code == 0, answer.err
    stored = tomllib.loads(Path("b/bench.toml").read_text(encoding="utf-8"))
    assert stored["generator"] == [f"road_maker:Wiggly,path={repository},name=Theirs"]
    assert stored["strategy"] == [
        "random,name=Ours",
        'frenetic,random_roads=20,step=8,name="frenetic,random_roads=20,step=8"',
    ]


def test_published_generators_are_listed_with_what_they_need(frenetic: Frenetic) -> None:
    assert "pymoo==0.6.1" in frenetic("bench", "--list").out
    listed = frenetic("bench", "--list", "--json").json
    assert {"optangle-2024", "crag-2023", "deeper-2021"} <= {
        generator["name"] for generator in listed
    }


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--strategy", "name=x"], ["a name is needed before the options"]),
        (["--strategy", "random,name=x,name=y"], ["the option name is there twice"]),
        (["--strategy", "randon"], ["unknown strategy 'randon'", "did you mean 'random'"]),
        (["--strategy", "random,sed=1"], ["has no option 'sed'"]),
        (["--generator", "nowhere.py:One"], ["One cannot be built", "nowhere.py"]),
        (["--generator", "wiggly.py:Wigly"], ["Wigly cannot be built", "Wiggly"]),
        (
            ["--generator", "wiggly.py:Wiggly,a=1"],
            ["no option 'a'", "takes path, copy, pipeline, python"],
        ),
        (["--generator", "wiggly"], ["no published generator 'wiggly'", "package.module:Class"]),
        (["--strategy", "random,copy=."], ["has no option 'copy'"]),
        (["--generator", "optangle-2024"], ["say where its files are", "branch tools24"]),
        (["--generator", "crag-2024,path=.,copy=."], ["say where its files are, no more"]),
        (["nothing.toml"], ["there is no file nothing.toml"]),
        (["--preset", "sbst2023"], ["no preset 'sbst2023'", "did you mean", "sbft2023"]),
        (
            ["--simulator", "frenetic.testing:DummySimulator", "--stability", "2"],
            ["DummySimulator cannot vary friction"],
        ),
        (["--resume"], ["--resume needs the folder of a bench"]),
        (["--resume", "--out", "nothing"], ["holds no bench"]),
        (["--out", "full"], ["is not empty", "place with --out"]),
    ],
)
def test_mistakes_are_refused_and_leave_no_files(
    frenetic: Frenetic, wiggly: str, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    before = sorted(tmp_path.rglob("*"))
    assert frenetic("bench", *arguments).refuses(*words), frenetic("bench", *arguments)
    assert sorted(path for path in tmp_path.rglob("*") if "__pycache__" not in path.parts) == before


def test_a_resumed_bench_takes_no_other_options(frenetic: Frenetic) -> None:
    frenetic("bench", "--strategy", "random", *LEAST)
    for option in (
        ["--repeats", "3"],
        ["--preset", "sbst2021"],
        ["--strategy", "frenetic"],
        ["--generator", "a:B"],
    ):
        answer = frenetic("bench", "--resume", "--out", "b", *option)
        assert answer.refuses(option[0], "continues as it was begun"), answer
    assert frenetic("resume", "b/random/01").refuses("a run of a bench", "--resume --out")
    text = Path("b/bench.toml").read_text(encoding="utf-8")
    Path("b/bench.toml").write_text(text.replace("seed = 1", "seed = 2"), encoding="utf-8")
    answer = frenetic("bench", "--resume", "--out", "b")
    assert answer.refuses("b holds a bench with another seed: 1, not 2"), answer
    for content in ('{"version": 3}', '{"version": 2}', "", "[]"):
        Path("b/bench.json").write_text(content, encoding="utf-8")
        answer = frenetic("bench", "--resume", "--out", "b")
        assert answer.refuses("bench.json is damaged or of another version"), answer


BENCH_FILE = """
generator = ["wiggly.py:Wiggly,name=theirs"]
strategy = ["random", "frenetic,random_roads=20"]
simulations = 3
seconds_per_test = 40
patience = "1m"
repeats = 1
seed = 4
workers = 2
driver = "planner,aggression=1.1"
with = {delay = 0.05}
speed_limit = 60
oob_tolerance = 0.9
map_size = 220
objective = "oob-share"
"""


def results_of(folder: str) -> dict[str, object]:
    """Return outcomes and MOOBD of the tests of each run of a bench."""
    results: dict[str, object] = {}
    for path in sorted(Path(folder).glob("*/*")):
        if path.is_dir():
            with CampaignStore.open(path) as store:
                tests = [(test.outcome, test.moobd) for test in store.tests()]
                results[str(path.relative_to(folder))] = tests, store.config["objective"]
    return results


@pytest.mark.heavy
def test_a_bench_reads_and_writes_a_file_that_repeats_it(frenetic: Frenetic, wiggly: str) -> None:
    Path("mine.toml").write_text(BENCH_FILE, encoding="utf-8")
    answer = frenetic("bench", "mine.toml", "--out", "a")
    assert answer.refuses("mine.toml names the generator", "or add --trust"), answer
    assert frenetic("bench", "--generator", wiggly, *LEAST).code == 0, (
        "a command is trusted, a file is not"
    )
    assert frenetic("bench", "mine.toml", "--out", "a").code == 2
    assert frenetic("bench", "mine.toml", "--trust", "--out", "a").code == 0
    stored = tomllib.loads(Path("a/bench.toml").read_text(encoding="utf-8"))
    entries = tomllib.loads(BENCH_FILE)
    same = entries.keys() - {"generator", "strategy", "patience", "workers"}
    assert {name: stored[name] for name in same} == {name: entries[name] for name in same}
    assert stored["patience"] == 60.0
    page = re.sub("<[^>]+>", "", Path("a/index.html").read_text(encoding="utf-8"))
    assert "frenetic bench a/bench.toml" in page
    assert frenetic("bench", "a/bench.toml", "--out", "again").code == 0
    assert results_of("again") == results_of("a")
    assert len(results_of("a")) == 3
    # Options beside the file win.
    options = ("--strategy", "random", "--simulations", "2", "--driver", "aggression=1.2")
    more = ("--objective", "moobd", "--repeats", "2", "--out", "b2")
    assert frenetic("bench", "mine.toml", *options, *more).code == 0
    stored = tomllib.loads(Path("b2/bench.toml").read_text(encoding="utf-8"))
    assert (stored["strategy"], stored["repeats"]) == (["random,name=random"], 2)
    assert "generator" not in stored
    assert (stored["simulations"], stored["driver"]) == (2, "planner,aggression=1.2")
    assert stored["objective"] == "moobd"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "generators = ['a.py:B']",
            ["does not say a bench: there is no entry 'generators'; did you mean 'generator'?"],
        ),
        ("simulations = 0", ["Expected `int` >= 1 - at `$.simulations`"]),
        ("seconds_per_test = 0", ["Expected `float` > 0.0 - at `$.seconds_per_test`"]),
        ("patience = 'soon'", ["'soon' is not a time"]),
        ("objective = 'x.py:f'", ["names the objective 'x.py:f'"]),
        ("strategy = ['x.py:Mine']", ["names the strategy 'x.py:Mine'"]),
        ("driver = 'x.py:Mine'", ["names the driver 'x.py:Mine'"]),
        ("map_margin = 3.0", ["there is no entry 'map_margin'"]),
    ],
)
def test_mistakes_in_a_file_are_refused(frenetic: Frenetic, text: str, words: list[str]) -> None:
    Path("mine.toml").write_text(text, encoding="utf-8")
    answer = frenetic("bench", "mine.toml", "--out", "b")
    assert answer.refuses(*words), answer
    assert not Path("b").exists()


def test_a_bench_whose_generator_changed_is_not_resumed(frenetic: Frenetic, wiggly: str) -> None:
    frenetic("bench", "--generator", wiggly, *LEAST)
    source = Path("wiggly.py")
    source.write_text(source.read_text() + "# changed\n", encoding="utf-8")
    assert frenetic("bench", "--resume", "--out", "b").refuses("the source of Wiggly is not what")
