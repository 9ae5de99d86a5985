"""The search for a simulator that somebody else runs: requests and answers, a JSON object each.

A campaign is searched and stored like any other, but its roads are driven by whoever asks for them:

| request | answer |
| --- | --- |
| ``{"ask": {}}`` | ``{"candidate": {..}}``, ``{"wait": true}`` or ``{"end": reason}`` |
| ``{"tell": {"id": 1, "outcome": "FAIL", ..}}`` | ``{"told": 1, "budget_spent": 0.01}`` |
| ``{"validate": {"points": [[x, y], ..]}}`` | ``{"valid": false, "message": ".."}`` |
| ``{"end": {}}``, or the end of the input | ``{"summary": {..}}`` |

A candidate has an ``id``, ``points`` every 2 m or denser in m on the map, ``curvatures`` in 1/m,
their ``step`` in m, the ``pose`` of its first point and the ``lane_width`` in m, profiles of a road
that is not flat, and ``conditions``: names of `frenetic.conditions` with amounts, empty without a
domain. Invalid roads are not handed out. Any number may be asked for before one is told; ``wait``
means that one has to be told first. The search learns results in the order of asking. `Told` says
what can be told. An unusable request is answered with ``{"error": ".."}`` and changes nothing.
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
"""Name of the worker in a test that was told."""
TOLD: Final = "told"
"""Folder in a campaign's folder for results that wait for that of an older candidate."""


class Records(Struct, forbid_unknown_fields=True):
    """A drive, record by record: lists of one length. What is left out is stored as 0."""

    time: list[NotNegative]
    """Simulated time since the start, in s."""
    x: list[Finite]
    """Coordinate of the centre of mass on the map, in m."""
    y: list[Finite]
    """Coordinate of the centre of mass on the map, in m."""
    speed: list[Finite]
    """m/s."""
    heading: list[Finite] = []
    """rad, counter-clockwise from +x; by default the direction of the path."""
    steering: list[Finite] = []
    """Angle of the front wheels in rad, positive to the left."""
    throttle: list[Finite] = []
    """0..1."""
    brake: list[Finite] = []
    """0..1."""

    def trajectory(self) -> Trajectory:
        """The trajectory.

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
            dx, dy = (np.gradient(one) if n > 1 else np.zeros(1) for one in (self.x, self.y))
            values["heading"] = np.unwrap(np.arctan2(dy, dx)).tolist()
        columns = {name: np.zeros(n) for name in Trajectory.names()}
        columns |= {name: np.array(value) for name, value in values.items() if len(value)}
        return Trajectory(**columns)


class Points(Struct, forbid_unknown_fields=True):
    """A road that is to be validated."""

    points: list[tuple[Finite, Finite]]
    """Points of its centre line on the map, in m."""


class Nothing(Struct, forbid_unknown_fields=True):
    """The values of a request that has none."""


class Told(Struct, forbid_unknown_fields=True):
    """The result of a candidate."""

    id: Count
    outcome: Literal["PASS", "FAIL", "ERROR"]
    """ERROR if the simulator broke, so that nothing is known about the road."""
    moobd: Measured | None = None
    """Minimum oob distance in m; the search learns nothing from a drive without it."""
    reason: str = ""
    """Why it ended so, in a sentence."""
    place: Measured | None = None
    """Distance along the road to where the car left its lane, or else was furthest off, in m."""
    side: Side | None = None
    """Side of the lane on which it left; a FAIL without a side left on none."""
    oob_share: Share | None = None
    """Largest share of the car's box outside its lane."""
    duration: NotNegative | None = None
    """Simulated time, in s."""
    records: Records | None = None
    """The drive, from which the search learns more, and which reports show."""
    budget_spent: Share | None = None
    """Spent share of the budget, in place of the campaign's count until the next is told."""

    def attempt(self, road: Road, seconds: float) -> Attempt:
        """The attempt on a road, which took so many s, ready to be stored.

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
            self.reason or f"told as {outcome}",
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
            told_share=self.budget_spent,
        )
        return attempt.pack(keep=True)


@dataclass(frozen=True)
class TellingDriver:
    """The driver of whoever asks and tells."""

    BEHAVIOUR: ClassVar[int] = 1

    name: str = "told"
    """What it is, for the campaign's record."""

    def reset(self, setup: DriveSetup) -> None:
        """Nothing drives here."""

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002 - a driver's
        """Nothing drives here.

        Raises:
            CampaignError: always.
        """
        raise CampaignError("this driver is told about, and drives nothing here")


class TellingSimulator(Ready):
    """The simulator of whoever asks and tells, who lays any road in any conditions.

    Args:
        rules: by which the drives are judged there, for the campaign's record, as its car.
    """

    BEHAVIOUR: ClassVar[int] = 1
    lays_slopes: Final = True

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules, self.car = rules or Rules(), CarBody()

    def drive(self, road: Road, driver: Driver) -> Drive:  # noqa: ARG002
        """Nothing drives here.

        Raises:
            CampaignError: always.
        """
        raise CampaignError("this simulator is told about, and drives nothing here")


