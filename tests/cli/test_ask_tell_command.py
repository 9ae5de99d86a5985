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
from frenetic.campaign.ask_tell import ClientCampaign
from frenetic.campaign.check import check_campaign
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.oracle.outcome import Outcome
from frenetic.report.html import write_report
from frenetic.search import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, Strategy
from frenetic.spec import Budget

CLIENT = Path(__file__).with_name("client.js")


class Client:
    """Sends requests to the command, which runs in another process."""

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
        return self.call(tell={"id": road["id"], **(result or sample_result(road))})

    def end(self) -> dict[str, Any]:
        summary: dict[str, Any] = self.call(end={})["summary"]
        self.process.communicate()
        assert self.process.returncode == 0
        return summary

    def kill(self) -> None:
        self.process.kill()
        self.process.communicate()


def sample_result(road: dict[str, Any]) -> dict[str, Any]:
    """A result that depends on the road alone; every other road has records of a drive, too."""
    moobd = 1.5 - 40.0 * max(map(abs, road["curvatures"]))
    result = {"outcome": "FAIL" if moobd < -0.5 else "PASS", "moobd": moobd, "duration": 20.0}
    if road["id"] % 2:
        x, y = zip(*road["points"], strict=True)
        time = [0.2 * i for i in range(len(x))]
        result["records"] = {"time": time, "x": x, "y": y, "speed": [9.0] * len(x)}
    return result


def test_ask_hands_out_the_strategys_roads_and_leaves_a_usual_campaign(tmp_path: Path) -> None:
    client = Client(
        tmp_path / "search", "--seed", "3", "--strategy", "random", "--simulations", "12"
    )
    reported = 0
    while "candidate" in (answer := client.call(ask={})):
        assert client.tell(answer["candidate"])["told"] == answer["candidate"]["id"]
        reported += 1
    assert answer == {"end": "the budget is spent"}
    assert client.call(ask={}) == answer
    assert "not outstanding" in client.tell({"id": 1}, outcome="PASS")["error"]
    summary = client.end()
    assert reported == summary["simulations"] == 12

    folder = tmp_path / "search"
    strategy = RandomSearch(seed=3)
    with CampaignStore.open(folder) as store:
        tests = list(store.tests(with_trajectory=True))
        assert store.config["driver"]["options"] == {"name": "client"}  # type: ignore[index, call-overload]
    for test in tests:
        assert test.candidate.curvatures.tolist() == strategy.ask().curvatures.tolist()
        assert (test.outcome is Outcome.INVALID) or (test.trajectory is None) == (test.id % 2 == 0)
    assert sum(test.outcome is Outcome.FAIL for test in tests) == summary["failed"] > 0
    assert not check_campaign(folder).findings
    assert write_report(folder).is_file()


LOUD = """
from frenetic import RandomSearch
print("imported")

class Loud(RandomSearch):
    def ask(self):
        print("asked")
        return super().ask()
"""


def test_foresight_says_that_it_does_not_know_the_clients_driver(tmp_path: Path) -> None:
    client = Client(tmp_path / "c", "--strategy", "foresight", "--simulations", "2", "--seed", "1")
    client.tell(client.road())
    client.end()
    with CampaignStore.open(tmp_path / "c") as store:
        facts: Any = store.fact(SEARCH_FACTS)
    assert facts["your driver does not drive in the twin"] == "somebody else drives"


