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
    """A stretch of road around a place, and the drive along it; made by `segment_of`."""

    road: Road
    drive: Drive
    place: float
    """Place where the car left its lane, or else was furthest off, in m along the road."""
    side: Side | None
    """The side of the lane on which it left, None if it did not."""
    criterion: str | None
    """Criterion that the drive exceeded there, see `frenetic.oracle.Finding`; None without one."""
    start: float
    """Distance along the road, in m."""
    end: float
    """Distance along the road, in m."""
    assessment: Assessment
    """The whole drive, record by record."""
    first: int
    """The segment's first record."""
    last: int
    """One past the segment's last record."""

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
    def seen(self) -> LocatedDrive:
        """The whole drive, as criteria see it."""
        return locate_drive(self.road, self.drive, self.assessment)

    @property
    def bends(self) -> tuple[Bend, ...]:
        """The bends within the segment, cut at its ends, in order."""
        return find_bends(*self.curvature_samples)

    def whole(self) -> Segment:
        """The whole road and the whole drive, with the same place."""
        n = len(self.assessment.distance)
        whole = replace(self, start=0.0, end=self.road.length, first=0, last=n)
        vars(whole)["seen"] = self.seen  # what it has measured
        return whole


def segment_of(road: Road, drive: Drive, finding: Finding | None) -> Segment:
    """The segment of a drive around the place of a finding: where the car left its lane, say.

    Without one, the place is that of the minimum oob distance. The segment ends with the
    road, and holds only records between the car's entry and exit.

    Args:
        road: the road where it was driven.
        drive: a drive that was judged PASS or FAIL.
        finding: from the oracle or the campaign, see `Result.finding`.

    Raises:
        ValueError: the drive has no records.
    """
    if len(drive.trajectory) == 0:
        raise ValueError("a drive without records has no segment: drive the road first")
    seen = assess(road, drive, has_shares=False)
    n = len(seen.distance)
    if finding is not None:
        centre = int(np.argmin(np.abs(drive.trajectory.time[:n] - finding.time)))
        place = finding.distance
    else:
        centre = int(np.argmin(seen.oob_distance))
        place = float(seen.distance[centre])
    place = min(max(place, 0.0), road.length)
    start, end = max(place - REACH, 0.0), min(place + REACH, road.length)
    # A record beyond the road's end belongs to the segment that reaches that end.
    along = np.clip(seen.distance, 0.0, road.length)
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
        assessment=seen,
        first=int(too_early[-1]) + 1 if len(too_early) else 0,
        last=centre + 1 + int(too_late[0]) if len(too_late) else n,
    )


def segment_of_test(test: Test) -> Segment | None:
    """The segment of a stored test; None without records, or if it was read without them."""
    if test.drive is None or not len(test.drive.trajectory):
        return None
    return segment_of(test.road, test.drive, test.result.finding)


def segments_of(
    store: CampaignStore,
    outcome: Outcome | None = None,
    *,
    order_by: Order = "told",
    limit: int | None = None,
    with_repeats: bool = True,
) -> Iterator[tuple[Test, Segment]]:
    """The driven tests of a campaign, one by one, each with its segment.

    Args:
        store: the campaign.
        outcome: PASS or FAIL to get only these.
        order_by: as for `CampaignStore.tests`.
        limit: most tests to read.
        with_repeats: as for `CampaignStore.tests`.

    Raises:
        CampaignError: the campaign is damaged.
    """
    records = store.tests(outcome, order_by, limit, with_trajectory=True, with_repeats=with_repeats)
    for record in records:
        if record.outcome.is_driven and record.drive is not None:
            yield record, segment_of(record.road, record.drive, record.result.finding)


# Bends

GENTLE: Final = 0.005
"""Curvature below which a road counts as straight, in 1/m: a radius of 200 m."""
LEAST_TURN: Final = math.radians(10.0)
"""Least turn of a bend, in rad."""


@dataclass(frozen=True)
class Bend:
    """A stretch that turns one way, `LEAST_TURN` or more, with a curvature of at least `GENTLE`."""

    start: float
    """m."""
    end: float
    """m."""
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
    """The bends of a line, in order.

    Args:
        distances: (n,) m, increasing.
        curvatures: (n,) 1/m at these distances, linear in between.
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
        # A rounding error must not decide on a bend of exactly this size.
        if abs(turn) >= least_turn - 1e-9:
            sharpest = max(map(abs, kappa[first : last + 1]))
            bends.append(Bend(s[first], s[last], turn, sharpest))
    return tuple(bends)


def heading_range(distances: FloatArray, curvatures: FloatArray) -> tuple[float, float]:
    """Least and largest heading in rad of a line as for `find_bends`; its first is 0."""
    s, kappa = _cut(distances, curvatures, (0.0,))
    heading = least = most = 0.0
    for (start, end), (one, other) in zip(pairwise(s), pairwise(kappa), strict=True):
        heading += 0.5 * (other + one) * (end - start)
        least, most = min(least, heading), max(most, heading)
    return least, most


def _cut(
    distances: FloatArray, curvatures: FloatArray, levels: tuple[float, ...]
) -> tuple[list[float], list[float]]:
    """Distances and curvatures with a sample more wherever the curvature crosses a level."""
    s, kappa = distances.tolist(), curvatures.tolist()  # few numbers: faster than arrays
    for level in levels:
        for i in range(len(s) - 2, -1, -1):
            one, other = kappa[i], kappa[i + 1]
            if (one - level) * (other - level) < 0.0:
                share = (level - one) / (other - one)
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
    """The bends of a whole road, by which places on it are described.

    On a road without sharp bends, such as a motorway, a bend has at least a quarter of the road's
    largest curvature.

    Args:
        curvatures: of the road, (n,) in 1/m.
        step: m between two of them.
    """
    gentle = max(min(GENTLE, 0.25 * float(np.abs(curvatures).max())), _STRAIGHT)
    return find_bends(np.arange(len(curvatures), dtype=np.float64) * step, curvatures, gentle)


def bend_of_place(bends: Sequence[Bend], place: float) -> Bend | None:
    """The bend to which a place belongs; None for a place on a straight.

    That is the bend in which it lies, else the last one that ended up to `BEHIND` m before the
    place, else the next one that starts up to `BEFORE` m after it.

    Args:
        bends: of the road, in order.
        place: m along the road.
    """
    around = [bend for bend in bends if bend.start <= place <= bend.end]
    behind = [bend for bend in reversed(bends) if 0.0 < place - bend.end <= BEHIND]
    ahead = [bend for bend in bends if 0.0 < bend.start - place <= BEFORE]
    return next(iter([*around, *behind, *ahead]), None)


def place_in_words(curvatures: FloatArray, step: float, place: float) -> str:
    """A place of a road in words: ``10 m behind a left-hand bend of 15 m radius``.

    Args:
        curvatures: of the whole road, (n,) in 1/m.
        step: m between two of them.
        place: m along the road.
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
    """A distance from a bend in words."""
    return "just" if distance < 0.5 else f"{distance:.0f} m"


def _turn(curvatures: FloatArray, step: float, start: float, end: float) -> float:
    """Angle in rad by which a road turns between two places, positive to the left."""
    samples = np.arange(len(curvatures)) * step
    places = np.concatenate([[start], samples[(samples > start) & (samples < end)], [end]])
    kappa = np.interp(places, samples, curvatures)
    return float(np.sum(0.5 * (kappa[1:] + kappa[:-1]) * np.diff(places)))
