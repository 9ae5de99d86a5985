"""The service for the SDC test competitions, called as their evaluators call it."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import grpc
import pytest

import frenetic.twin.service
from frenetic.drivers import Planner, Stanley
from frenetic.errors import FreneticError
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.simulators import Rules
from frenetic.spec import Part, Spec
from frenetic.twin import Prospect, Twin
from frenetic.twin.profile import Profile
from frenetic.twin.service import CompetitionTool, serving

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

# On the wire, as the evaluator of 2025 wrote them with the code generated from the interface.
ORACLE = (
    b"\n\x1a\n\x02t1\x12\n\x15\x00\x00\xc0?\x1d\x00\x00\x00\xc0\x12\x08\x08\xac\x02\x1d\x00\x00\x80@"
    b"\x10\x01"
)
"""Failed test t1 with the points 0 at (1.5, -2) and 300 at (0, 4)."""
NAME_REPLY, OK_REPLY, ID_REPLY = b"\n\x08frenetic", b"\x08\x01", b"\n\x02t1"

GENTLE = Road([0.0, 0.01, 0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
SHARP = Road([0.0, 0.0, 0.0, 0.0, 0.05, 0.05, 0.05, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def twin() -> Iterator[Twin]:
    with Twin.of(Spec(driver=Part("planner", {"aggression": 3.0}))) as made:
        yield made


def case(name: str, points: Iterable[tuple[float, float]]) -> bytes:
    messages = frenetic.twin.service._messages()
    numbered = [
        messages["RoadPoint"](sequenceNumber=i, x=x, y=y) for i, (x, y) in enumerate(points)
    ]
    numbered.reverse()  # the numbers say the order
    test = messages["SDCTestCase"](testId=name, roadPoints=numbered)
    encoded: bytes = test.SerializeToString()
    return encoded


def points(road: Road) -> list[tuple[float, float]]:
    return [(float(x), float(y)) for x, y in road.road_points]


def test_an_evaluator_is_answered(twin: Twin) -> None:
    tests = [case("gentle", points(GENTLE)), case("sharp", points(SHARP)), case("none", [(0, 0)])]
    with (
        serving(CompetitionTool(twin), port=0) as port,
        grpc.insecure_channel(f"127.0.0.1:{port}") as channel,
    ):
        assert channel.unary_unary("/CompetitionTool/Name")(b"") == NAME_REPLY
        assert channel.stream_unary("/CompetitionTool/Initialize")(iter([ORACLE])) == OK_REPLY
        prioritize = channel.stream_stream("/CompetitionTool/Prioritize")
        assert list(prioritize(iter(tests))) == [b"\n\x05sharp", b"\n\x06gentle", b"\n\x04none"]
        select = channel.stream_stream("/CompetitionTool/Select")
        assert list(select(iter(tests))) == [b"\n\x05sharp"]
        assert list(prioritize(iter([case("t1", points(GENTLE))]))) == [ID_REPLY]
        assert list(prioritize(iter([]))) == []


def known(tool: CompetitionTool, *tests: tuple[float, bool]) -> CompetitionTool:
    """The tool, initialised with tests of this largest share that failed or not."""
    answers = {
        str(i): Prospect(str(i), 90.0, Outcome.PASS, "so", (share, -1.0))
        for i, (share, _) in enumerate(tests)
    }
    tool._prospect = lambda name, points: answers[name]  # type: ignore[method-assign]
    tool.initialize((str(i), None, failed) for i, (_, failed) in enumerate(tests))
    return tool


@pytest.mark.parametrize(
    ("tests", "selected"),
    [
        ([(0.9, True), (0.6, True), (0.5, False), (0.1, False)], ["0", "1"]),
        ([(0.9, True), (0.8, False), (0.3, True), (0.1, False), (0.1, False)], ["0", "1", "2"]),
        ([(0.9, True), (0.8, False), (0.3, True), (0.3, False), (0.1, False)], ["0"]),
        ([(0.9, False), (0.1, False)], ["0"]),  # those that the twin fails, or the first
    ],
)
def test_known_tests_say_from_where_on_is_selected(
    twin: Twin, tests: list[tuple[float, bool]], selected: list[str]
) -> None:
    tool = known(CompetitionTool(twin), *tests)
    assert tool.select((str(i), None) for i in range(len(tests))) == selected


def test_mistakes(twin: Twin, frenetic: Frenetic) -> None:
    with serving(CompetitionTool(twin), port=0) as port:
        answer = frenetic("rank", "--serve", str(port))
    assert answer.refuses(f"cannot listen at 127.0.0.1:{port}", "another port")
    for address in ("no", "70000", "host:", "road.json"):
        assert frenetic("rank", "--serve", address).refuses("is not [HOST:]PORT", "0.0.0.0:4545")
    assert frenetic("rank", "a.json", "--serve", "0").refuses("gets its roads from an evaluator")
    assert frenetic("rank").refuses("Missing argument 'ROADS...'")


def test_the_command_serves_in_the_competitions_setting(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    tools: list[CompetitionTool] = []
    told: list[Any] = []

    def served(tool: CompetitionTool, host: str, port: int) -> Any:
        tools.append(tool)
        told.append((host, port))
        return serving(tool, host, 0)

    monkeypatch.setattr("frenetic.twin.service.serving", served)
    monkeypatch.setattr("frenetic.twin.commands.rank.until_interrupted", lambda: None)
    answer = frenetic("rank", "--json", "--serve")
    assert json.loads(answer.out)["host"] == "127.0.0.1"
    assert told == [("127.0.0.1", 4545)]
    (tool,) = tools
    assert (tool.lane_width, tool.twin.rules.oob_tolerance) == (5.0, 0.5)
    assert tool.twin.rules.speed_limit == 120.0
    assert tool.twin.tester.driver == Planner(
        lateral_acceleration=6.44,
        braking=6.1,
        lookahead_time=0.454,
        lookahead_min=2.19,
        speed_gain=0.517,
    )
    assert frenetic("rank", "--serve", "--driver", "stanley").code == 0  # without its options
    assert tools[-1].twin.tester.driver == Stanley()
    rules = Rules(speed_limit=80.0, oob_tolerance=0.85)
    Profile.of("twin", Spec(driver=Part("stanley"), rules=rules)).write(Path("twin.json"))
    tolerant = ("--as", "twin.json", "--criteria", "oob_tolerance=0.7")
    assert frenetic("rank", *tolerant, "--serve", "0.0.0.0:0").code == 0
    assert told[-1] == ("0.0.0.0", 0)
    assert type(tools[-1].twin.tester.driver).__name__ == "Stanley"
    assert (tools[-1].twin.rules.speed_limit, tools[-1].twin.rules.oob_tolerance) == (80.0, 0.7)


def test_without_grpc_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "grpc", None)
    monkeypatch.delitem(sys.modules, "frenetic.twin.service")
    with pytest.raises(FreneticError, match=r'pip install "\.\[service\]"'):
        importlib.import_module("frenetic.twin.service")
