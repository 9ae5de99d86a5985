"""The segment of a test around the place where the car left its lane, and the bends of a line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.reader import Order
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import LocatedDrive
from frenetic.oracle.verdict import Assessment, Finding, Side, assess, locate_drive
from frenetic.road import Road

REACH: Final = 30.0
"""Length of a failure's segment before and after its place, in m."""


@dataclass(frozen=True, eq=False)
class Segment:
    """Stretch of road around a place, and the drive along it; see `segment_of`."""

    road: Road
    drive: Drive
    place: float
    """Place where the car left its lane, or else was furthest off, in m along the road."""
    side: Side | None
    """Side of the lane on which the car left; None if it stayed."""
    criterion: str | None
    """Criterion that the drive exceeded at the place, see `frenetic.oracle.Finding`; or None."""
    start: float
    """Start of the segment, in m along the road."""
    end: float
    """End of the segment, in m along the road."""
    assessment: Assessment
    """Assessment of the whole drive, record by record."""
    first: int
    """Index of the segment's first record."""
    last: int
    """Index after the segment's last record."""

    @property
    def length(self) -> float:
        """Length of road, in m."""
        return self.end - self.start

    @property
    def lateral_offset(self) -> FloatArray:
        """Distance left of the ego lane's centre line, (n,) in m, record by record."""
        return self.assessment.lateral_offset[self.first : self.last]

    @property
    def speed(self) -> FloatArray:
        """Speed record by record, (n,) in m/s."""
        return self.drive.trajectory.speed[self.first : self.last]

    @property
    def steering(self) -> FloatArray:
        """Angle of the front wheels, (n,) in rad, record by record."""
        return self.drive.trajectory.steering[self.first : self.last]

    @cached_property
    def curvature_samples(self) -> tuple[FloatArray, FloatArray]:
        """Distances, (k,) in m, and curvatures, (k,) in 1/m: both ends and the samples between."""
        places = np.arange(len(self.road.curvatures)) * self.road.step
        inside = places[(places > self.start) & (places < self.end)]
        distances = np.concatenate([[self.start], inside, [self.end]])
        return distances, self.road.curvature_at(distances)

    @cached_property
    def signals(self) -> LocatedDrive:
        """Signals of the whole drive, from which criteria are measured."""
        return locate_drive(self.road, self.drive, self.assessment)

    @property
    def bends(self) -> tuple[Bend, ...]:
        """Bends within the segment, cut at its ends, in order."""
        return find_bends(*self.curvature_samples)

    def whole(self) -> Segment:
        """Return the segment with the whole road and the whole drive."""
        n = len(self.assessment.distance)
        return replace(self, start=0.0, end=self.road.length, first=0, last=n)


def segment_of(road: Road, drive: Drive, finding: Finding | None) -> Segment:
    """Return the segment of a drive around the place of a finding, such as a departure.

    Without a finding, the place is where the oob distance is least. The segment ends with the road,
    and holds only records between the car's entry and exit.

    Args:
        road: road with its place on the map.
        drive: drive that was judged PASS or FAIL.
        finding: finding of the oracle or the campaign, see `Result.finding`.

    Raises:
        ValueError: the drive has no records.
    """
    if len(drive.trajectory) == 0:
        raise ValueError("a drive without records has no segment: drive the road first")
    assessment = assess(road, drive, has_shares=False)
    n = len(assessment.distance)
    if finding is not None:
        centre = int(np.argmin(np.abs(drive.trajectory.time[:n] - finding.time)))
        place = finding.distance
    else:
        centre = int(np.argmin(assessment.oob_distance))
        place = float(assessment.distance[centre])
    place = min(max(place, 0.0), road.length)
    start, end = max(place - REACH, 0.0), min(place + REACH, road.length)
    # A record beyond the road's end belongs to the segment that reaches that end.
    along = np.clip(assessment.distance, 0.0, road.length)
    too_early = np.flatnonzero(along[:centre] < start)
    too_late = np.flatnonzero(along[centre + 1 :] > end)
    return Segment(
        road=road,
        drive=drive,
        place=place,
        side=None if finding is None else finding.side,
        criterion=None if finding is None else finding.criterion,
        start=start,
        end=end,
        assessment=assessment,
        first=int(too_early[-1]) + 1 if len(too_early) else 0,
        last=centre + 1 + int(too_late[0]) if len(too_late) else n,
    )


