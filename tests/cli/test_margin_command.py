"""The command `margin`: its table, files and exit codes, and the drives that it continues."""

from __future__ import annotations

import html
import inspect
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from frenetic.campaign import CampaignStore, Event, Summary
from frenetic.cli.margin import margin as margin_command
from frenetic.rerun.margin import measure_margins

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

ON = ("margin", "--roads", "urban-50,length=200", "--random-roads", "4")


def test_a_margin_is_printed_drawn_and_written(frenetic: Frenetic, tmp_path: Path) -> None:
    words = (*ON, "--of", "delay", "--of", "steering_offset", "--out", "m")
    answer = frenetic(*words, "--plot", "m.png", "--junit", "m.xml")
    assert answer.code == 0, answer.err
    first, heading, *rows = answer.out.splitlines()
    assert first == (
        "Where the driver begins to fail on 5 % of 4 random roads of urban-50, 50 km/h"
    )
    assert heading.split("  ")[0] == "quantity"
    assert [row.split("  ")[0] for row in rows[:3]] == [
        "more delay",
        "more steering offset to the right",
        "more steering offset to the left",
    ]
    assert "m.png" in answer.out
    assert answer.out.splitlines()[-1] == "Kept in m; to see it: frenetic report m"
    assert frenetic("report", "m").code == 0
    report = Path("m/report.html").read_text(encoding="utf-8")
    assert f"<title>{first}</title>" in report, "the study comes first in its own report"
    assert "planner was measured in embedded: these drives are no search" in report
    with Image.open("m.png") as picture:
        assert picture.width > 1000
    cases = [case.get("name") for case in ET.parse("m.xml").iter("testcase")]
    assert cases == ["delay, more", "steering_offset, less", "steering_offset, more"]
    document = frenetic(*words, "--json").json
    assert [margin["side"] for margin in document["margins"]] == ["more", "less", "more"]
    assert all(len(margin["roads"]) == 4 for margin in document["margins"])
    for margin, row in zip(document["margins"], rows, strict=False):
        assert f"  {margin['drive']}  " in row
        shown = frenetic("show", "m", str(margin["drive"])).out
        assert "FAIL" in shown
        (amount,) = re.findall(rf"conditions {margin['condition']} (\S+) ", shown)
        assert float(amount) == pytest.approx(margin["amount"], rel=0.05)


def test_at_least_ends_with_1_where_a_margin_is_too_small(frenetic: Frenetic) -> None:
    words = (*ON, "--of", "delay=0.5", "--out", "m", "--at-least")
    borne = frenetic(*words, "delay=0.01")
    assert borne.code == 0, borne.err
    too_small = frenetic(*words, "delay=0.49", "--junit", "m.xml")
    assert too_small.code == 1
    (line,) = (line for line in too_small.out.splitlines() if "Too small" in line)
    assert line.startswith("Too small a margin: delay: begins to fail at 0.")
    assert line.endswith("0.49 s is needed")
    assert [*frenetic(*words, "delay=0.49", "--json").json["shortfalls"]] == ["delay, more"]
    assert ET.parse("m.xml").getroot().get("failures") == "1"
    on_both_sides = (*ON, "--at-least", "steering_offset=0.001", "--at-least")
    answer = frenetic(*on_both_sides, "steering_offset=-0.001", "--of", "steering_offset")
    assert answer.code == 0, answer.err


def test_a_campaign_has_its_most_demanding_roads_beside_the_random_ones(
    frenetic: Frenetic,
) -> None:
    run = ("run", "--roads", "urban-50,length=200", "--simulations", "12", "--seed", "1")
    assert frenetic(*run, "--out", "c").code == 0
    words = ("margin", "c", "--random-roads", "3", "--of", "delay")
    answer = frenetic(*words)
    assert answer.code == 0, answer.err
    assert "3 most demanding" in answer.out.splitlines()[1]
    document = frenetic(*words, "--json").json
    assert Path(document["folder"]).parent == Path("c/rerun")
    (margin,) = document["margins"]
    shown = frenetic("show", "c", "--json").json
    assert len(margin["demanding_roads"]) == 3
    assert len(margin["roads"]) == 3, "demanding roads do not count as random ones"
    tests = {limit["road"] for limit in margin["demanding_roads"]}
    assert tests <= set(range(1, shown["tests"] + 1))
    assert margin["most_demanding"] == min(
        limit["fails"] for limit in margin["demanding_roads"] if limit["fails"] is not None
    )
    folder = document["folder"]
    assert answer.out.splitlines()[-1] == f"Kept in {folder}; to see it: frenetic report c"
    assert frenetic("report", "c").code == 0
    report = Path("c/report.html").read_text(encoding="utf-8")
    assert "3 random roads of urban-50, 50 km/h, seed 0, and the 3 roads that the" in report
    assert f"'frenetic show {folder} DRIVE' shows it" in html.unescape(report)
    elsewhere = frenetic(*words, "--out", "elsewhere").out.splitlines()[-1]
    assert elsewhere == "Kept in elsewhere; to see it: frenetic report elsewhere"
    assert frenetic("rerun", "c", "--top", "1").code == 0


def test_a_domain_draws_the_other_conditions(frenetic: Frenetic) -> None:
    Path("icy.toml").write_text(
        'roads = "urban-50,length=200"\n[conditions]\nfriction = { low = 0.5, high = 0.9 }\n'
    )
    words = ("margin", "--odd", "icy.toml", "--random-roads", "2", "--of", "delay")
    document = frenetic(*words, "--out", "m", "--json").json
    assert document["domain"] == "icy"
    with CampaignStore.open("m") as store:
        usual, *others = (test.candidate.conditions for test in store.tests() if test.id != 2)
    assert [*usual] == ["friction"]
    assert 0.5 <= usual["friction"] <= 0.9
    assert {"friction": usual["friction"], "delay": 0.1667} in others
    assert "friction is given, and icy draws it" in frenetic(*words, "--with", "friction=1").err


def test_library_and_command_have_as_many_roads_by_default() -> None:
    (option,) = (option for option in margin_command.params if option.name == "random_roads")
    assert inspect.signature(measure_margins).parameters["roads"].default == option.default


def test_ctrl_c_names_the_command_that_goes_on(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, on_event: object, **__: object) -> None:
        summary = Summary(lane_width=4.0)
        summary.folder = Path("campaigns/x")
        on_event(Event("progress", summary))  # type: ignore[operator, arg-type]
        raise KeyboardInterrupt

    monkeypatch.setattr("frenetic.rerun.margin.measure_margins", interrupt)
    answer = frenetic(*ON, "--of", "delay")
    assert answer.code == 130
    assert "Interrupted: 0 drives made; go on: frenetic margin" in answer.err
    assert "--of delay --out campaigns/x" in answer.err
