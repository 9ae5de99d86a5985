"""Requests of a client that drives a campaign's roads, see `frenetic.campaign.ask_tell`."""

from __future__ import annotations

from typing import Any, Final, Literal

import numpy as np
from msgspec import Struct, convert

from frenetic._support.bounds import Count, Finite, Measured, NotNegative, Share
from frenetic._support.outside_text import read_json
from frenetic.campaign.record import Attempt
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Finding, Result, Side
from frenetic.road import Road, check_validity

WORKER: Final = "client"
"""Name of the worker in tests that a client drove."""


class Records(Struct, forbid_unknown_fields=True):
    """A drive as lists of equal length with one value per record; a missing list means zeros."""

    time: list[NotNegative]
    """Simulated time since the start, in s."""
    x: list[Finite]
    """Coordinate x of the centre of mass on the map, in m."""
    y: list[Finite]
    """Coordinate y of the centre of mass on the map, in m."""
    speed: list[Finite]
    """Speed, in m/s."""
    heading: list[Finite] = []
    """Heading in rad, counter-clockwise from +x; by default the direction of motion."""
    steering: list[Finite] = []
    """Angle of the front wheels in rad, positive to the left."""
    throttle: list[Finite] = []
    """Throttle, from 0 to 1."""
    brake: list[Finite] = []
    """Brake, from 0 to 1."""

    def trajectory(self) -> Trajectory:
        """Return the trajectory of the drive.

        Raises:
            ValueError: the lists differ in length, or are empty, or the time decreases.
        """
        n = len(self.time)
        values = {name: getattr(self, name) for name in self.__struct_fields__}
        required = ("time", "x", "y", "speed")
        lengths = {name: len(value) for name, value in values.items() if value or name in required}
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


class ValidateRequest(Struct, forbid_unknown_fields=True):
    """The values of the request ``validate``: the points of a road."""

    points: list[tuple[Finite, Finite]]
    """Points of the road's centre line on the map, in m."""


class EmptyRequest(Struct, forbid_unknown_fields=True):
    """The values of the requests ``ask`` and ``end``, which have none."""


class ClientResult(Struct, forbid_unknown_fields=True):
    """The values of the request ``tell``: the result of a candidate."""

    id: Count
    """Id of the candidate."""
    outcome: Literal["PASS", "FAIL", "ERROR"]
    """ERROR if the simulator broke, so that nothing is known about the road."""
    moobd: Measured | None = None
    """Minimum oob distance in m; the search learns nothing from a drive without this distance."""
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
    distance: NotNegative | None = None
    """Length of the road from its start to where the drive ended, in m; by default it
    follows from the records."""
    records: Records | None = None
    """The whole drive, for reports and for strategies that learn from it."""
    budget_spent: Share | None = None
    """Spent share of the budget, which replaces the campaign's own count from here on."""

    def attempt(self, road: Road, seconds: float) -> Attempt:
        """Return the result as an attempt to test a road, ready to be stored.

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
            time = self.duration or 0.0
            findings = [
                Finding.departure(self.side, self.place, oob_share=share, time=time, x=x, y=y)
            ]
        result = Result(
            outcome,
            self.reason or f"reported as {outcome}",
            self.moobd if outcome.is_driven else None,
            self.place if outcome.is_driven else None,
            self.oob_share if outcome.is_driven else None,
            self.duration if self.duration is not None or path is None else float(path.time[-1]),
            self._driven_distance(road, path),
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

    def _driven_distance(self, road: Road, path: Trajectory | None) -> float | None:
        """Return the length of the road up to where the drive ended, in m; None if unknown."""
        distance = self.distance
        if distance is None and path is not None:
            distance = float(road.track(np.column_stack((path.x, path.y)))[-1, 0])
        return None if distance is None else min(max(distance, 0.0), road.length)


def read_request(line: str) -> tuple[str, Any]:
    """Return the kind of a request, and its values.

    Raises:
        ValueError: the line is no JSON object with one entry.
    """
    try:
        request = read_json(line)
    except ValueError as error:
        raise ValueError(f"{line.strip()[:60]!r} cannot be read as JSON: {error}") from None
    if not isinstance(request, dict) or len(request) != 1:
        raise ValueError("a request is an object with one entry: ask, tell, validate or end")
    return next(iter(request.items()))


def validity_answer(values: Any, map_size: float) -> dict[str, Any]:
    """Return the answer whether a road is valid, as the competition defines it.

    Args:
        values: values of the request ``validate``.
        map_size: size of the map, in m.

    Raises:
        ValueError: the request has no points.
    """
    points = np.array(convert(values, ValidateRequest).points)
    verdict = check_validity(points.reshape(-1, 2), map_size)
    return {"valid": verdict.valid, "message": verdict.message}
