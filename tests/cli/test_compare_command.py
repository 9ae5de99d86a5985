"""The command line of compare."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.analysis.curves import CURVES
from frenetic.analysis.measures import MEASURES, SHARED_TEXT

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


@pytest.fixture(scope="session")
def prepared_campaigns(
    tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]
) -> Path:
    """Folders f-1, f-2, r-1, r-2 with campaigns of two strategies."""
    parent = tmp_path_factory.mktemp("campaigns")
    for strategy in ("frenetic", "random"):
        for seed in ("1", "2"):
            search = ("--simulations", "20", "--strategy", strategy, "--seed", seed)
            folder = str(parent / f"{strategy[0]}-{seed}")
            prepare("run", *search, "--out", folder, "--workers", "1")
    return parent


@pytest.fixture
def runs(prepared_campaigns: Path, tmp_path: Path) -> None:
    """Copies of these campaigns in the folder runs of the command line."""
    ignored = shutil.ignore_patterns("failures")
    shutil.copytree(prepared_campaigns, tmp_path / "runs", ignore=ignored)


def groups_of(document: dict[str, object]) -> dict[str, list[str]]:
    groups = document["groups"]
    assert isinstance(groups, dict)
    return {
        name: [Path(campaign["folder"]).name for campaign in campaigns]
        for name, campaigns in groups.items()
    }


FRENETIC, RANDOM = ["f-1", "f-2"], ["r-1", "r-2"]


@pytest.mark.usefixtures("runs")
@pytest.mark.parametrize(
    ("places", "groups"),
    [
        (["runs"], {"frenetic": FRENETIC, "random": RANDOM}),
        (
            ["runs/f-1", "runs/r-1", "runs/r-2", "runs/f-2"],
            {"frenetic": FRENETIC, "random": RANDOM},
        ),
        (["a=runs/f-1,runs/f-2", "b=runs/r-*"], {"a": FRENETIC, "b": RANDOM}),
        (["a=runs/f-1", "b=runs/r-1", "a=runs/f-2"], {"a": FRENETIC, "b": ["r-1"]}),
        (["a=runs/?-1", "runs/f-2"], {"a": ["f-1", "r-1"], "all": ["f-2"]}),
    ],
)
def test_groups_are_as_named_or_hold_campaigns_that_differ_in_the_seed_alone(
    frenetic: Frenetic, places: list[str], groups: dict[str, list[str]]
) -> None:
    answer = frenetic("compare", *places, "--json")
    assert answer.code == 0, answer.err
    assert groups_of(answer.json) == groups


@pytest.mark.usefixtures("runs")
def test_compare_prints_medians_and_writes_a_picture_and_a_page(frenetic: Frenetic) -> None:
    files = ("--out", "a.png", "--out", "a.html")
    answer = frenetic("compare", "runs", *files)
    assert answer.code == 0
    for words in (
        "Campaigns: 2 of frenetic, 2 of random",
        "distinct failures",
        "frenetic and random: too few repeats to tell",
        "\na.png\na.html\n",
        "Order by distinct failures (median): 1. ",
        "unlike in behaviour, radius 1 ",
        SHARED_TEXT,
    ):
        assert words in answer.out
    assert "radius 2" not in answer.out, "the other measures are on the page"
    assert "test-set diameter" not in answer.out
    assert Path("a.png").stat().st_size > 10_000
    page = Path("a.html").read_text(encoding="utf-8")
    assert "frenetic compare runs --out a.html" in re.sub("<[^>]+>", "", page)
    assert "runs/f-1/report.html" in page


@pytest.mark.usefixtures("runs")
def test_json_holds_all_measures_and_null_for_what_never_happened(frenetic: Frenetic) -> None:
    calm = ("--simulations", "3", "--driver", "aggression=0.3", "--seed", "1", "--out", "calm")
    frenetic("run", *calm)
    answer = frenetic("compare", "a=runs/f-*", "calm=calm", "c=runs/r-*", "--json")
    assert "Infinity" not in answer.out
    assert "NaN" not in answer.out
    measures = {measure["name"]: measure for measure in answer.json["measures"]}
    first = measures["simulations_to_failure"]
    assert first["groups"]["calm"]["values"] == [first["groups"]["calm"]["median"]] == [None]
    assert [pair["verdict"] for pair in first["pairs"]] == ["too few repeats to tell"] * 3
    assert answer.json["order"][-1] == "calm"
    assert answer.json["about"] == SHARED_TEXT
    assert measures["distinct_failures"]["is_shared_with_search"]
    assert (measures["bend_2"]["space"], measures["bend_2"]["radius"]) == ("bend", 2.0)
    for name, campaigns in answer.json["groups"].items():
        for i, campaign in enumerate(campaigns):
            assert list(campaign["measures"]) == list(MEASURES)
            for measure, compared in measures.items():
                assert campaign["measures"][measure] == compared["groups"][name]["values"][i]
            assert list(campaign["curves"]) == list(CURVES)
            curve = campaign["curves"]["failures"]
            assert curve["x"] == list(range(campaign["simulations"] + 1))
            assert curve["y"][-1] == campaign["failures"] == campaign["measures"]["failures"]
            curve = campaign["curves"]["bend"]
            at_radius = dict(zip(curve["x"], curve["y"], strict=True))
            assert at_radius[0.5] == campaign["measures"]["bend_0_5"]
    notes = " ".join(answer.json["notes"])
    assert "differ in more than one thing" in notes
    assert "3 to 20 simulations" in notes
    assert notes.split()[0] in answer.err, "notes are for people, too"
    answer = frenetic("compare", "frenetic=runs/r-1", "runs/r-2", "runs/f-1")
    assert answer.refuses("two groups are called frenetic")
