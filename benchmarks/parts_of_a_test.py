"""CPU time of the parts of a test in compiled simulation: placing, driving, judging, storing.

    python benchmarks/parts_of_a_test.py [--roads 400]

Each part runs alone over the same random roads of 50 to 350 m, which the planner drives. The
benchmark prints the least of several rounds, in microseconds per road.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Final

from frenetic import EmbeddedSimulator, Planner, RandomSearch, Road, judge
from frenetic.campaign.trajectory_codec import encode_and_round
from frenetic.oracle.drive import Drive
from frenetic.segments.segment import Segment, segment_of
from frenetic.segments.values import SegmentValues

SEED: Final = 5
ROUNDS: Final = 7
AT_ONCE: Final = 8
"""Number of roads that a campaign drives side by side on one thread."""


class Parts:
    """The parts of the tests of random roads, each with the results of the parts before."""

    def __init__(self, count: int) -> None:
        search = RandomSearch(seed=SEED)
        self.candidates = [search.ask() for _ in range(count)]
        self.roads = self.place()
        self.simulator = EmbeddedSimulator()
        self.drives = self.drive()
        self.results = [judge(*pair) for pair in zip(self.roads, self.drives, strict=True)]

    def place(self) -> list[Road]:
        """Lay the roads, fit them into the map and check them."""
        placed = [Road(item.curvatures, item.step).placed()[0] for item in self.candidates]
        return [road for road in placed if road is not None]

    def drive(self) -> list[Drive]:
        """Drive side by side."""
        batches = [self.roads[i : i + AT_ONCE] for i in range(0, len(self.roads), AT_ONCE)]
        driver = Planner()
        return [drive for batch in batches for drive in self.simulator.drive_many(batch, driver)]

    def judge(self) -> None:
        """Judge the drives."""
        for road, drive in zip(self.roads, self.drives, strict=True):
            judge(road, drive)

    def encode(self) -> list[Drive]:
        """Encode the trajectories; return the drives as they will be stored."""
        return [
            Drive(encode_and_round(drive.trajectory)[1], drive.car, drive.rules, drive.road)
            for drive in self.drives
        ]

    def follow(self) -> list[Segment]:
        """Follow the stored drives along their roads, up to the segments around their places."""
        pairs = zip(self.roads, self.stored, self.results, strict=True)
        return [segment_of(road, drive, result.finding) for road, drive, result in pairs]

    def measure(self) -> None:
        """Measure the values of the segments."""
        for segment, result in zip(self.segments, self.results, strict=True):
            SegmentValues.of(segment, result)

    def renew(self) -> None:
        """Make stored drives and segments anew, since they keep what was computed."""
        self.stored = self.encode()
        self.segments = self.follow()


def least_time(part: Callable[[], object], renew: Callable[[], object]) -> float:
    """Return the least CPU time of a part in several rounds, in s."""
    times = []
    for _ in range(ROUNDS):
        renew()
        start = time.process_time()
        part()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    """Print a line for each part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--roads", type=int, default=400, help="number of random roads")
    count = parser.parse_args().roads
    parts = Parts(count)
    for name, part in {
        "lay, fit and check the road": parts.place,
        f"drive, {AT_ONCE} side by side": parts.drive,
        "judge the drive": parts.judge,
        "encode and round the trajectory": parts.encode,
        "follow the stored drive": parts.follow,
        "values of its segment": parts.measure,
    }.items():
        print(f"{name:34} {1e6 * least_time(part, parts.renew) / count:6.0f} us", flush=True)


if __name__ == "__main__":
    main()
