"""The search for a simulator that somebody else runs: requests and answers, one JSON object each.

The campaign searches and stores like any other, but a client asks for its roads and drives them:

| request | answer |
| --- | --- |
| ``{"ask": {}}`` | ``{"candidate": {..}}``, ``{"wait": true}`` or ``{"end": reason}`` |
| ``{"tell": {"id": 1, "outcome": "FAIL", ..}}`` | ``{"told": 1, "budget_spent": 0.01}`` |
| ``{"validate": {"points": [[x, y], ..]}}`` | ``{"valid": false, "message": ".."}`` |
| ``{"end": {}}``, or the end of the input | ``{"summary": {..}}`` |

A candidate has

- ``id``,
- ``points`` on the map in m, at most 2 m apart,
- ``curvatures`` in 1/m and their ``step`` in m,
- ``pose`` of the first point, and ``lane_width`` in m,
- profiles, if the road is not flat,
- ``conditions``: names of `frenetic.conditions` with amounts, empty without a domain.

The client gets valid roads only, and may ask for several before it tells a result; ``wait`` means
that it has to tell a result first. The search learns the results in the order of asking.
`frenetic.campaign.client_messages.ClientResult` is the form of a result. An unusable request is
answered with ``{"error": ".."}`` and changes nothing.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Self

from msgspec import ValidationError, convert, json

from frenetic._support.files import write_file
from frenetic._support.outside_text import read_json
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.client_messages import (
    ClientResult,
    EmptyRequest,
    read_request,
    validity_answer,
)
from frenetic.campaign.database import DATABASE
from frenetic.campaign.log import CampaignLog
from frenetic.campaign.record import Attempt
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event, Summary
from frenetic.campaign.tester import RoadTester, fitted
from frenetic.campaign.workers import Workers
from frenetic.conditions.domain import Domain
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.drive import CarBody, Drive, Rules
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.road.files import entries_of
from frenetic.search.records import Candidate
from frenetic.simulators.simulator import Ready

WAITING: Final = "waiting"
"""Folder in a campaign's folder for results that wait for an older candidate's result."""
_MOST_ERROR_CHARACTERS: Final = 500
"""Largest number of characters of the text in an answer about an error (our choice)."""


@dataclass(frozen=True)
class ClientDriver:
    """A stand-in for the client's driver, which drives elsewhere."""

    BEHAVIOUR: ClassVar[int] = 1

    name: str = "client"
    """Name of the client's driver and simulator, for the campaign's configuration."""

    def reset(self, setup: DriveSetup) -> None:
        """Do nothing: the client drives."""

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002 - a driver's
        """Raise an error: the client drives.

        Raises:
            CampaignError: always.
        """
        raise CampaignError("a client drives: its driver cannot act here")


class ClientSimulator(Ready):
    """A stand-in for the client's simulator, which takes any road in any conditions.

    The configuration of stored campaigns names this class and its module.

    Args:
        rules: rules by which the client judges drives, for the campaign's configuration.
    """

    BEHAVIOUR: ClassVar[int] = 1
    lays_slopes: Final = True

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules, self.car = rules or Rules(), CarBody()

    def drive(self, road: Road, driver: Driver) -> Drive:  # noqa: ARG002
        """Raise an error: the client drives.

        Raises:
            CampaignError: always.
        """
        raise CampaignError("a client drives: its simulator cannot drive here")


