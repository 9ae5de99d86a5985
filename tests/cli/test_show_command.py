"""`frenetic show`: a campaign, a test, lists of tests, and the nearest misses."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from frenetic.campaign import CampaignStore
from frenetic.oracle.outcome import Outcome

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]


def test_show_describes_a_campaign_and_a_test(frenetic: Frenetic, copied: str) -> None:
    whole = frenetic("show", "c")
    assert "strategy   frenetic [version" in whole.out
    assert "driver     planner [version" in whole.out
    assert "conditions delay 0.05 s\n" in whole.out
    assert "seed       3\n" in whole.out
    assert "speed limit 70 km/h, assumed, 0.95 of the car may be out, map of 200 m" in whole.out
    assert "60 simulations" in whole.out
    assert "distinct failure" in whole.out
    document = frenetic("show", "c", "--json").json
    assert document["passed"] + document["failed"] == 60
    alike = [test for failure in document["distinct_failures"] for test in failure["tests"]]
    assert len(alike) == len(set(alike)) == document["failed"]
    failing = alike[0]
    shown_test = frenetic("show", "c", str(failing))
    assert "FAIL" in shown_test.out
    assert "curvatures" in shown_test.out
    document = frenetic("show", "c", str(failing), "--json").json
    assert document["id"] == failing
    assert Path(document["picture"]).is_file()


def test_a_clean_campaign_is_described_without_words_of_the_code(frenetic: Frenetic) -> None:
    """No asking and telling, no clusters, and no counts of zero."""
    clean = ("--simulations", "60", "--seed", "3", "--workers", "1", "--out", "c")
    texts = [frenetic("run", *clean).out, frenetic("show", "c").out, frenetic("report", "c").out]
    texts += [frenetic("show", "c", "7").out, frenetic("show", "c", "--sort", "tested").out]
    texts += [frenetic("resume", "c", "--simulations", "3").out]
    texts += [frenetic(name, "--help").out for name in ("run", "resume", "report")]
    assert re.findall(r"\b(?:told|alike|telling|0 \w+ed)\b", "\n".join(texts)) == []


def test_show_describes_and_draws_an_invalid_test(frenetic: Frenetic) -> None:
    redrawn = ("--strategy", "random,max_redraws=0", "--simulations", "40", "--seed", "3")
    frenetic("run", *redrawn, "--out", "c")
    with CampaignStore.open("c") as store:
        (record,) = store.tests(Outcome.INVALID, limit=1)
    answer = frenetic("show", "c", str(record.candidate.id))
    assert answer.code == 0
    assert "INVALID" in answer.out
    assert len(list(Path("c").rglob(f"*{record.candidate.id:05d}.png"))) == 1


def test_without_failures_run_and_show_list_the_nearest_misses(
    frenetic: Frenetic,
) -> None:
    calm = ("--driver", "aggression=0.3", "--seed", "3", "--workers", "1", "--out", "slow")
    answer = frenetic("run", "--simulations", "20", *calm)
    assert answer.code == 0
    assert "Nothing failed; the nearest misses" in answer.out
    shown, text = frenetic("show", "slow", "--json").json, frenetic("show", "slow").out
    near = shown["near_misses"]
    assert (shown["failed"], shown["distinct_failures"], len(near)) == (0, [], 5)
    assert [miss["moobd"] for miss in near] == sorted(miss["moobd"] for miss in near)
    assert near[0]["moobd"] == shown["min_moobd"]
    assert all(miss["description"] in " ".join(text.split()) for miss in near)
    assert Path("slow/failures/gallery.png").is_file()


UNRELIABLE = """
from dataclasses import replace
from frenetic.errors import Trouble
from frenetic.testing import DummySimulator


class Unreliable(DummySimulator):
    def __init__(self, out: float, every: int) -> None:
        super().__init__(lambda road: out)
        self.out = out
        self.every = every
        self.drives = 0

    def drive(self, road, driver):
        self.drives += 1
        drive = super().drive(road, driver)
        is_broken = self.drives % self.every == 0
        return replace(drive, trouble=Trouble("no connection")) if is_broken else drive
"""


@pytest.mark.parametrize(
    ("out", "every", "broken"),
    [
        (0.0, 1, "The simulator broke in 6 of 6 drives"),
        (0.0, 2, "The simulator broke in 3 of 6 drives"),
        (6.0, 3, "2 of 6 drives"),
    ],
)
def test_headings_say_how_many_drives_broke(
    frenetic: Frenetic, out: float, every: int, broken: str
) -> None:
    Path("unreliable.py").write_text(UNRELIABLE)
    simulator = f"unreliable.py:Unreliable,out={out},every={every}"
    parts = ("--simulator", simulator, "--driver", "stanley")
    search = ("--strategy", "random", "--simulations", "6", "--seed", "3", "--workers", "1")
    run = frenetic("run", *parts, *search, "--out", "c", "--fail-on-failure")
    shown = frenetic("show", "c")
    assert (run.code, shown.code) == (1, 0)
    title = re.search(r"<title>(.*?)</title>", Path("c/report.html").read_text(encoding="utf-8"))
    assert title is not None
    for text in (run.out, shown.out, title[1]):
        assert text.count(broken) == 1
        assert "Nothing failed" not in text
        assert "No failure" not in text


def test_show_lists_tests_by_outcome_severity_and_feature(frenetic: Frenetic, copied: str) -> None:
    failed = frenetic("show", copied, "--json").json["failed"]
    listed = frenetic("show", copied, "--outcome", "fail", "--json").json["listed"]
    assert len(listed) == failed
    assert [row["moobd"] for row in listed] == sorted(row["moobd"] for row in listed)
    bent = frenetic("show", copied, "--feature", "max_curvature=0.06:0.07", "--json").json
    values = [row["features"]["max_curvature"] for row in bent["listed"]]
    assert values == [value for value in values if 0.06 <= value <= 0.07] != []
    table = frenetic("show", copied, "--sort", "bends", "--limit", "3").out.splitlines()
    assert table[0].split()[-2:] == ["bends", "why"]
    assert table[-1].endswith("results match; the first 3 are listed")