def test_an_unusable_request_is_answered_and_changes_nothing(tmp_path: Path) -> None:
    """What the strategy prints is not taken for an answer."""
    (tmp_path / "loud.py").write_text(LOUD, encoding="utf-8")
    client = Client(tmp_path / "search", "--strategy", f"{tmp_path}/loud.py:Loud")
    road, *others = [client.road() for _ in range(4)]
    assert len({candidate["id"] for candidate in (road, *others)}) == 4
    result = {"id": road["id"], "outcome": "FAIL"}
    for request, error in (
        ({"tell": {"id": 99, "outcome": "PASS"}}, "candidate 99 is not outstanding"),
        ({"tell": result | {"outcome": "MAYBE"}}, "$.outcome"),
        ({"tell": result | {"moobd": 1e999}}, "`$.moobd`"),
        ({"tell": result | {"moobd": -1e308}}, "`$.moobd`"),
        ({"tell": result | {"where": 3}}, "`where`"),
        (
            {"tell": result | {"records": {"time": [0.0], "x": [], "y": [], "speed": []}}},
            "lists of one length",
        ),
        ({"drive": {}}, "unknown request 'drive'"),
        (
            {
                "tell": result
                | {"records": {"time": [2, 1], "x": [0, 0], "y": [0, 0], "speed": [0, 0]}}
            },
            "the time of records has to increase",
        ),
        (
            {"tell": result | {"records": {"time": [0], "x": [1e300], "y": [0], "speed": [0]}}},
            "x of record 0 is 1e+300",
        ),
        ({"tell": result | {"side": "left"}}, "needs the place"),
        ({"ask": {}, "tell": {}}, "an object with one entry"),
        ({}, "an object with one entry"),
        ({"ask": 1}, "Expected `object`"),
        ({"validate": {}}, "missing required field `points`"),
        ({"validate": {"points": [[0.0]]}}, "`array` of length 2"),
    ):
        answer = client.call(**request)
        assert error in answer["error"], (request, answer)
        assert "\n" not in answer["error"]
    verdict = client.call(validate={"points": [[20, 20], [20, 120]]})
    assert verdict == {"valid": True, "message": ""}
    assert client.call(validate={"points": [[20, 20], [20, 320]]})["valid"] is False
    for candidate in (*reversed(others), road):  # in any order
        assert client.tell(candidate)["told"] == candidate["id"]
    assert client.end()["simulations"] == 4


def test_an_unreadable_line_is_answered_and_changes_nothing(tmp_path: Path) -> None:
    lines = [
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b'{"tell": ' + b"[" * 500 + b"]" * 500 + b"}",
        b"(" * 10_000,
        b'{"ask": ' + b"1" * 5_000 + b"}",
        b"\xff\xfe",
        b"\x00",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "frenetic", "ask-tell", "--out", str(tmp_path / "search")],
        input=b"\n".join([*lines, b'{"end": {}}\n']),
        env=os.environ | {"PYTHONIOENCODING": "utf-8:strict"},
        capture_output=True,
    )
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
    *answers, end = map(json.loads, done.stdout.splitlines())
    assert len(answers) == len(lines)
    for answer in answers:
        assert "cannot be read as JSON: " in answer["error"]
        assert len(answer["error"]) < 300
    assert end["summary"]["tests"] == 0


@pytest.mark.heavy
def test_with_a_domain_each_road_has_conditions(tmp_path: Path) -> None:
    file = tmp_path / "town.toml"
    file.write_text(
        'roads = "urban-50,length=300"\n[conditions]\nfriction = { low = 0.3, high = 0.5 }\n'
        "fog = { low = 20, high = 60 }\ngust = 9\n"
    )
    client = Client(tmp_path / "search", "--odd", str(file), "--seed", "3")
    roads = [client.road() for _ in range(3)]
    for road in roads:
        conditions = road["conditions"]
        assert conditions.keys() == {"friction", "fog", "gust", "gust_at"}
        assert 0.3 <= conditions["friction"] <= 0.5
        assert road["lane_width"] == 3.25, "the lane width of the class"
        client.tell(road)
    client.end()
    with CampaignStore.open(tmp_path / "search") as store:
        assert [dict(test.candidate.conditions) for test in store.tests()] == [
            road["conditions"] for road in roads
        ]
        assert (store.setting.rules.speed_limit, store.setting.map_size) == (50.0, 400.0)
        assert store.setting.domain is not None
    assert not check_campaign(tmp_path / "search").findings


@pytest.mark.heavy
def test_after_a_kill_the_search_goes_on_with_the_same_roads(tmp_path: Path) -> None:
    options = ("--seed", "5", "--simulations", "20")
    roads: dict[str, list[dict[str, Any]]] = {"whole": [], "part": []}
    for name, stop in (("whole", 99), ("part", 8), ("part", 99)):
        client, received = Client(tmp_path / name, *options), roads[name]
        while "candidate" in (answer := client.call(ask={})):
            if len(received) == stop:
                break  # before the result of this road is sent
            received.append(answer["candidate"])
            client.tell(answer["candidate"])
        client.kill()
    assert roads["part"] == roads["whole"]


