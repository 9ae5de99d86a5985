"""The search for a simulator that somebody else runs: JSON lines on stdin and stdout."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from frenetic import CampaignStore, RandomSearch
from frenetic.campaign.asktell import ToldCampaign
from frenetic.campaign.check import check_campaign
from frenetic.outcome import Outcome
from frenetic.report.html import write_report
from frenetic.search import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, Strategy
from frenetic.spec import Budget

PAGE = Path(__file__).parents[2] / "docs" / "ask-tell.md"


class Client:
    """Sends requests to a command in a process of its own."""

    def __init__(self, folder: Path, *options: str) -> None:
        words = [sys.executable, "-m", "frenetic", "ask-tell", "--out", str(folder), *options]
        self.process = subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def call(self, **request: Any) -> dict[str, Any]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(json.dumps(request) + "\n")
        self.process.stdin.flush()
        answer: dict[str, Any] = json.loads(self.process.stdout.readline())
        return answer

    def road(self) -> dict[str, Any]:
        candidate: dict[str, Any] = self.call(ask={})["candidate"]
        return candidate

    def tell(self, road: dict[str, Any], **result: Any) -> dict[str, Any]:
        return self.call(tell={"id": road["id"], **(result or made_up(road))})

    def end(self) -> dict[str, Any]:
        summary: dict[str, Any] = self.call(end={})["summary"]
        self.process.communicate()
        assert self.process.returncode == 0
        return summary

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


def made_up(road: dict[str, Any]) -> dict[str, Any]:
    """A result that depends on the road alone, every other time with the drive."""
    moobd = 1.5 - 40.0 * max(map(abs, road["curvatures"]))
    told = {"outcome": "FAIL" if moobd < -0.5 else "PASS", "moobd": moobd, "duration": 20.0}
    if road["id"] % 2:
        x, y = zip(*road["points"], strict=True)
        time = [0.2 * i for i in range(len(x))]
        told["records"] = {"time": time, "x": x, "y": y, "speed": [9.0] * len(x)}
    return told


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    made = Client(tmp_path / "told", "--seed", "3", "--strategy", "random", "--simulations", "12")
    yield made
    if made.process.returncode is None:
        made.kill()


def test_roads_are_the_strategys_and_the_campaign_is_like_any_other(
    client: Client, tmp_path: Path
) -> None:
    told = 0
    while "candidate" in (answer := client.call(ask={})):
        assert client.tell(answer["candidate"])["told"] == answer["candidate"]["id"]
        told += 1
    assert answer == {"end": "the budget is spent"}
    assert client.call(ask={}) == answer
    assert "not outstanding" in client.tell({"id": 1}, outcome="PASS")["error"]
    summary = client.end()
    assert told == summary["simulations"] == 12

    folder = tmp_path / "told"
    alone = RandomSearch(seed=3)
    with CampaignStore.open(folder) as store:
        tests = list(store.tests(with_trajectory=True))
        assert store.config["driver"]["options"] == {"name": "told"}  # type: ignore[index, call-overload]
    for test in tests:
        assert test.candidate.curvatures.tolist() == alone.ask().curvatures.tolist()
        assert (test.outcome is Outcome.INVALID) or (test.trajectory is None) == (test.id % 2 == 0)
    assert sum(test.outcome is Outcome.FAIL for test in tests) == summary["failed"] > 0
    assert check_campaign(folder).is_sound
    assert write_report(folder).is_file()


def test_what_cannot_be_used_is_answered_and_changes_nothing(client: Client) -> None:
    road = client.road()
    for request, fault in (
        ({"tell": {"id": 99, "outcome": "PASS"}}, "candidate 99 is not outstanding"),
        ({"tell": {"id": road["id"], "outcome": "MAYBE"}}, "$.outcome"),
        ({"tell": {"id": road["id"], "outcome": "FAIL", "moobd": 1e999}}, "JSON is malformed"),
        ({"tell": {"id": road["id"], "outcome": "FAIL", "moobd": -1e308}}, "`$.moobd`"),
        ({"tell": {"id": road["id"], "outcome": "FAIL", "where": 3}}, "`where`"),
        ({"tell": {"id": road["id"], "outcome": "PASS", "records": {"time": [0.0], "x": [], "y": [],
          "speed": []}}}, "lists of one length"),
        ({"drive": {}}, "unknown request 'drive'"),
        ({"ask": {}, "tell": {}}, "too many values"),
        ({"validate": {"points": [[0.0]]}}, "`array` of length 2"),
    ):  # fmt: skip
        answer = client.call(**request)
        assert fault in answer["error"], (request, answer)
        assert "\n" not in answer["error"]
    verdict = client.call(validate={"points": [[20, 20], [20, 120]]})
    assert verdict == {"valid": True, "message": ""}
    assert client.call(validate={"points": [[20, 20], [20, 320]]})["valid"] is False
    assert client.tell(road)["told"] == road["id"]
    assert client.end()["simulations"] == 1


def test_killed_it_goes_on_with_the_same_roads(tmp_path: Path) -> None:
    options = ("--seed", "5", "--simulations", "30")
    whole = Client(tmp_path / "whole", *options)
    wanted = []
    while "candidate" in (answer := whole.call(ask={})):
        wanted.append(answer["candidate"])
        whole.tell(answer["candidate"])
    whole.end()

    got: list[dict[str, Any]] = []
    for stop in (8, 20, 99):
        part = Client(tmp_path / "part", *options)
        while "candidate" in (answer := part.call(ask={})):
            if len(got) == stop:
                break  # this one was handed out, and is not told
            got.append(answer["candidate"])
            part.tell(answer["candidate"])
        part.kill()
    assert got == wanted


def test_several_are_asked_before_one_is_told_in_any_order(client: Client) -> None:
    roads = [client.road() for _ in range(4)]
    assert len({road["id"] for road in roads}) == 4
    for road in reversed(roads):
        client.tell(road)
    assert client.end()["simulations"] == 4


def test_a_result_without_moobd_is_kept_and_teaches_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "told"
    client = Client(folder, "--seed", "1", "--simulations", "6")
    for number in range(6):
        client.tell(client.road(), outcome="FAIL" if number % 2 else "ERROR", reason="so it was")
    summary = client.end()
    assert (summary["failed"], summary["errors"]) == (3, 3)
    with CampaignStore.open(folder) as store:
        assert {test.moobd for test in store.tests()} == {None}
    assert check_campaign(folder).is_sound
    assert write_report(folder).is_file()


def test_what_a_strategy_prints_is_no_answer(tmp_path: Path) -> None:
    loud = tmp_path / "loud.py"
    loud.write_text(
        "from frenetic import RandomSearch\nprint('imported')\nclass Loud(RandomSearch):\n"
        "    def ask(self):\n        print('asked')\n        return super().ask()\n",
        encoding="utf-8",
    )
    client = Client(tmp_path / "told", "--strategy", f"{loud}:Loud")
    client.tell(client.road())
    assert client.end()["simulations"] == 1


class OneByOne(Strategy):
    """Wants to be told each result before it proposes the next road, and ends after three."""

    def __init__(self) -> None:
        self.ledger = Ledger()
        self.search = RandomSearch(seed=2)

    def ask(self) -> Candidate | None:
        from frenetic.search import SearchEnded

        if len(self.ledger):
            return None
        if self.ledger.issued == 3:
            raise SearchEnded("three are enough")
        return self.ledger.issue(self.search.ask().curvatures, 10.0, Origin("mine"))

    def tell(self, evaluation: Evaluation) -> None:
        self.ledger.settle(evaluation)


def test_a_strategy_may_want_to_be_told_first(tmp_path: Path) -> None:
    answers: list[Any] = []

    def requests() -> Iterator[str]:
        yield json.dumps({"ask": {}})
        yield json.dumps({"ask": {}})
        for _ in range(3):
            number = next(a["candidate"]["id"] for a in reversed(answers) if "candidate" in a)
            yield json.dumps({"tell": {"id": number, "outcome": "PASS", "moobd": 1.0}})
            yield json.dumps({"ask": {}})

    campaign = ToldCampaign(
        requests(),
        answers.append,
        strategy=OneByOne(),
        budget=Budget(simulations=9),
        folder=tmp_path / "told",
    )
    summary = campaign.serve()
    kinds = [next(iter(answer)) for answer in answers]
    told = ["told", "candidate"]
    assert kinds == ["candidate", "wait", *told, *told, "told", "end", "summary"]
    assert summary.ended == "three are enough"


@pytest.mark.parametrize("language", ["python", "javascript"])
def test_the_clients_of_the_page_run(language: str, tmp_path: Path) -> None:
    program = sys.executable if language == "python" else shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")
    (code,) = re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)
    file = tmp_path / ("client.py" if language == "python" else "client.js")
    file.write_text(code, encoding="utf-8")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        [program, str(file)],
        cwd=tmp_path,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert re.fullmatch(r"[1-9]\d* failures", done.stdout.strip())
    folder = tmp_path / ("told" if language == "python" else "told-js")
    with CampaignStore.open(folder) as store:
        assert store.counts().simulations == 40


def test_a_told_share_replaces_the_count_also_after_a_crash(tmp_path: Path) -> None:
    folder = tmp_path / "told"
    options = ("--simulations", "2", "--seed", "3")
    client = Client(folder, *options)
    for number in range(12):  # more drives than counted, and more that broke than are borne
        road = client.road()
        answer = client.tell(road, outcome="ERROR", budget_spent=0.05 * number)
        assert answer["budget_spent"] == pytest.approx(0.05 * number)
    client.kill()

    client = Client(folder, *options)
    assert client.road()["id"] == 13
    assert "`float` <= 1.0" in client.tell({"id": 13}, outcome="PASS", budget_spent=1.5)["error"]
    assert client.tell({"id": 13}, outcome="PASS", moobd=1.0)["budget_spent"] == pytest.approx(0.55)
    client.tell(client.road(), outcome="PASS", moobd=1.0, budget_spent=1.0)
    assert client.call(ask={}) == {"end": "the budget is spent"}
    summary = client.end()
    assert (summary["simulations"], summary["interrupted"]) == (14, False)
    with CampaignStore.open(folder) as store:
        assert [test.budget_spent for test in store.tests()][-3:] == pytest.approx([0.55, 0.55, 1])
    assert check_campaign(folder).is_sound
