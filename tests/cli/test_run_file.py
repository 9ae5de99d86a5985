"""A run as a TOML file: what it takes, what every campaign writes, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from specs import positive, specs, texts

from frenetic.campaign import Campaign, CampaignStore
from frenetic.drivers import Planner
from frenetic.run_file import NAME, read_run_file, write_run_file
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator, Rules
from frenetic.spec import Budget, EarlierCampaign, Part, Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

ONE = ("--workers", "1", "--json")


def results_of(folder: str) -> list[object]:
    with CampaignStore.open(Path(folder)) as store:
        return [(list(test.candidate.curvatures), test.result) for test in store.tests()]


@pytest.mark.parametrize(
    "options",
    [
        ("--seed", "3", "--with", "noise=0.1", "--driver", "aggression=1.1"),
        (
            "--seed",
            "5",
            "--strategy",
            "frenetic-2021,threshold=-0.2",
        ),
        (
            "--simulator",
            "embedded,friction=0.8",
            "--map-size",
            "250",
            "--criteria",
            "competition,oob_tolerance=0.5",
        ),
        ("--objective", "oob-share", "--strategy", "random"),
    ],
)
def test_a_campaigns_own_file_runs_the_same_campaign(
    frenetic: Frenetic, options: tuple[str, ...]
) -> None:
    assert frenetic("run", "--simulations", "12", *options, *ONE, "--out", "first").code == 0
    assert frenetic("run", f"first/{NAME}", "--out", "again", "--json").code == 0
    assert results_of("again") == results_of("first")
    first, again = (Path(folder, NAME).read_text() for folder in ("first", "again"))
    assert first == again


def test_a_search_that_starts_from_another_is_repeated(frenetic: Frenetic) -> None:
    frenetic("run", "--simulations", "20", "--seed", "3", *ONE, "--out", "one")
    frenetic("run", "--simulations", "8", "--seed", "4", "--from", "one", *ONE, "--out", "first")
    assert frenetic("run", f"first/{NAME}", "--out", "again", "--json").code == 0
    assert results_of("again") == results_of("first")
    frenetic("resume", "first", "--simulations", "4", *ONE)
    assert "simulations = 12\n" in Path("first", NAME).read_text()


def test_given_options_win(frenetic: Frenetic) -> None:
    Path("run.toml").write_text(
        'driver = "stanley,aggression=1.1"\nsimulations = 50\nfailures = 50\nseed = 3\n'
        'time = "1h"\nworkers = 1\n[with]\ndelay = 0.1\n'
    )
    options = ("--simulations", "2", "--driver", "smoothing=0.5", "--with", "noise=0.1")
    assert frenetic("run", "run.toml", *options, "--out", "c", "--json").json["simulations"] == 2
    written, _ = read_run_file(Path("c", NAME))
    assert written.driver == Part("stanley", {"aggression": 1.1, "smoothing": 0.5})
    assert written.layers == {"delay": 0.1, "noise": 0.1}
    assert written.budget == Budget(simulations=2, time=3600.0, failures=50)
    assert written.seed == 3


def test_other_commands_drive_as_it_says(frenetic: Frenetic) -> None:
    Path("road.json").write_text(json.dumps({"curvatures": [0.0, 0.02, 0.0]}))
    Path("how.toml").write_text('driver = "stanley"\nspeed_limit = 30\nsimulations = 5\n')
    driven = frenetic("drive", "road.json", "--as", "how.toml")
    assert "driver     stanley in embedded" in driven.out
    slow = frenetic("drive", "road.json", "--as", "how.toml", "--json").json["duration"]
    assert slow > frenetic("drive", "road.json", "--driver", "stanley", "--json").json["duration"]


WRONG = {
    "simulation = 5": "unknown field `simulation`",
    "simulations = 0": "`int` >= 1 - at `$.simulations`",
    "speed_limit = 'fast'": "$.speed_limit",
    "map_size = inf": "$.map_size",
    "time = 'soon'": "'soon' is not a time",
    "driver = 'planner,aggression'": "'aggression' is not OPTION=VALUE",
    "[with]\nfogg = 3": "unknown quantity 'fogg', did you mean 'fog'?",
    "[with]\nfog = 'thick'": "$.with",
    "oob_tolerance = 0": "oob_tolerance is 0",
    "simulations = ": "line 1",
    "\x00": "line 1",
}
"""What a file says, and words of the line that refuses it."""


def test_a_wrong_file_is_one_line(frenetic: Frenetic) -> None:
    for text, words in WRONG.items():
        Path("run.toml").write_text(f"{text}\n")
        assert frenetic("run", "run.toml", "--out", "c").refuses("run.toml", *words.split(", "))
        assert not Path("c").exists()


def test_a_campaign_of_objects_writes_none(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=1),
        folder=tmp_path / "c",
    ).run()
    assert not (tmp_path / "c" / NAME).exists()


@given(
    specs(
        rules=st.builds(Rules, oob_tolerance=st.floats(0.01, 1.0))
        | st.builds(
            Rules,
            speed_limit=st.floats(1.0, 1e3),
            oob_tolerance=st.floats(0.01, 1.0),
            road_limits=st.just("ignored"),
        ),
        wall_limit=st.none() | positive,
        objective=texts.filter(bool),
        start_from=st.lists(st.builds(EarlierCampaign, texts), max_size=2).map(tuple),
    )
)
def test_what_is_written_is_read_back(spec: Spec) -> None:
    with TemporaryDirectory() as folder:
        write_run_file(spec, Path(folder))
        again, entries = read_run_file(Path(folder, NAME))
    assert replace(again, workers=spec.workers) == spec
    assert (entries.lookahead, entries.workers) == (spec.lookahead, spec.workers)