@pytest.mark.heavy
def test_results_that_came_before_an_older_roads_result_survive_a_kill(tmp_path: Path) -> None:
    folder, options = tmp_path / "search", ("--seed", "5", "--simulations", "20")
    client = Client(folder, *options)
    oldest, *others = [client.road() for _ in range(3)]
    for road in others:
        assert client.tell(road)["told"] == road["id"]
    client.kill()
    client = Client(folder, *options)
    assert client.road() == oldest, "only this road has no result"
    client.tell(oldest)
    assert client.road()["id"] == 4
    assert client.end()["simulations"] == 3
    with CampaignStore.open(folder) as store:
        moobds = {test.id: test.moobd for test in store.tests()}
    assert moobds == {road["id"]: sample_result(road)["moobd"] for road in (oldest, *others)}
    assert not [*(folder / "waiting").iterdir()]


class OneByOne(Strategy):
    """Proposes a road only after the result of the road before, and ends after three."""

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


def test_a_strategy_may_wait_for_a_result(tmp_path: Path) -> None:
    answers: list[Any] = []

    def requests() -> Iterator[str]:
        yield json.dumps({"ask": {}})
        yield json.dumps({"ask": {}})
        for _ in range(3):
            number = next(a["candidate"]["id"] for a in reversed(answers) if "candidate" in a)
            yield json.dumps({"tell": {"id": number, "outcome": "PASS", "moobd": 1.0}})
            yield json.dumps({"ask": {}})

    campaign = ClientCampaign(
        requests(),
        answers.append,
        strategy=OneByOne(),
        budget=Budget(simulations=9),
        folder=tmp_path / "search",
    )
    summary = campaign.serve()
    kinds = [next(iter(answer)) for answer in answers]
    answers_to_two_roads = 2 * ["told", "candidate"]
    assert kinds == ["candidate", "wait", *answers_to_two_roads, "told", "end", "summary"]
    assert summary.ended == "three are enough"


@pytest.mark.heavy
@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_the_client_in_javascript_runs(tmp_path: Path) -> None:
    """The client in Python runs with the page that shows it."""
    done = subprocess.check_output(["node", CLIENT], cwd=tmp_path, text=True)
    assert re.fullmatch(r"[1-9]\d* failures", done.strip())
    with CampaignStore.open(tmp_path / "told-js") as store:
        assert store.counts().simulations == 40


@pytest.mark.heavy
def test_a_reported_share_of_the_budget_replaces_the_count_also_after_a_kill(
    tmp_path: Path,
) -> None:
    """A result without MOOBD is stored, too."""
    folder = tmp_path / "search"
    options = ("--simulations", "2", "--seed", "3")
    client = Client(folder, *options)
    for number in range(12):  # more than --simulations, and more errors than end a usual search
        road = client.road()
        answer = client.tell(road, outcome="ERROR", reason="so", budget_spent=0.05 * number)
        assert answer["budget_spent"] == pytest.approx(0.05 * number)
    client.kill()

    client = Client(folder, *options)
    assert client.road()["id"] == 13
    assert "`float` <= 1.0" in client.tell({"id": 13}, outcome="PASS", budget_spent=1.5)["error"]
    assert client.tell({"id": 13}, outcome="PASS")["budget_spent"] == pytest.approx(0.55)
    client.tell(client.road(), outcome="FAIL", budget_spent=1.0)
    assert client.call(ask={}) == {"end": "the budget is spent"}
    summary = client.end()
    assert (summary["simulations"], summary["interrupted"]) == (14, False)
    with CampaignStore.open(folder) as store:
        tests = list(store.tests())
    assert [test.budget_spent for test in tests][-3:] == pytest.approx([0.55, 0.55, 1])
    assert {test.moobd for test in tests} == {None}
    assert not check_campaign(folder).findings
    assert write_report(folder).is_file()