class _Client(Workers):
    """Workers behind a line of requests and answers.

    Args:
        tester: places the roads.
        requests: as for `ToldCampaign`.
        answer: likewise.
        folder: for results that were told before that of an older candidate, which is stored first.
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
        self._known: deque[Attempt] = deque()  # that need no client
        self._running: dict[int, tuple[Road, float]] = {}  # id -> its road, and when it went out
        self._told: set[int] = set()  # without an answer
        self._budget_spent = 0.0
        self.has_ended = False

    @property
    def free(self) -> int:
        return self._asked

    def say_told(self, number: int, budget_spent: float) -> None:
        """Answers that a candidate was told, unless that was said."""
        self._budget_spent = budget_spent
        if number in self._told:
            self._told.remove(number)
            self._answer({"told": number, "budget_spent": budget_spent})

    def stored(self, number: int, budget_spent: float) -> None:
        """Answers that a candidate was told, and deletes the file of its stored result."""
        self._early_file(number).unlink(missing_ok=True)
        self.say_told(number, budget_spent)

    def _write_early(self, result: Told) -> None:
        """Writes a result that came before that of an older candidate, until both are stored.

        Raises:
            FreneticError: the file cannot be written.
        """
        with suppress(OSError):  # the campaign's folder is gone, which is not made again
            self._folder.mkdir(exist_ok=True)
        write_file(self._early_file(result.id), json.encode(result), remedy="make room")

    def _early_file(self, number: int) -> Path:
        return self._folder / f"{number}.json"

    def taken(self) -> int:
        """Number of requests for a candidate without an answer, which the caller answers."""
        asked, self._asked = self._asked, 0
        return asked

    def submit(self, candidate: Candidate) -> None:
        road, verdict = fitted(candidate, self._tester.terms)
        if road is None or not verdict.valid:
            self._known.append(Attempt.undriven(candidate.id, Outcome.INVALID, verdict.message))
            return
        with suppress(OSError, ValueError):  # most were not told before a crash
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
        for number in sorted(self._told):  # before an older one
            self.say_told(number, self._budget_spent)
        for _ in range(self.taken()):  # to which the strategy had no answer
            self._answer({"wait": True})
        while not self.has_ended and (line := next(self._requests, None)) is not None:
            attempt = self.handled(line)
            if attempt is not None:
                return [attempt]
            if self._asked:
                return ()
        self.has_ended = True
        raise KeyboardInterrupt  # as Ctrl-C would: what is outstanding stays so

    def handled(self, line: str) -> Attempt | None:
        """Answers a request, unless the campaign has to; returns the attempt that it tells."""
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
                self._told.add(result.id)
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
    """The kind of a request, and its values.

    Raises:
        ValueError: the line is none.
    """
    try:
        request = read_json(line)
    except ValueError as error:
        raise ValueError(f"{line.strip()[:60]!r} cannot be read as JSON: {error}") from None
    if not isinstance(request, dict) or len(request) != 1:
        raise ValueError("a request is an object with one entry: ask, tell, validate or end")
    return next(iter(request.items()))


def validity(request: Any, map_size: float) -> dict[str, Any]:
    """The answer whether a road is valid, as the competition defines it.

    Raises:
        ValueError: there are no points.
    """
    points = np.array(convert(request, Points).points)
    verdict = check_validity(points.reshape(-1, 2), map_size)
    return {"valid": verdict.valid, "message": verdict.message}


class ToldCampaign(Campaign):
    """A campaign whose roads somebody else drives, see this module's text.

    Args:
        requests: lines, each with one JSON object.
        answer: called with each answer.
        name: of what drives, for the campaign's record.
        rules: by which it judges, likewise.
        others: as for `Campaign`, without driver and simulator.
    """

    def __init__(
        self,
        requests: Iterator[str],
        answer: Callable[[Any], None],
        *,
        name: str = "told",
        rules: Rules | None = None,
        **others: Any,
    ) -> None:
        super().__init__(simulator=TellingSimulator(rules), driver=TellingDriver(name), **others)
        self.lookahead = None
        self._answer = answer
        self._requests = requests
        self._client = _Client(self.tester, requests, answer, self.folder / TOLD)

    def _check_conditions(self, domain: Domain) -> None:
        """Whoever drives lays them."""

    def _workers(self, log: CampaignLog) -> Workers:  # noqa: ARG002 - nothing is lost here
        return self._client

    def _second_drive(self, store: CampaignStore) -> None:
        """None: no candidate is handed out twice."""

    def serve(self) -> Summary:
        """Searches until the client ends, and answers its requests.

        It goes on with the campaign in its folder if there is one; candidates that were outstanding
        then are handed out again.

        Raises:
            CampaignError: as for `run` and `resume`.
        """
        exists = (self.folder / DATABASE).is_file()
        search = self.resume if exists else self.run
        summary = search(on_event=self._say_told)
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

    def _say_told(self, event: Event) -> None:
        test = event.test
        if test is not None:
            self._client.stored(test.id, test.budget_spent)
