"""The search for a simulator that somebody else runs: requests and answers, a JSON object each.

The campaign searches and stores like any other, but a client asks for its roads and drives them:

| request | answer |
| --- | --- |
| ``{"ask": {}}`` | ``{"candidate": {..}}``, ``{"wait": true}`` or ``{"end": reason}`` |
| ``{"tell": {"id": 1, "outcome": "FAIL", ..}}`` | ``{"told": 1, "budget_spent": 0.01}`` |
| ``{"validate": {"points": [[x, y], ..]}}`` | ``{"valid": false, "message": ".."}`` |
| ``{"end": {}}``, or the end of the input | ``{"summary": {..}}`` |

A candidate has an ``id``, ``points`` every 2 m or denser in m on the map, ``curvatures`` in 1/m,
their ``step`` in m, the ``pose`` of its first point and the ``lane_width`` in m, profiles of a road
that is not flat, and ``conditions``: names of `frenetic.conditions` with amounts, empty without a
domain. The client gets valid roads only, and may ask for several before it tells a result; ``wait``
means that a result has to come first. The search learns results in the order of asking. `Told` is
the form of a result. An unusable request is answered with ``{"error": ".."}`` and changes nothing.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, Self

import numpy as np
from msgspec import Struct, ValidationError, convert, json

from frenetic._support.bounds import Count, Finite, Measured, NotNegative, Share
from frenetic._support.files import write_file
from frenetic._support.outside_text import read_json
from frenetic.campaign.campaign import Campaign
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
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result, Side
from frenetic.road import Road, check_validity
from frenetic.road.files import entries_of
from frenetic.search.records import Candidate
from frenetic.simulators.simulator import Ready

WORKER: Final = "client"
"""Name of the worker in tests that a client drove."""
WAITING: Final = "waiting"
"""Folder in a campaign's folder for results that wait for an older candidate's result."""


class Records(Struct, forbid_unknown_fields=True):
    """A drive as lists of equal length, one value a record; a missing list is stored as 0."""

    time: list[NotNegative]
    """Simulated time since the start, in s."""
    x: list[Finite]
    """Coordinate of the centre of mass on the map, in m."""
    y: list[Finite]
    """Coordinate of the centre of mass on the map, in m."""
    speed: list[Finite]
    """Speed in m/s."""
    heading: list[Finite] = []
    """Heading in rad, counter-clockwise from +x; by default the direction of the path."""
    steering: list[Finite] = []
    """Angle of the front wheels in rad, positive to the left."""
    throttle: list[Finite] = []
    """Throttle, 0..1."""
    brake: list[Finite] = []
    """Brake, 0..1."""

    def trajectory(self) -> Trajectory:
        """Return the trajectory.

        Raises:
            ValueError: the lists differ in length, or are empty, or time goes back.
        """
        n = len(self.time)
        values = {name: getattr(self, name) for name in self.__struct_fields__}
        needed = ("time", "x", "y", "speed")
        lengths = {k: len(value) for k, value in values.items() if value or k in needed}
        if not n or set(lengths.values()) != {n}:
            raise ValueError(f"records need lists of one length, at least 1, not {lengths}")
        if min(np.diff(self.time), default=0.0) < 0.0:
            raise ValueError("the time of records has to increase")
        if not self.heading:
            dx, dy = (
                np.gradient(positions) if n > 1 else np.zeros(1) for positions in (self.x, self.y)
            )
            values["heading"] = np.unwrap(np.arctan2(dy, dx)).tolist()
        columns = {name: np.zeros(n) for name in Trajectory.names()}
        columns |= {name: np.array(value) for name, value in values.items() if len(value)}
        return Trajectory(**columns)


class Points(Struct, forbid_unknown_fields=True):
    """The points of a road that is to be validated."""

    points: list[tuple[Finite, Finite]]
    """Points of its centre line on the map, in m."""


class Nothing(Struct, forbid_unknown_fields=True):
    """The values of a request without values."""


class Told(Struct, forbid_unknown_fields=True):
    """The result of a candidate."""

    id: Count
    outcome: Literal["PASS", "FAIL", "ERROR"]
    """ERROR if the simulator broke, so that nothing is known about the road."""
    moobd: Measured | None = None
    """Minimum oob distance in m; the search learns nothing from a drive without it."""
    reason: str = ""
    """Cause of the outcome, in a sentence."""
    place: Measured | None = None
    """Distance along the road to where the car left its lane, or else came closest to it, in m."""
    side: Side | None = None
    """Side on which the car left its lane; None for a FAIL inside the lane."""
    oob_share: Share | None = None
    """Largest share of the car's box outside its lane."""
    duration: NotNegative | None = None
    """Simulated time of the drive, in s."""
    records: Records | None = None
    """The whole drive, for reports and for a search that learns more from it."""
    budget_spent: Share | None = None
    """Spent share of the budget, which replaces the campaign's count until the next share."""

    def attempt(self, road: Road, seconds: float) -> Attempt:
        """Return the attempt on a road, ready to be stored.

        Args:
            road: the candidate's road.
            seconds: wall time of the drive, in s.

        Raises:
            ValueError: the records are unusable, or a side has no place.
        """
        path = None if self.records is None else self.records.trajectory()
        outcome = Outcome(self.outcome)
        findings = []
        if outcome is Outcome.FAIL and self.side is not None:
            if self.place is None:
                raise ValueError("the side on which the car left its lane needs the place")
            x, y, _ = road.pose_at(min(max(self.place, 0.0), road.length))
            share = 1.0 if self.oob_share is None else self.oob_share
            at = self.duration or 0.0
            findings = [
                Finding.departure(self.side, self.place, oob_share=share, time=at, x=x, y=y)
            ]
        result = Result(
            outcome,
            self.reason or f"reported as {outcome}",
            self.moobd if outcome.is_driven else None,
            self.place if outcome.is_driven else None,
            self.oob_share if outcome.is_driven else None,
            self.duration if self.duration is not None or path is None else float(path.time[-1]),
            tuple(findings),
        )
        attempt = Attempt(
            self.id,
            result,
            road.pose,
            path,
            worker=WORKER,
            seconds=seconds,
            reported_share=self.budget_spent,
        )
        return attempt.pack(keep_exact=True)