class _ClientWorkers(Workers):
    """A client as the workers of a campaign: it takes candidates and returns results.

    Args:
        tester: tester with the terms by which roads are fitted into the map.
        requests: lines of the client, each with a request.
        answer: function that sends an answer to the client.
        folder: folder for results that came before an older candidate's result: the store takes
            results in the order of asking.
    """

    def __init__(
        self,
        tester: RoadTester,
        requests: Iterator[str],
        answer: Callable[[Any], None],
        folder: Path,
    ) -> None:
        self._tester = tester
        self._requests = requests
        self._answer = answer
        self._folder = folder
        self._open_asks = 0  # requests for a candidate without an answer
        self._known: deque[Attempt] = deque()  # attempts that need no client
        # Id of a candidate that the client has -> its road, and when it was sent, in s.
        self._running: dict[int, tuple[Road, float]] = {}
        self._open_tells: set[int] = set()  # ids of candidates whose results have no answer
        self._budget_spent = 0.0
        self.has_ended = False
        """Whether the client sends no further request."""

    @property
    def free(self) -> int:
        return self._open_asks

    def answer_tell(self, candidate_id: int, budget_spent: float) -> None:
        """Answer that a result has arrived, unless that was answered."""
        self._budget_spent = budget_spent
        if candidate_id in self._open_tells:
            self._open_tells.remove(candidate_id)
            self._answer({"told": candidate_id, "budget_spent": budget_spent})

    def note_stored(self, candidate_id: int, budget_spent: float) -> None:
        """Answer the client about a stored result, and delete the file in which it waited."""
        self._early_file(candidate_id).unlink(missing_ok=True)
        self.answer_tell(candidate_id, budget_spent)

    def _write_early(self, result: ClientResult) -> None:
        """Write a result to a file where it waits until an older candidate's result is stored.

        Raises:
            FreneticError: the file cannot be written.
        """
        with suppress(OSError):  # if the campaign's folder is gone, it is not created again
            self._folder.mkdir(exist_ok=True)
        write_file(self._early_file(result.id), json.encode(result), remedy="make room")

    def _early_file(self, candidate_id: int) -> Path:
        return self._folder / f"{candidate_id}.json"

    def take_asks(self) -> int:
        """Return the number of requests for a candidate that the caller has to answer now."""
        open_asks, self._open_asks = self._open_asks, 0
        return open_asks

    def submit(self, candidate: Candidate) -> None:
        road, verdict = fitted(candidate, self._tester.terms)
        if road is None or not verdict.valid:
            self._known.append(Attempt.undriven(candidate.id, Outcome.INVALID, verdict.message))
            return
        # After a crash a resumed campaign finds early results; other candidates have no file.
        with suppress(OSError, ValueError):
            result = read_json(self._early_file(candidate.id).read_bytes(), ClientResult)
            self._known.append(result.attempt(road, seconds=0.0))
            return
        self._open_asks -= 1
        self._running[candidate.id] = road, time.perf_counter()
        self._answer(
            {
                "candidate": {
                    "id": candidate.id,
                    "points": road.road_points.round(6).tolist(),
                    **entries_of(road),
                    "conditions": dict(candidate.conditions),
                }
            }
        )

    def wait(self, timeout: float) -> Sequence[Attempt]:  # noqa: ARG002 - the client decides
        if self._known:
            return [self._known.popleft()]
        for candidate_id in sorted(self._open_tells):  # results that wait for an older candidate's
            self.answer_tell(candidate_id, self._budget_spent)
        for _ in range(self.take_asks()):  # the strategy has no candidate for them yet
            self._answer({"wait": True})
        while not self.has_ended and (line := next(self._requests, None)) is not None:
            attempt = self.handle(line)
            if attempt is not None:
                return [attempt]
            if self._open_asks:
                return ()
        self.has_ended = True
        raise KeyboardInterrupt  # like Ctrl-C: the campaign stops, and candidates stay outstanding

    def handle(self, line: str) -> Attempt | None:
        """Answer a request, or note it for the campaign to answer; return the attempt of a tell."""
        try:
            kind, values = read_request(line)
            if kind == "ask":
                convert(values, EmptyRequest)
                self._open_asks += 1
            elif kind == "tell":
                return self._take_result(convert(values, ClientResult))
            elif kind == "validate":
                self._answer(validity_answer(values, self._tester.terms.map_size))
            elif kind == "end":
                convert(values, EmptyRequest)
                self.has_ended = True
            else:
                raise ValueError(f"unknown request {kind!r}: ask, tell, validate or end is needed")
        except (ValidationError, ValueError, TypeError, FreneticError) as error:
            text = " ".join(str(error).split())
            self._answer({"error": text[:_MOST_ERROR_CHARACTERS]})
        return None

    def _take_result(self, result: ClientResult) -> Attempt:
        """Return a client's result as an attempt.

        Raises:
            ValueError: the candidate is not outstanding, or the result is unusable.
            FreneticError: the file for an early result cannot be written.
        """
        if result.id not in self._running:
            raise ValueError(f"candidate {result.id} is not outstanding")
        road, sent_at = self._running[result.id]
        attempt = result.attempt(road, time.perf_counter() - sent_at)
        if min(self._running) < result.id:
            self._write_early(result)
        del self._running[result.id]
        self._open_tells.add(result.id)
        return attempt

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class ClientCampaign(Campaign):
    """A campaign whose roads a client drives, see the text of this module.

    Args:
        requests: lines of the client, each with a request.
        answer: function that sends an answer to the client.
        name: name of the client's driver, for the campaign's configuration.
        rules: rules by which the client judges drives, for the campaign's configuration.
        others: options of `Campaign`, without driver and simulator.
    """

    def __init__(
        self,
        requests: Iterator[str],
        answer: Callable[[Any], None],
        *,
        name: str = "client",
        rules: Rules | None = None,
        **others: Any,
    ) -> None:
        super().__init__(simulator=ClientSimulator(rules), driver=ClientDriver(name), **others)
        self.max_in_flight = None  # as many as the client asks for
        self._answer = answer
        self._requests = requests
        self._client = _ClientWorkers(self.tester, requests, answer, self.folder / WAITING)

    def _check_conditions(self, domain: Domain) -> None:
        """Check nothing: the client sets the conditions."""

    def _workers(self, log: CampaignLog) -> Workers:  # noqa: ARG002 - nothing is lost here
        return self._client

    def _second_drive(self, store: CampaignStore) -> None:
        """Return None: no candidate is handed out twice."""

    def serve(self) -> Summary:
        """Search until the client ends, and answer its requests.

        A campaign in the folder is resumed; its outstanding candidates are handed out again.

        Raises:
            CampaignError: the campaign cannot `run` or `resume`.
        """
        exists = (self.folder / DATABASE).is_file()
        search = self.resume if exists else self.run
        summary = search(on_event=self._answer_result)
        is_stopped = summary.interrupted and not self._client.has_ended
        reason = summary.ended or ("it was stopped" if is_stopped else "the budget is spent")
        for _ in range(self._client.free):
            self._answer({"end": reason})
        while not self._client.has_ended and (line := next(self._requests, None)) is not None:
            if self._client.handle(line) is not None:
                self._answer({"error": f"{reason}: nothing more is told"})
            for _ in range(self._client.take_asks()):
                self._answer({"end": reason})
        self._answer({"summary": summary.as_json()})
        return summary

    def _answer_result(self, event: Event) -> None:
        """Answer the client if the event is a stored result."""
        test = event.test
        if test is not None:
            self._client.note_stored(test.id, test.budget_spent)
