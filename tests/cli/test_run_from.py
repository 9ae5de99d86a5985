"""Searches that start from earlier campaigns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

OPTIONS = ("--simulations", "30", "--workers", "1", "--seed", "9")


def test_run_show_and_report_name_the_campaign_that_a_search_starts_from(
    frenetic: Frenetic, copied: str
) -> None:
    answer = frenetic("run", *OPTIONS, "--from", copied, "--out", "next")
    assert answer.code == 0
    start = f"starts from {copied} ("
    assert f"Note: {start}" in answer.err
    assert " driven again still failed" in answer.out
    assert " known before" in answer.out
    shown = " ".join(frenetic("show", "next").out.split())
    assert start in shown
    assert "known before" in shown
    document = frenetic("show", "next", "--json").json
    (earlier,) = document["config"]["start_from"]
    assert earlier["folder"] == copied
    assert any(failure["was_known"] for failure in document["distinct_failures"])
    report = Path("next/report.html").read_text(encoding="utf-8")
    assert start.removeprefix("starts from ") in report
    assert "known before" in report
    first = " ".join(frenetic("show", "next", "1").out.split())
    assert "origin earlier, the road of test " in first
    assert f" of {copied}, generation 0" in first
