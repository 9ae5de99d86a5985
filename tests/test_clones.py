"""The glue that `docs/clones.md` shows, over stand-ins of the controllers."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest
from adapter_standins import write_standins
from page_files import page_file

from frenetic import Driver, EmbeddedSimulator, Rules
from frenetic.parts.registry import DRIVERS
from frenetic.testing import TrackerContract
from frenetic.testing.tracker_contract import ROADS

GLUE = {
    "bench2drive.py": "Bench2Drive",
    "challenge.py": "Challenge",
    "commonroad_pid.py": "CommonroadPid",
    "openpilot_torque.py": "OpenpilotTorque",
}
"""File -> its driver."""
MOST_LINES = 60
NAMES = [
    pytest.param(
        name,
        marks=[
            pytest.mark.heavy,  # it needs opendbc
            pytest.mark.skipif(
                sys.version_info >= (3, 13), reason="opendbc is not packaged for this Python"
            ),
        ]
        if name.startswith("openpilot")
        else [],
    )
    for name in GLUE
]


@pytest.fixture(scope="module")
def clones(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the glue beside the stand-ins."""
    folder = tmp_path_factory.mktemp("clones")
    write_standins(folder)
    for name in GLUE:
        (folder / name).write_text(page_file("clones.md", name), encoding="utf-8")
    return folder


def driver_of(folder: Path, name: str, **options: float) -> Driver:
    driver: Driver = DRIVERS.make(f"{folder / name}:{GLUE[name]}", **options)
    return driver


class TestGlue(TrackerContract):
    """Each glue keeps its lane: signs, units, axles and frames are right."""

    @pytest.fixture(autouse=True, params=NAMES)
    def _named(self, request: pytest.FixtureRequest, clones: Path) -> None:
        self.folder, self.name = clones, request.param

    def make(self) -> Driver:
        return driver_of(self.folder, self.name)


@pytest.mark.parametrize("name", GLUE)
def test_each_glue_is_short(name: str) -> None:
    assert len(page_file("clones.md", name).splitlines()) < MOST_LINES


@pytest.mark.parametrize("name", NAMES)
def test_the_option_lateral_limits_the_speed_in_bends(clones: Path, name: str) -> None:
    simulator = EmbeddedSimulator(rules=Rules(speed_limit=50.0))
    drive = simulator.drive(ROADS["left-hand circle"], driver_of(clones, name, lateral=1.0))
    assert drive.trouble is None, drive.trouble
    assert drive.trajectory.speed[-1] == pytest.approx(math.sqrt(1.0 * 52.0), abs=0.7)
