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
def path(tmp_path: Path) -> Path:
    found = tmp_path / "town.toml"
    found.write_text(TEXT, encoding="utf-8")
    return found


def test_a_domain_is_searched_shown_and_driven_again(frenetic: Frenetic, path: Path) -> None:
    done = frenetic("run", "--odd", str(path), "--simulations", "60", "--seed", "1", "--out", "c")
    assert done.code == 0, done.err
    told = frenetic("show", "c").out
    assert "town: friction 0.1 to 1, gust -18 to 18 m/s" in told
    coverage = frenetic("show", "c", "--json").json["coverage"]
    friction, gust, *_ = coverage["axes"]
    assert coverage["drives"] == sum(cell["drives"] for cell in friction["cells"]) == 60
    cells = [
        f"{cell['low']:g} to {cell['high']:g}: {cell['failures']}/{cell['drives']}"
        if cell["drives"]
        else f"{cell['low']:g} to {cell['high']:g}: never"
        for cell in gust["cells"]
    ]
    assert f"gust (m/s)         {', '.join(cells)}\n" in told
    pairs = coverage["pairs"]
    assert pairs[0]["axes"] == ["friction", "gust"]
    driven, count = (sum(pair[name] for pair in pairs) for name in ("driven", "cells"))
    assert f"{driven} of {count} pairs of cells driven" in told
    low = frenetic("show", "c", "--feature", "friction=0.1:0.4", "--sort", "gust", "--json").json
    assert low["matching"] == sum(cell["drives"] for cell in friction["cells"][:2])
    gusts = [one["features"]["gust"] for one in low["listed"]]
    assert gusts == sorted(gusts, reverse=True)
    assert all(0.1 <= one["features"]["friction"] <= 0.4 for one in low["listed"])
    assert "gust (m/s)" in frenetic("show", "c", "--feature", "gust", "--limit", "1").out
    failed = frenetic("show", "c", "--outcome", "fail", "--json").json["listed"]
    assert failed
    number = str(failed[0]["id"])
    shown = frenetic("show", "c", number).out
    assert "conditions" in shown
    assert "friction 0." in shown
    assert "different" not in frenetic("drive", "c", number).out
    file = Path(f"c/failures/test-{int(number):05}.json")
    document = json.loads(file.read_text("utf-8"))
    friction = document["driven"]["simulator_options"]["friction"]
    assert f"friction {friction:g}" in shown
    again = frenetic("drive", str(file)).out
    assert "FAIL" in again
    small = frenetic("minimise", "c", number, "--json").json[0]
    assert small["conditions"].keys() == {"friction"}, "the gust is needed, it says"
    assert small["conditions"]["friction"] >= friction


def test_a_strategy_without_conditions_is_refused(frenetic: Frenetic, path: Path) -> None:
    words = ("run", "--odd", str(path), "--simulations", "5", "--out", "d")
    refused = frenetic(*words, "--strategy", "frenetic-2021")
    assert refused.code == 2
    assert "frenetic-2021 searches roads alone" in refused.err
    assert not Path("d").exists()
