"""Presets of a bench: an edition's conditions, and its published figures beside the measured."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.plugins.bench.file import read_bench
from frenetic.plugins.bench.presets import PRESETS

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]
pytestmark = pytest.mark.usefixtures("new_process_server")

SMALL = ("--simulations", "12", "--repeats", "2", "--strategy", "random")


def bench_entries(folder: str) -> dict[str, object]:
    return tomllib.loads(Path(folder, "bench.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", PRESETS)
def test_each_preset_is_a_bench_whose_figures_have_sources(name: str, tmp_path: Path) -> None:
    preset = PRESETS[name]
    spec, entries = read_bench(None, name)
    bench = entries.bench(spec, tmp_path / "b")
    assert preset.bench.items() <= bench.entries().items()
    assert bench.preset is preset
    assert preset.differs.keys() <= preset.bench.keys()
    assert {figures.source for figures in preset.published} <= preset.sources.keys()
    assert preset.published
    for figures in preset.published:
        assert figures.valid is None or figures.failures <= figures.valid <= (figures.tests or 0)


def test_published_figures_stand_beside_measured_figures(frenetic: Frenetic) -> None:
    answer = frenetic("bench", "--preset", "sbst2021", *SMALL, "--out", "b")
    assert answer.code == 0, answer.err
    assert re.search(r"^random +2 +12 +12 .* here *$", answer.out, re.MULTILINE)
    assert re.search(r"^Frenetic +30 +190 +136 +14\.0 +10\.3 +27\.1 +AmbieGen *$", answer.out, re.M)
    assert "Differs in simulator: the embedded simulator, not BeamNG.research" in answer.out
    assert "Differs in simulations: 12 is given, where the preset has 200" in answer.out
    assert "Source AmbieGen: data of its authors" in answer.out
    page = re.sub("<[^>]+>", " ", Path("b/index.html").read_text(encoding="utf-8"))
    for text in ("Beside SBST 2021", "GABExploit", "26.3", "12 is given, where the preset has 200"):
        assert text in page
    resumed = frenetic("bench", "--resume", "--out", "b", "--json").json
    assert resumed["preset"]["published"][0]["failures"] == 14.0
    assert resumed["preset"]["differs"]["repeats"] == "2 is given, where the preset has 10"


def test_a_file_overrides_the_preset_and_options_override_the_file(frenetic: Frenetic) -> None:
    options = ("--driver", "aggression=0.9", "--objective", "oob-share")
    answer = frenetic("bench", "--preset", "sbst2021", *SMALL, *options, "--out", "b")
    expected = {
        "driver": "beamng-ai,aggression=0.9",
        "objective": "oob-share",
        "oob_tolerance": 0.85,
        "speed_limit": 252.0,
        "simulations": 12,
        "preset": "sbst2021",
    }
    assert expected.items() <= bench_entries("b").items()
    assert (
        "Differs in driver: beamng-ai,aggression=0.9 is given, where the preset has" in answer.out
    )
    # A file wins over the preset, and options win over the file.
    Path("mine.toml").write_text(
        'preset = "sbst2021"\nstrategy = ["random"]\nsimulations = 3\nrepeats = 1\n'
        "oob_tolerance = 0.95\nmap_size = 250\n"
    )
    assert frenetic("bench", "mine.toml", "--simulations", "2", "--out", "c").code == 0
    expected = {"oob_tolerance": 0.95, "map_size": 250.0, "speed_limit": 252.0, "simulations": 2}
    assert expected.items() <= bench_entries("c").items()
    assert frenetic("bench", "mine.toml", "--preset", "sbft2023", "--out", "d").code == 0
    expected = {"preset": "sbft2023", "speed_limit": 70.0, "oob_tolerance": 0.95, "simulations": 3}
    assert expected.items() <= bench_entries("d").items()
