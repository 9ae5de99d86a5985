"""The TOML file of a run: campaigns write it, commands read it, and refuse what is wrong."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.campaign import CampaignStore
from frenetic.spec import SPEC_FILE, Budget, Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

OPTIONS = ("--workers", "1", "--json")


def results_of(folder: str) -> list[object]:
    with CampaignStore.open(Path(folder)) as store:
        return [(list(test.candidate.curvatures), test.result) for test in store.tests()]


@pytest.mark.parametrize(
    "options",
    [
        ("--seed", "3", "--with", "noise=0.1", "--driver", "aggression=1.1"),
        pytest.param(
            ("--seed", "5", "--strategy", "frenetic-2021,threshold=-0.2"), marks=pytest.mark.heavy
        ),
        (
            *("--simulator", "embedded,friction=0.8", "--map-size", "250"),
            *("--criteria", "competition,oob_tolerance=0.5"),
        ),
        pytest.param(
            (
                "--roads",
                "rural-80,length=800",
                "--map-size",
                "1000",
                "--criteria",
                "speed_limit=70",
            ),
            marks=pytest.mark.heavy,
        ),
        pytest.param(("--objective", "oob-share", "--strategy", "random"), marks=pytest.mark.heavy),
    ],
)
def test_a_campaigns_own_file_runs_the_same_campaign(
    frenetic: Frenetic, options: tuple[str, ...]
) -> None:
    assert frenetic("run", "--simulations", "12", *options, *OPTIONS, "--out", "first").code == 0
    assert frenetic("run", f"first/{SPEC_FILE}", "--out", "again", "--json").code == 0
    assert results_of("again") == results_of("first")
    first, repeated = (Path(folder, SPEC_FILE).read_text() for folder in ("first", "again"))
    assert first == repeated


def test_a_campaigns_file_holds_the_options_the_parts_and_the_seed(
    frenetic: Frenetic,
) -> None:
    frenetic("run", "--simulations", "1", "--with", "delay=0.1", *OPTIONS, "--out", "c")
    entries = tomllib.loads(Path("c", SPEC_FILE).read_text())
    parts = {"strategy": "frenetic", "driver": "planner", "simulator": "embedded"}
    options = {"simulations": 1, "workers": 1, "with": {"delay": 0.1}}
    assert entries.keys() == {*parts, *options, "seed", "max_in_flight"}
    assert entries.items() >= {**parts, **options}.items()


@pytest.mark.heavy
def test_the_file_of_a_search_that_starts_from_campaigns_repeats_it(frenetic: Frenetic) -> None:
    for name, seed in (("one", "3"), ("two", "4")):
        frenetic("run", "--simulations", "20", "--seed", seed, *OPTIONS, "--out", name)
    start = ("--from", "one", "--from", "two")
    frenetic("run", "--simulations", "8", "--seed", "5", *start, *OPTIONS, "--out", "first")
    assert Spec.read(Path("first", SPEC_FILE)).start_from == ("one", "two")
    assert frenetic("run", f"first/{SPEC_FILE}", "--out", "again", "--json").code == 0
    assert results_of("again") == results_of("first")
    frenetic("resume", "first", "--simulations", "4", *OPTIONS)
    assert "simulations = 12\n" in Path("first", SPEC_FILE).read_text()


def test_options_win_over_the_file(frenetic: Frenetic) -> None:
    Path("run.toml").write_text(
        'driver = "stanley,aggression=1.1"\nsimulations = 50\nfailures = 50\nseed = 3\n'
        'time = "1h"\nworkers = 1\n[with]\ndelay = 0.1\nview = 50\n'
    )
    options = ("--simulations", "2", "--driver", "smoothing=0.5")
    amounts = ("--with", "noise=0.1", "--with", "view=inf")
    answer = frenetic("run", "run.toml", *options, *amounts, "--out", "c", "--json")
    assert answer.json["simulations"] == 2
    written = Spec.read(Path("c", SPEC_FILE))
    assert written.driver == "stanley,aggression=1.1,smoothing=0.5"
    assert written.conditions == {"delay": 0.1, "noise": 0.1}
    assert written.budget == Budget(simulations=2, time=3600.0, failures=50)
    assert written.seed == 3


@pytest.mark.parametrize("is_first", [True, False])
def test_other_options_win_over_roads_in_any_order(frenetic: Frenetic, is_first: bool) -> None:
    roads = ("--roads", "rural-80,length=250")
    others = ("--map-size", "200", "--criteria", "speed_limit=70")
    words = (*roads, *others) if is_first else (*others, *roads)
    assert frenetic("run", *words, "--simulations", "1", *OPTIONS, "--out", "c").code == 0
    with CampaignStore.open("c") as store:
        assert store.setting.map_size == 200.0
        assert store.setting.rules.speed_limit == 70.0
        assert store.setting.lane_width == 3.5


# Other commands


def test_as_drives_with_the_parts_and_rules_of_a_file(frenetic: Frenetic) -> None:
    Path("road.json").write_text(json.dumps({"curvatures": [0.0, 0.02, 0.0]}))
    Path("how.toml").write_text('driver = "stanley"\nspeed_limit = 30\nsimulations = 5\n')
    driven = frenetic("drive", "road.json", "--as", "how.toml")
    assert "driver     stanley in embedded" in driven.out
    slow = frenetic("drive", "road.json", "--as", "how.toml", "--json").json["duration"]
    assert slow > frenetic("drive", "road.json", "--driver", "stanley", "--json").json["duration"]


def test_as_replaces_parts_and_rules_of_the_first_file_and_options_win(frenetic: Frenetic) -> None:
    Path("run.toml").write_text(
        'driver = "planner,aggression=1.2"\nspeed_limit = 50\nroads = "rural-80"\nseed = 3\n'
        'simulations = 2\nobjective = "oob-share"\nworkers = 1\n[with]\ndelay = 0.1\n'
    )
    Path("how.toml").write_text(
        'driver = "stanley"\nmap_size = 250\nseed = 7\n[with]\nnoise = 0.1\n'
    )
    options = ("--as", "how.toml", "--driver", "smoothing=0.5", "--with", "view=30")
    assert frenetic("run", "run.toml", *options, "--out", "c").code == 0
    written = Spec.read(Path("c", SPEC_FILE))
    assert written.driver == "stanley,smoothing=0.5"
    assert written.conditions == {"noise": 0.1, "view": 30.0}
    assert (written.speed_limit, written.roads, written.map_size) == (None, None, 250.0)
    assert (written.seed, written.simulations, written.objective) == (3, 2, "oob-share")


def test_options_for_a_driver_of_an_untrusted_file_do_not_trust_it(frenetic: Frenetic) -> None:
    Path("theirs.py").write_text("raise SystemExit('it ran')\n")
    Path("run.toml").write_text('driver = "theirs.py:Driver"\n')
    refused = frenetic("run", "run.toml", "--driver", "aggression=1.1")
    assert refused.refuses("code that you have not trusted", "--driver theirs.py:Driver")


WRONG = {
    "simulation = 5": "there is no entry 'simulation'; did you mean 'simulations'?",
    "simulations = 0": "simulations is 0: a whole number >= 1 is needed",
    "speed_limit = 'fast'": "speed_limit is 'fast': a number is needed",
    "map_size = inf": "map_size is inf: a number that is finite is needed",
    "time = 'soon'": "'soon' is not a time",
    "driver = 'planner,aggression'": "'aggression' is not OPTION=VALUE",
    "[with]\nfogg = 3": "unknown condition 'fogg'; did you mean 'fog'?",
    "[with]\nfog = 'thick'": "with is {'fog': 'thick'}: a number is needed",
    "oob_tolerance = 0": "oob_tolerance is 0: a number > 0 is needed",
    "roads = 'rural-81'": "there is no road class 'rural-81': choose",
    "odd = {fog = 3}": "there is no entry fog",
    "simulations = ": "line 1",
    "\x00": "line 1",
}
"""Text of a file -> words of the line that refuses the file."""


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_file_is_refused_in_one_line(frenetic: Frenetic, text: str) -> None:
    Path("run.toml").write_text(f"{text}\n")
    assert frenetic("run", "run.toml", "--out", "c").refuses("run.toml", WRONG[text])
    assert not Path("c").exists()
