"""Read our OpenDRIVE files with other programs, and measure how far their lanes are from our lanes.

CARLA's map parser and SUMO's netconvert come with the extra ``test``; CARLA's parser needs no
server.
"""

from __future__ import annotations

import itertools
import math
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.road import Road, profile
from frenetic.search.operators import (
    FAIL_OPERATORS,
    PAPER_OPTIONS,
    PASS_OPERATORS,
    mix,
    random_curvatures,
    splice,
)

SPACING: Final = 0.9  # m between the places that are compared; hits no sample twice


def varied_roads() -> dict[str, Road]:
    """Return about fifty roads: roads of a search, and extreme roads."""
    rng = np.random.default_rng(2021)
    mother, father = random_curvatures(rng, 25), random_curvatures(rng, 18)
    searched = {f"random {n}": random_curvatures(rng, n) for n in (2, 3, 8, 15, 20, 25, 30, 35)}
    for name, change in PASS_OPERATORS.items():
        mutant = change(rng, mother, PAPER_OPTIONS)
        assert mutant is not None
        searched[name] = mutant
    searched |= {name: change(mother) for name, change in FAIL_OPERATORS.items()}
    searched["C1"] = mix(rng, mother, father)
    searched["C2a"], searched["C2b"] = splice(mother, father)
    roads = {name: Road(values) for name, values in searched.items()}
    extreme: dict[str, list[float]] = {
        "straight": [0.0] * 12,
        "straight, 2 samples": [0.0, 0.0],
        "constant to the left": [0.03] * 10,
        "constant to the right": [-0.03] * 10,
        "as sharp as allowed": [0.07] * 8,
        "wide arc": [0.0005] * 20,
        "S-bend": [0.0, 0.05, 0.0, -0.05, 0.0],
        "S-bend of arcs": [0.04, 0.04, 0.04, -0.04, -0.04, -0.04],
        "from one extreme to the other": [0.07, -0.07] * 6,
        "zero crossings": [0.01, -0.02, 0.03, -0.01, 0.005, -0.004],
        "in and out": [0.0, 0.0, 0.06, 0.06, 0.0, 0.0],
        "2 samples": [0.01, 0.06],
        "2 samples across zero": [-0.05, 0.05],
        "spiral inwards": [0.005 * i for i in range(14)],
        "long": random_curvatures(rng, 200).tolist(),
        "long and wide": [0.004 * math.sin(0.3 * i) for i in range(300)],
        "nearly equal": [0.05, 0.05 + 2e-9, 0.05 + 1e-7, 0.05 + 1e-7 + 5e-10, 0.05],
        "nearly straight": [0.0, 2e-9, 0.0, 5e-10, 1e-9, 2e-10, 2e-10],
        "nearly equal, then not": [0.02, 0.02 + 1e-12, 0.03, 0.03 - 1e-11, 0.0],
    }
    roads |= {name: Road(values) for name, values in extreme.items()}
    roads |= {
        "short steps": Road([0.07 * math.sin(0.1 * i) for i in range(120)], 0.5),
        "nearly equal, short steps": Road([0.2, 0.2 + 2e-9, 0.2 + 9e-9, 0.2], 0.5),
        "long steps": Road([0.0, 0.03, -0.03, 0.0], 40.0),
        "odd step": Road([0.01, 0.02, 0.02, -0.01], 7.3),
        "a short road": Road([0.05, -0.05], 2.0),
        "sharper than valid": Road([0.1, -0.1, 0.1, 0.05], 10.0),
        "along spline points": Road.from_points([[0, 0], [30, 8], [55, -10], [90, 20]]),
        "narrow lanes": Road(mother, lane_width=2.75),
        "elsewhere": Road(father, pose=(812.5, -341.25, -2.5), lane_width=3.5),
        "far away": Road(father, pose=(5000.0, 5000.0, 9.0)),
    }
    crest = [(0.0, 0.06), (60.0, 0.06), (180.0, -0.05)]
    roads |= {
        "over a crest": Road(mother, grade=crest),
        "banked": Road([0.0, 0.02, 0.02, 0.0, -0.02, 0.0], 20.0, superelevation=BANK),
        "in space": Road(father, superelevation=BANK, grade=crest, widening=WIDER),
    }
    return roads