@dataclass(frozen=True)
class ClientDriver:
    """The driver of a client, which drives elsewhere."""

    BEHAVIOUR: ClassVar[int] = 1

    name: str = "client"
    """Name of the client's driver and simulator, for the campaign's record."""

    def reset(self, setup: DriveSetup) -> None:
        """Do nothing: the client drives."""

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002 - a driver's
        """Raise: the client drives.

        Raises:
            CampaignError: always.
        """
        raise CampaignError("a client drives: its driver cannot act here")


class ClientSimulator(Ready):
    """The simulator of a client, which lays any road in any conditions.

    Args:
        rules: by which the client judges drives, for the campaign's record.
    """

    BEHAVIOUR: ClassVar[int] = 1
    lays_slopes: Final = True

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules, self.car = rules or Rules(), CarBody()

    def drive(self, road: Road, driver: Driver) -> Drive:  # noqa: ARG002
        """Raise: the client drives.

        Raises:
            CampaignError: always.
        """
        raise CampaignError("a client drives: its simulator cannot drive here")


class _Client(Workers):
    """Workers behind a line of requests and answers.

    Args:
        tester: places the roads.
        requests: as for `ToldCampaign`.
        answer: as for `ToldCampaign`.
        folder: for results that came before an older candidate's, which is stored first.
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
        self._asked = 0  # requests without an answer
        self._known: deque[Attempt] = deque()  # attempts that need no client
        self._running: dict[int, tuple[Road, float]] = {}  # id -> its road, and when it went out
        self._unanswered: set[int] = set()  # ids of results without an answer
        self._budget_spent = 0.0
        self.has_ended = False

    @property
    def free(self) -> int:
        return self._asked

    def confirm(self, number: int, budget_spent: float) -> None:
        """Answer that the search knows a result, unless that was answered."""
        self._budget_spent = budget_spent
        if number in self._unanswered:
            self._unanswered.remove(number)
            self._answer({"told": number, "budget_spent": budget_spent})

    def stored(self, number: int, budget_spent: float) -> None:
        """Confirm a stored result, and delete the file in which it waited."""
        self._early_file(number).unlink(missing_ok=True)
        self.confirm(number, budget_spent)

    def _write_early(self, result: Told) -> None:
        """Write a result that came before an older candidate's, until both are stored.

        Raises:
            FreneticError: the file cannot be written.
        """
        with suppress(OSError):  # the campaign's folder is gone, and is not created again
            self._folder.mkdir(exist_ok=True)
        write_file(self._early_file(result.id), json.encode(result), remedy="make room")

    def _early_file(self, number: int) -> Path:
        return self._folder / f"{number}.json"

    def taken(self) -> int:
        """Return the number of unanswered requests for a candidate, which the caller answers."""
        asked, self._asked = self._asked, 0
        return asked

    def submit(self, candidate: Candidate) -> None:
        road, verdict = fitted(candidate, self._tester.terms)
        if road is None or not verdict.valid:
            self._known.append(Attempt.undriven(candidate.id, Outcome.INVALID, verdict.message))
            return
        with suppress(OSError, ValueError):  # most have no result from before a crash
            result = read_json(self._early_file(candidate.id).read_bytes(), Told)
            self._known.append(result.attempt(road, 0.0))
            return
        self._asked -= 1
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
        for number in sorted(self._unanswered):  # before an older candidate
            self.confirm(number, self._budget_spent)
        for _ in range(self.taken()):  # to which the strategy had no answer
            self._answer({"wait": True})
        while not self.has_ended and (line := next(self._requests, None)) is not None:
            attempt = self.handled(line)
            if attempt is not None:
                return [attempt]
            if self._asked:
                return ()
        self.has_ended = True
        raise KeyboardInterrupt  # as Ctrl-C would: outstanding candidates stay so

    def handled(self, line: str) -> Attempt | None:
        """Answer a request, unless the campaign has to; return the attempt in it."""
        try:
            kind, values = requested(line)
            if kind == "ask":
                convert(values, Nothing)
                self._asked += 1
            elif kind == "tell":
                result = convert(values, Told)
                if result.id not in self._running:
                    raise ValueError(f"candidate {result.id} is not outstanding")
                road, since = self._running[result.id]
                attempt = result.attempt(road, time.perf_counter() - since)
                if min(self._running) < result.id:
                    self._write_early(result)
                del self._running[result.id]
                self._unanswered.add(result.id)
                return attempt
            elif kind == "validate":
                self._answer(validity(values, self._tester.terms.map_size))
            elif kind == "end":
                convert(values, Nothing)
                self.has_ended = True
            else:
                raise ValueError(f"unknown request {kind!r}: ask, tell, validate or end is needed")
        except (ValidationError, ValueError, TypeError, FreneticError) as error:
            self._answer({"error": " ".join(str(error).split())[:500]})
        return None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def requested(line: str) -> tuple[str, Any]:
    """Return the kind of a request, and its values.

    Raises:
        ValueError: the line is no request.
    """
    try:
        request = read_json(line)
    except ValueError as error:
        raise ValueError(f"{line.strip()[:60]!r} cannot be read as JSON: {error}") from None
    if not isinstance(request, dict) or len(request) != 1:
        raise ValueError("a request is an object with one entry: ask, tell, validate or end")
    return next(iter(request.items()))


def validity(request: Any, map_size: float) -> dict[str, Any]:
    """Return the answer whether a road is valid, as the competition defines it.

    Raises:
        ValueError: the request has no points.
    """
    points = np.array(convert(request, Points).points)
    verdict = check_validity(points.reshape(-1, 2), map_size)
    return {"valid": verdict.valid, "message": verdict.message}


class ToldCampaign(Campaign):
    """A campaign whose roads somebody else drives, see this module's text.

    Args:
        requests: lines, each with one JSON object.
        answer: called with each answer.
        name: name of the client's driver, for the campaign's record.
        rules: by which the client judges drives, for the campaign's record.
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
        self.max_in_flight = None
        self._answer = answer
        self._requests = requests
        self._client = _Client(self.tester, requests, answer, self.folder / WAITING)

    def _check_conditions(self, domain: Domain) -> None:
        """Check nothing: the client sets the conditions."""

    def _workers(self, log: CampaignLog) -> Workers:  # noqa: ARG002 - nothing is lost here
        return self._client

    def _second_drive(self, store: CampaignStore) -> None:
        """Return None: no candidate is handed out twice."""

    def serve(self) -> Summary:
        """Search until the client ends, and answer its requests.

        A campaign in the folder goes on; its outstanding candidates are handed out again.

        Raises:
            CampaignError: as for `run` and `resume`.
        """
        exists = (self.folder / DATABASE).is_file()
        search = self.resume if exists else self.run
        summary = search(on_event=self._confirm)
        is_stopped = summary.interrupted and not self._client.has_ended
        reason = summary.ended or ("it was stopped" if is_stopped else "the budget is spent")
        for _ in range(self._client.free):
            self._answer({"end": reason})
        while not self._client.has_ended and (line := next(self._requests, None)) is not None:
            if self._client.handled(line) is not None:
                self._answer({"error": f"{reason}: nothing more is told"})
            for _ in range(self._client.taken()):
                self._answer({"end": reason})
        self._answer({"summary": summary.as_json()})
        return summary

    def _confirm(self, event: Event) -> None:
        test = event.test
        if test is not None:
            self._client.stored(test.id, test.budget_spent)
