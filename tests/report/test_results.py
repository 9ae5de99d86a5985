"""`frenetic.run` does in one call what the command `frenetic run` does."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import frenetic
from frenetic import Budget, Campaign, EmbeddedSimulator, Frenetic, Planner
from frenetic.campaign import Event
from frenetic.errors import CampaignError, FreneticError
from frenetic.report.results import Step, resume, run

if TYPE_CHECKING:
    from command_line import Frenetic as Command

pytest_plugins = ["command_line"]


def campaign(folder: Path, simulations: int = 80) -> Campaign:
    return Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
        max_in_flight=16,
    )


def files(folder: Path) -> set[str]:
    """Return the names of the results in a folder."""
    return {
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.suffix in (".json", ".png", ".html")
    }


def test_run_writes_the_same_files_as_the_command(frenetic: Command, tmp_path: Path) -> None:
    events: list[Event | Step] = []
    results = run(campaign(tmp_path / "library"), on_event=events.append)
    answer = frenetic(
        *("run", "--simulations", 80, "--seed", 1, "--out", tmp_path / "command", "--json")
    )
    assert files(tmp_path / "library") == files(tmp_path / "command")
    document = answer.json
    assert results.summary is not None
    assert results.summary.failed == document["failed"]
    causes = results.findings.clusters.causes
    assert [cause.failures for cause in causes] == [
        entry["failures"] for entry in document["causes"]
    ]
    assert list(results.notes) == document["notes"]
    for test_id, short in results.shortened.items():
        path = tmp_path / "library" / "minimised" / f"test-{test_id:05d}.json"
        assert json.loads(path.read_text())["curvatures"] == short.road.curvatures.tolist()
    assert results.gallery is not None
    assert results.gallery.is_file()
    assert results.report == tmp_path / "library" / "report.html"
    steps = [event.kind for event in events if isinstance(event, Step)]
    assert steps == ["trying", "shortening", "found", "drawing", "drawn", "reporting", "reported"]
    searching = [event.kind for event in events if isinstance(event, Event)]
    assert searching == ["started", *["result"] * len(searching[1:])]


@pytest.mark.heavy
def test_a_resumed_campaign_has_the_results_of_an_uninterrupted_one(tmp_path: Path) -> None:
    whole = run(campaign(tmp_path / "whole"))
    campaign(tmp_path / "parts").run(30)
    parts = resume(campaign(tmp_path / "parts"))
    assert files(tmp_path / "whole") == files(tmp_path / "parts")
    assert [c.words for c in whole.findings.clusters.causes] == [
        c.words for c in parts.findings.clusters.causes
    ]


def test_results_are_written_when_a_search_ends_with_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search = campaign(tmp_path / "c")

    def run_and_raise(*_: object, **__: object) -> None:
        campaign(tmp_path / "c").run(40)
        search.started = True
        raise CampaignError("the worker was lost")

    monkeypatch.setattr(search, "run", run_and_raise)
    with pytest.raises(CampaignError, match="the worker was lost"):
        run(search)
    assert (tmp_path / "c" / "report.html").is_file()
    assert (tmp_path / "c" / "failures" / "gallery.png").is_file()


def test_a_report_that_cannot_be_written_is_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise FreneticError("the disk is full")

    monkeypatch.setattr("frenetic.report.results.write_report", refuse)
    results = run(campaign(tmp_path / "c"))
    assert results.report is None
    assert results.notes[-1] == "There is no report: the disk is full"


def test_after_slow_drives_the_command_that_shortens_roads_is_a_note(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.report.results.SLOW_DRIVE", 0.0)
    results = run(campaign(tmp_path / "a b"))
    command = f"frenetic minimise {shlex.quote(str(tmp_path / 'a b'))} --top 3"
    assert f"shorter roads for the same failures: {command}" in results.notes
    assert not results.shortened


def test_run_and_resume_are_names_of_the_package() -> None:
    assert frenetic.run is run
    assert frenetic.resume is resume


@pytest.mark.heavy
def test_ctrl_c_in_compiled_code_is_an_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr("frenetic.report.results.write_report", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(campaign(tmp_path / "c"))
