"""The gRPC service of the SDC test selection (2025) and prioritisation (2026) competitions.

A competition's evaluator calls ``CompetitionTool``: `Name`; `Initialize` with tests whose outcome
is known; then `Select`, which gives back the tests worth driving, or `Prioritize`, which gives back
all of them in order. The messages are made here, field by field as the competition's interface
numbers them, so nothing has to be generated.

The twin ranks. The tests that it is initialised with only say from which score on a test is
selected: the one that best tells failed tests from passed ones (Youden's index). Without such
tests, those are selected that the twin fails itself.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from typing import Any, Final

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError, RoadError
from frenetic.outcome import Outcome
from frenetic.road import Road
from frenetic.twin.ranking import Prospect, Twin, rank

try:
    import grpc
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
except ImportError:
    raise FreneticError(f"the competitions' service needs gRPC: {pip_install('service')}") from None

logger = logging.getLogger(__name__)

SERVICE: Final = "CompetitionTool"
_MESSAGES: Final = {
    "Empty": (),
    "NameReply": (("name", "string"),),
    "RoadPoint": (("sequenceNumber", "int64"), ("x", "float"), ("y", "float")),
    "SDCTestCase": (("testId", "string"), ("roadPoints", "repeated RoadPoint")),
    "Oracle": (("testCase", "SDCTestCase"), ("hasFailed", "bool")),
    "InitializationReply": (("ok", "bool"),),
    "SelectionReply": (("testId", "string"),),
    "PrioritizationReply": (("testId", "string"),),
}
"""Message -> its fields with their types, numbered from 1 on."""


def _messages() -> dict[str, Any]:
    """The classes of the messages."""
    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="sdc_competition.proto", syntax="proto3")
    for name, entries in _MESSAGES.items():
        message = file.message_type.add(name=name)
        for number, (entry, kind) in enumerate(entries, 1):
            is_repeated = kind.startswith("repeated ")
            kind = kind.removeprefix("repeated ")
            is_message = kind in _MESSAGES
            message.field.add(
                name=entry,
                number=number,
                label=kinds.LABEL_REPEATED if is_repeated else kinds.LABEL_OPTIONAL,
                type=kinds.TYPE_MESSAGE if is_message else getattr(kinds, f"TYPE_{kind.upper()}"),
                type_name=kind if is_message else None,
            )
    pool = descriptor_pool.DescriptorPool()  # of its own: others may define the same names
    pool.Add(file)
    return {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
        for name in _MESSAGES
    }


@dataclass
class CompetitionTool:
    """The competitions' tool: answers the calls of an evaluator, one at a time."""

    twin: Twin
    name: str = "frenetic"
    lane_width: float = 5.0
    """m, of each lane."""
    threshold: tuple[float, float] | None = None
    """Score of a `Prospect` from which on a test is selected, None until it is initialised with
    failed and passed tests."""
    _one_call: Lock = field(default_factory=Lock)

    def initialize(self, known: Iterable[tuple[str, Any, bool]]) -> None:
        """Learns from (test's id, (N, 2) points in m, whether it failed) the threshold."""
        with self._one_call:
            tests = [(self._prospect(name, points), failed) for name, points, failed in known]
            self.threshold = _threshold(tests)
        logger.info("%s tests known, threshold %s", len(tests), self.threshold)

    def select(self, tests: Iterable[tuple[str, Any]]) -> list[str]:
        """The ids of the tests that are worth driving, the most promising first.

        At least one, so that the competition's ratios exist.
        """
        ranked = self._ranked(tests)
        chosen = [
            one.name
            for one in ranked
            if (
                one.outcome is Outcome.FAIL
                if self.threshold is None
                else one.score is not None and one.score >= self.threshold
            )
        ]
        return chosen or [one.name for one in ranked[:1]]

    def prioritize(self, tests: Iterable[tuple[str, Any]]) -> list[str]:
        """The ids of all tests, the most promising first."""
        return [one.name for one in self._ranked(tests)]

    def _ranked(self, tests: Iterable[tuple[str, Any]]) -> list[Prospect]:
        with self._one_call:
            return [one for one, _ in rank(self._prospect(*test) for test in tests)]

    def _prospect(self, name: str, points: Any) -> Prospect:
        try:
            road = Road.from_points(points, lane_width=self.lane_width)
        except RoadError as error:
            return Prospect(name, 0.0, Outcome.INVALID, str(error))
        return self.twin.prospect(name, road, anyway=True)


def _threshold(tests: Iterable[tuple[Prospect, bool]]) -> tuple[float, float] | None:
    """The least score of a selected test that maximises Youden's index; None without failures."""
    scored = [(one.score, failed) for one, failed in tests if one.score is not None]
    failures = sum(failed for _, failed in scored)
    passes = len(scored) - failures
    if not failures or not passes:
        return None

    def youden(least: tuple[float, float]) -> float:
        selected = [failed for score, failed in scored if score >= least]
        return sum(selected) / failures - selected.count(False) / passes

    # Of equal ones the largest.
    return max(sorted({score for score, _ in scored}, reverse=True), key=youden)


@contextmanager
def serving(tool: CompetitionTool, host: str = "127.0.0.1", port: int = 4545) -> Iterator[int]:
    """Serves the tool; gives the port, which is another one if ``port`` is 0.

    Raises:
        FreneticError: the port cannot be had.
    """
    # Two servers would share a port otherwise.
    options = [("grpc.so_reuseport", 0)]
    server = grpc.server(ThreadPoolExecutor(max_workers=4), options=options)
    server.add_generic_rpc_handlers((_handlers(tool),))
    place = f"[{host}]" if ":" in host else host
    try:
        bound = server.add_insecure_port(f"{place}:{port}")
    except RuntimeError:
        bound = 0
    if not bound:
        raise FreneticError(f"cannot listen at {place}:{port}: is it taken? choose another port")
    server.start()
    try:
        yield bound
    finally:
        server.stop(None).wait()


def _handlers(tool: CompetitionTool) -> Any:
    """The calls of the service, from and to its messages."""
    messages = _messages()

    def test_of(case: Any) -> tuple[str, list[tuple[float, float]]]:
        ordered = sorted(case.roadPoints, key=lambda point: point.sequenceNumber)
        return case.testId, [(point.x, point.y) for point in ordered]

    def name(_: Any, __: Any) -> Any:
        return messages["NameReply"](name=tool.name)

    def initialize(oracles: Any, _: Any) -> Any:
        tool.initialize((*test_of(one.testCase), one.hasFailed) for one in oracles)
        return messages["InitializationReply"](ok=True)

    def call(request: str, reply: str, answer: Callable[[Any, Any], Any]) -> Any:
        kind = {"Empty": "unary_unary", "Oracle": "stream_unary"}.get(request, "stream_stream")
        make = getattr(grpc, f"{kind}_rpc_method_handler")
        return make(answer, messages[request].FromString, messages[reply].SerializeToString)

    def ids(reply: str, choose: Callable[[Iterable[tuple[str, Any]]], list[str]]) -> Any:
        def answer(cases: Any, _: Any) -> Iterator[Any]:
            return (messages[reply](testId=one) for one in choose(map(test_of, cases)))

        return call("SDCTestCase", reply, answer)

    calls = {
        "Name": call("Empty", "NameReply", name),
        "Initialize": call("Oracle", "InitializationReply", initialize),
        "Select": ids("SelectionReply", tool.select),
        "Prioritize": ids("PrioritizationReply", tool.prioritize),
    }
    return grpc.method_handlers_generic_handler(SERVICE, calls)
