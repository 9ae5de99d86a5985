"""A domain on the command line: run, show, drive again, minimise."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TEXT = """
roads = "urban-50,length=400"

[conditions]
friction = { low = 0.1, high = 1.0 }
gust = { low = -18, high = 18, mean = 0, deviation = 8 }
"""


@pytest.fixture
def domain_file(tmp_path: Path) -> Path:
    file = tmp_path / "town.toml"
    file.write_text(TEXT, encoding="utf-8")
    return file


def test_a_domain_is_searched_shown_and_driven_again(frenetic: Frenetic, domain_file: Path) -> None:
    ran = frenetic(
        "run", "--odd", str(domain_file), "--simulations", "60", "--seed", "1", "--out", "c"
    )
    assert ran.code == 0, ran.err
    shown_campaign = frenetic("show", "c").out
    assert "town: friction 0.1 to 1, gust -18 to 18 m/s" in shown_campaign
    coverage = frenetic("show", "c", "--json").json["coverage"]
    friction, gust, *_ = coverage["axes"]
    assert coverage["drives"] == sum(cell["drives"] for cell in friction["cells"]) == 60
    cells = [
        f"{cell['low']:g} to {cell['high']:g}: {cell['failures']}/{cell['drives']}"
        if cell["drives"]
        else f"{cell['low']:g} to {cell['high']:g}: never"
        for cell in gust["cells"]
    ]
    assert f"gust (m/s)         {', '.join(cells)}\n" in shown_campaign
    pairs = coverage["pairs"]
    assert pairs[0]["axes"] == ["friction", "gust"]
    driven, count = (sum(pair[name] for pair in pairs) for name in ("driven", "cells"))
    assert f"{driven} of {count} pairs of cells driven" in shown_campaign
    low = frenetic("show", "c", "--feature", "friction=0.1:0.4", "--sort", "gust", "--json").json
    assert low["matching"] == sum(cell["drives"] for cell in friction["cells"][:2])
    gusts = [test["features"]["gust"] for test in low["listed"]]
    assert gusts == sorted(gusts, reverse=True)
    assert all(0.1 <= test["features"]["friction"] <= 0.4 for test in low["listed"])
    assert "gust (m/s)" in frenetic("show", "c", "--feature", "gust", "--limit", "1").out
    failed = frenetic("show", "c", "--outcome", "fail", "--json").json["listed"]
    assert failed
    number = str(failed[0]["id"])
    shown = frenetic("show", "c", number).out
    assert "conditions" in shown
    assert "friction 0." in shown
    driven = frenetic("drive", "c", number).out
    assert "different" not in driven
    (line,) = [line for line in shown.splitlines() if line.startswith("conditions")]
    assert line in driven, "drive says its conditions"
    file = Path(f"c/failures/test-{int(number):05}.json")
    document = json.loads(file.read_text("utf-8"))
    friction = document["driven"]["with"]["friction"]
    assert f"friction {friction:g}" in shown
    from_file = frenetic("drive", str(file)).out
    assert "FAIL" in from_file
    assert f"friction {friction:g}" in from_file
    dry = frenetic("drive", str(file), "--with", "friction=1")
    assert "PASS" in dry.out, "what the command line says wins"
    assert "PASS" in frenetic("drive", "c", number, "--with", "friction=1").out
    assert frenetic("minimise", "c", number, "--with", "friction=1").refuses("this one is PASS")
    minimised = frenetic("minimise", "c", number, "--json").json[0]
    assert minimised["conditions"].keys() == {"friction"}, "the road fails without the gust"
    assert minimised["conditions"]["friction"] >= friction


@pytest.mark.heavy
def test_failures_in_a_domain_are_driven_again_and_compared(
    frenetic: Frenetic, domain_file: Path
) -> None:
    frenetic("run", "--odd", str(domain_file), "--simulations", "40", "--seed", "1", "--out", "c")
    number = str(frenetic("show", "c", "--outcome", "fail", "--json").json["listed"][0]["id"])
    rerun = frenetic("rerun", "c", number, "--junit", "again.xml")
    assert "1 of 1 drive ended exactly as before" in rerun.out
    assert "conditions" in rerun.out
    assert "friction 0." in rerun.out
    assert 'name="conditions" value="friction 0.' in Path("again.xml").read_text("utf-8")
    (test,) = frenetic("rerun", "c", number, "--json").json["tests"]
    recorded = test["conditions"]
    assert recorded.keys() == {"friction", "gust", "gust_at"}
    assert test["drives"][0]["conditions"] == recorded
    varied = frenetic("rerun", "c", number, "--vary", "friction", "--times", "4")
    assert "friction around each test's own" in varied.out
    dry = ("rerun", "c", number, "--with", "friction=1", "--with", "gust=0")
    assert "1 passes now" in frenetic(*dry).out
    assert frenetic(*dry, "--json").json["tests"][0]["conditions"] == {}
    compared = frenetic("compare", "c", "--driver", "aggression=0.9", "--fresh", "5")
    assert "domain: town: friction 0.1 to 1, gust -18 to 18 m/s\n" in compared.out


def test_an_export_notes_the_conditions_that_its_format_cannot_hold(
    frenetic: Frenetic, domain_file: Path
) -> None:
    frenetic("run", "--odd", str(domain_file), "--simulations", "2", "--seed", "1", "--out", "c")
    whole = frenetic("export", "c", "--format", "competition")
    assert "do not say in which conditions of town each test was driven" in whole.err
    single = frenetic("export", "c", "1", "--format", "opendrive")
    assert "Note: test 1 was driven with friction 0." in single.err


@pytest.mark.heavy
def test_an_export_as_tables_holds_the_conditions(frenetic: Frenetic, domain_file: Path) -> None:
    frenetic("run", "--odd", str(domain_file), "--simulations", "2", "--seed", "1", "--out", "c")
    tables = frenetic("export", "c", "--format", "csv")
    assert "conditions" not in tables.err
    header = Path("c/exports/csv/tests.csv").read_text("utf-8").partition("\n")[0]
    assert "friction" in header
    assert "gust_at" in header


def test_with_lays_conditions_on_driver_and_simulator(frenetic: Frenetic) -> None:
    words = ("run", "--simulations", "1", "--seed", "1", "--out", "c")
    ran = frenetic(*words, "--with", "friction=0.5", "--with", "speed=60", "--with", "delay=0.1")
    assert ran.code == 0
    config = frenetic("show", "c", "--json").json["config"]
    assert config["spec"]["with"] == {"friction": 0.5, "delay": 0.1, "speed": 60.0}
    assert config["conditions"] == config["spec"]["with"]
    assert config["spec"]["simulator"] == "embedded"
    assert "conditions friction 0.5, speed 60 km/h, delay 0.1 s\n" in frenetic("show", "c").out


def test_a_strategy_without_conditions_is_refused(frenetic: Frenetic, domain_file: Path) -> None:
    words = ("run", "--odd", str(domain_file), "--simulations", "5", "--out", "d")
    refused = frenetic(*words, "--strategy", "frenetic-2021")
    assert refused.code == 2
    assert "frenetic-2021 searches roads alone" in refused.err
    assert not Path("d").exists()


ERRING = """
roads = "urban-50,length=200"