def segment_of_test(test: Test) -> Segment | None:
    """Return the segment of a stored test; None without records."""
    if test.drive is None or not len(test.drive.trajectory):
        return None
    return segment_of(test.road, test.drive, test.result.finding)


def segments_of(
    store: CampaignStore,
    outcome: Outcome | None = None,
    *,
    order_by: Order = "result_number",
    limit: int | None = None,
    with_repeats: bool = True,
) -> Iterator[tuple[Test, Segment]]:
    """Yield the driven tests of a campaign, each with its segment.

    Args:
        store: the campaign.
        outcome: PASS or FAIL for tests with this outcome only; None for both.
        order_by: order of the tests, as for `CampaignStore.tests`.
        limit: most tests to read.
        with_repeats: whether repeated roads are included, as for `CampaignStore.tests`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    records = store.tests(outcome, order_by, limit, with_trajectory=True, with_repeats=with_repeats)
    for record in records:
        if record.outcome.is_driven and record.drive is not None:
            yield record, segment_of(record.road, record.drive, record.result.finding)


# Bends

GENTLE: Final = 0.005
"""Curvature below which a road counts as straight, in 1/m: a radius of 200 m; ours."""
LEAST_TURN: Final = math.radians(10.0)
"""Least turn of a bend, in rad; ours."""


@dataclass(frozen=True)
class Bend:
    """Stretch that turns one way, `LEAST_TURN` or more, with a curvature of at least `GENTLE`."""

    start: float
    """Start, in m along the road."""
    end: float
    """End, in m along the road."""
    turn: float
    """Turn in rad, positive to the left."""
    sharpest: float
    """Largest curvature without its sign, in 1/m."""

    @property
    def side(self) -> Side:
        """Direction of the turn."""
        return "left" if self.turn > 0.0 else "right"


def find_bends(
    distances: FloatArray, curvatures: FloatArray, gentle: float = GENTLE
) -> tuple[Bend, ...]:
    """Return the bends of a line, in order.

    Args:
        distances: (n,) distances along the line in m, increasing.
        curvatures: (n,) curvatures in 1/m at these distances, linear in between.
        gentle: curvature in 1/m below which the line counts as straight. With a tenth of `GENTLE`,
            a tenth of `LEAST_TURN` makes a bend.
    """
    s, kappa = _cut(distances, curvatures, (-gentle, gentle))
    means = [0.5 * (start + end) for start, end in pairwise(kappa)]
    ways = [math.copysign(1.0, mean) if abs(mean) >= gentle else 0.0 for mean in means]
    least_turn = LEAST_TURN * gentle / GENTLE
    bends, last = [], 0
    for way, pieces in groupby(ways):
        first, last = last, last + len(list(pieces))
        if not way:
            continue
        turn = float(np.sum([means[i] * (s[i + 1] - s[i]) for i in range(first, last)]))
        # A rounding error must not decide on a bend of exactly the least turn.
        if abs(turn) >= least_turn - 1e-9:
            sharpest = max(map(abs, kappa[first : last + 1]))
            bends.append(Bend(s[first], s[last], turn, sharpest))
    return tuple(bends)


def heading_range(distances: FloatArray, curvatures: FloatArray) -> tuple[float, float]:
    """Return the least and the largest heading of a line in rad, from 0 at its start.

    Args:
        distances: as for `find_bends`.
        curvatures: as for `find_bends`.
    """
    s, kappa = _cut(distances, curvatures, (0.0,))
    heading = least = most = 0.0
    for (start, end), (kappa_start, kappa_end) in zip(pairwise(s), pairwise(kappa), strict=True):
        heading += 0.5 * (kappa_end + kappa_start) * (end - start)
        least, most = min(least, heading), max(most, heading)
    return least, most


def _cut(
    distances: FloatArray, curvatures: FloatArray, levels: tuple[float, ...]
) -> tuple[list[float], list[float]]:
    """Return distances and curvatures with an extra sample wherever a level is crossed."""
    s, kappa = distances.tolist(), curvatures.tolist()  # few numbers: faster than arrays
    for level in levels:
        for i in range(len(s) - 2, -1, -1):
            before, after = kappa[i], kappa[i + 1]
            if (before - level) * (after - level) < 0.0:
                share = (level - before) / (after - before)
                s.insert(i + 1, s[i] + share * (s[i + 1] - s[i]))
                kappa.insert(i + 1, level)
    return s, kappa


# Places in words

BEHIND: Final = 20.0
"""Distance behind a bend at which a place still belongs to it, in m: a car that a bend throws out
of its lane has left it up to 13 m behind the bend."""
BEFORE: Final = 15.0
"""Distance before a bend at which a place belongs to it, in m: as far ahead as failures are
compared, see `frenetic.search.approach`."""
_MENTIONED: Final = 15.0
"""Length from which on a straight before a bend is mentioned, in m."""
_STRAIGHT: Final = 1e-4
"""Curvature below which every road counts as straight, in 1/m: a radius of 10 km."""


def bends_of(curvatures: FloatArray, step: float) -> tuple[Bend, ...]:
    """Return the bends of a whole road, by which places on it are described.

    On a road without sharp bends, such as a motorway, a bend has at least a quarter of the road's
    largest curvature.

    Args:
        curvatures: curvatures of the road, (n,) in 1/m.
        step: distance between two curvatures, in m.
    """
    gentle = max(min(GENTLE, 0.25 * float(np.abs(curvatures).max())), _STRAIGHT)
    return find_bends(np.arange(len(curvatures), dtype=np.float64) * step, curvatures, gentle)


def bend_of_place(bends: Sequence[Bend], place: float) -> Bend | None:
    """Return the bend to which a place belongs; None for a place on a straight.

    The place belongs to the bend in which it lies, else to the last bend that ended up to `BEHIND`
    before it, else to the next bend that starts up to `BEFORE` after it.

    Args:
        bends: bends of the road, in order.
        place: place, in m along the road.
    """
    around = [bend for bend in bends if bend.start <= place <= bend.end]
    behind = [bend for bend in reversed(bends) if 0.0 < place - bend.end <= BEHIND]
    ahead = [bend for bend in bends if 0.0 < bend.start - place <= BEFORE]
    return next(iter([*around, *behind, *ahead]), None)


def place_text(curvatures: FloatArray, step: float, place: float) -> str:
    """Return a place of a road in words: ``10 m behind a left-hand bend of 15 m radius``.

    Args:
        curvatures: curvatures of the whole road, (n,) in 1/m.
        step: distance between two curvatures, in m.
        place: place, in m along the road.
    """
    bends = bends_of(curvatures, step)
    bend = bend_of_place(bends, place)
    if bend is None:
        return "on a straight"
    if place > bend.end:
        part = f"{_gap(place - bend.end)} behind"
    elif place < bend.start:
        part = f"{_gap(bend.start - place)} before"
    else:
        turned = _turn(curvatures, step, bend.start, place) / bend.turn
        part = "entering" if turned < 1 / 3 else "in" if turned < 2 / 3 else "at the end of"
    text = f"{part} a {bend.side}-hand bend of {1.0 / bend.sharpest:.0f} m radius"
    previous = next((other for other in reversed(bends) if other.end <= bend.start), None)
    straight_start = max(0.0 if previous is None else previous.end, place - REACH)
    if bend.start - straight_start >= _MENTIONED:
        return f"{text} after a straight"
    if previous is not None and previous.end > place - REACH:
        return f"{text} after a {previous.side}-hand bend"
    return text


def _gap(distance: float) -> str:
    """Return a distance from a bend in words."""
    return "just" if distance < 0.5 else f"{distance:.0f} m"


def _turn(curvatures: FloatArray, step: float, start: float, end: float) -> float:
    """Return the angle in rad by which a road turns between two places, positive to the left."""
    samples = np.arange(len(curvatures)) * step
    places = np.concatenate([[start], samples[(samples > start) & (samples < end)], [end]])
    kappa = np.interp(places, samples, curvatures)
    return float(np.sum(0.5 * (kappa[1:] + kappa[:-1]) * np.diff(places)))