BANK: Final = [(0.0, 0.0), (20.0, -0.07), (40.0, -0.07), (80.0, 0.07), (100.0, 0.0)]
WIDER: Final = [(20.0, 0.0), (60.0, 0.6), (100.0, 0.0)]


@dataclass(frozen=True, eq=False)
class ReadLane:
    """The ego lane as another program reads it."""

    centre: FloatArray
    """Points in m, (n, 2), from the road's start to its end."""
    width: float
    """Width in m."""
    height: FloatArray | None = None
    """Heights of the centre in m, (n,), or None if the program gives none."""


def read_with_carla(text: str, road: Road) -> ReadLane:
    """Return lane -1 of CARLA's map at ``road.distances(SPACING)``, 1 mm inside the ends."""
    import carla

    carla_map: Any = carla.Map("road", text)
    distances = np.clip(road.distances(SPACING), 1e-3, road.length - 1e-3)
    places = [carla_map.get_waypoint_xodr(1, -1, s) for s in distances.tolist()]
    # CARLA's y points to the right.
    centre = [(w.transform.location.x, -w.transform.location.y) for w in places]
    height = np.array([w.transform.location.z for w in places])
    return ReadLane(np.array(centre), places[0].lane_width, height=height)


def read_with_sumo(texts: Mapping[str, str], *options: str) -> dict[str, ReadLane]:
    """Return lane -1 of each file as SUMO's netconvert reads it, a polyline.

    One process reads all files, as roads of one net.
    """
    import sumo

    program = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
    attributes = 'id="1" junction="-1"'
    with tempfile.TemporaryDirectory() as folder:
        sources, net = [], Path(folder, "roads.net.xml")
        for i, text in enumerate(texts.values(), start=1):
            assert text.count(attributes) == 1
            sources.append(Path(folder, f"{i}.xodr"))
            sources[-1].write_text(
                text.replace(attributes, f'id="{i}" junction="-1"'), encoding="utf-8"
            )
        files = ",".join(map(str, sources))
        command = [str(program), "--opendrive-files", files, "--output-file", str(net)]
        command += ["--offset.disable-normalization", *options]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        tree = ElementTree.parse(net)
    lanes = {}
    for i, name in enumerate(texts, start=1):
        lane = tree.find(f".//edge[@id='-{i}']/lane")
        assert lane is not None, name
        shape = [[float(v) for v in p.split(",")[:2]] for p in (lane.get("shape") or "").split()]
        lanes[name] = ReadLane(np.array(shape), float(lane.get("width", "nan")))
    return lanes


def distance_at_places(road: Road, lane: ReadLane) -> float:
    """Return the largest distance in m of the lane's points from their places along the road."""
    distances = np.clip(road.distances(SPACING), 1e-3, road.length - 1e-3)
    poses = [road.pose_at(s) for s in distances.tolist()]
    halves = 0.5 * (road.lane_width + profile.value_at(road.widening, distances))
    right = [
        [p.x + half * math.sin(p.heading), p.y - half * math.cos(p.heading)]
        for p, half in zip(poses, halves.tolist(), strict=True)
    ]
    distance = np.hypot(*(lane.centre - np.array(right)).T)
    assert np.isfinite(distance).all()
    return float(distance.max())


def height_difference(road: Road, lane: ReadLane) -> float:
    """Return the largest difference in height from the road's centre line, in m."""
    distances = np.clip(road.distances(SPACING), 1e-3, road.length - 1e-3)
    assert lane.height is not None
    return float(np.abs(lane.height - road.heights(distances)).max())


def distance_from_line(road: Road, lane: ReadLane) -> float:
    """Return the largest distance in m of the lane's polyline and ends from our lane's centre."""
    corners = lane.centre
    steps = [max(1, math.ceil(math.dist(a, b) / 0.1)) for a, b in itertools.pairwise(corners)]
    pieces = [
        np.linspace(a, b, n, endpoint=False)
        for (a, b), n in zip(itertools.pairwise(corners), steps, strict=True)
    ]
    track = road.track(np.concatenate([*pieces, corners[-1:]]))
    ends = (abs(float(track[0, 0])), abs(float(track[-1, 0]) - road.length))
    half = 0.5 * (road.lane_width + profile.value_at(road.widening, track[:, 0]))
    return max(*ends, float(np.abs(track[:, 1] + half).max()))