[conditions]
steering_gain = { low = 0.6, high = 1.2, mean = 1.0, deviation = 0.2 }
steering_rate = { low = 0.1, high = 0.4, chance = 0.4 }
heading_bias = { low = -0.05, high = 0.05 }
lateral_dropout = { low = 0.0, high = 0.8, chance = 0.5 }
speed_bias = 5
"""


def test_a_domain_may_have_sensors_and_steering_that_err(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    file = tmp_path / "worn.toml"
    file.write_text(ERRING, encoding="utf-8")
    ran = frenetic("run", "--odd", str(file), "--simulations", "60", "--seed", "1", "--out", "c")
    assert ran.code == 0, ran.err
    shown = frenetic("show", "c").out
    assert "worn: steering_gain 0.6 to 1.2, steering_rate 0.1 to 0.4 rad/s in 40 %" in shown
    axes = frenetic("show", "c", "--json").json["coverage"]["axes"]
    names = ["steering_gain", "steering_rate", "heading_bias", "lateral_dropout"]
    assert [axis["name"] for axis in axes][:4] == names
    assert frenetic("check", "c").code == 0
    changes = frenetic("rerun", "c", "--all", "--json").json["changes"]
    assert changes["passes now"] == changes["fails now"] == changes["not judged"] == 0
    estimated = frenetic("estimate", "c", "--drives", "100")
    assert estimated.code == 0, estimated.err
