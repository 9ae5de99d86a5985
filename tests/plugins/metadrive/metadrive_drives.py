"""Roads, drivers and digests for the tests of MetaDrive."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from itertools import islice
from pathlib import Path

import numpy as np

from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.road import Pose, Road
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators import Drive

STRAIGHT = Road(np.zeros(21), pose=Pose(100.0, 10.0, 1.5))
WINDING = Road(
    [0.0, 0.0, 0.02, 0.03, 0.0, -0.02, -0.04, -0.01, 0.02, 0.03, 0.0, 0.0],
    pose=Pose(90.0, 40.0, 2.0),
)


def random_roads(count: int) -> list[Road]:
    return list(islice(RandomRoads().valid(np.random.default_rng(7)), count))


class Fixed:
    """Repeats its controls from a time on, in s; other controls before."""

    def __init__(self, controls: Controls, since: float = 0.0, before: Controls | None = None):
        self.controls, self.since, self.before = controls, since, before or Controls(0.0)

    def reset(self, setup: DriveSetup) -> None:
        self.setup = setup

    def act(self, observation: Observation) -> Controls:
        return self.controls if observation.time >= self.since else self.before


def digest(drive: Drive) -> str:
    return hashlib.sha256(drive.trajectory.to_rows().tobytes()).hexdigest()


def run(code: str, **environment: str) -> str:
    """Run Python code in another process; return its output."""
    process = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=Path(__file__).parent,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 0, process.stderr
    assert not process.stderr
    return process.stdout
