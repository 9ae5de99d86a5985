"""Check whether MetaDrive can draw here, and how large a region; imports nothing of MetaDrive."""

from __future__ import annotations

import functools
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

from frenetic.errors import DriverError, FreneticError
from frenetic.road import Road

PACKAGE: Final = "metadrive"
"""Name of MetaDrive's package."""
REGIONS: Final = (256, 512, 1024, 2048)
"""Sides of the square around the road's start that MetaDrive can draw, in m. Each takes four times
the memory and the time of the one before."""
_TRIAL_LIMIT: Final = 300.0
"""Time that the trial may take, in s; our choice."""
# Opens a buffer like the one that MetaDrive's camera draws into. It runs in another process,
# because a graphics driver may crash, and because a process that has loaded one should not fork.
_TRIAL: Final = """
from panda3d.core import FrameBufferProperties, Texture, loadPrcFileData
loadPrcFileData("", "audio-library-name null\\nframebuffer-multisample 1\\nmultisamples 8")
from direct.filter.FilterManager import FilterManager
from direct.showbase.ShowBase import ShowBase
base = ShowBase(windowType="offscreen")
wanted = FrameBufferProperties()
wanted.float_color = True
wanted.set_rgba_bits(16, 16, 16, 16)
wanted.set_depth_bits(24)
wanted.set_multisamples(16)
scene = FilterManager(base.win, base.cam).render_scene_into(colortex=Texture(), fbprops=wanted)
raise SystemExit(scene is None)
"""


def check_drawing() -> None:
    """Check whether MetaDrive has its assets and can open a buffer for its camera.

    If MetaDrive is not installed, nothing is checked.

    Raises:
        DriverError: MetaDrive cannot draw here.
    """
    package = find_spec(PACKAGE)
    if package is None or package.origin is None:
        return  # starting the simulator raises an error
    if not Path(package.origin).with_name("assets").joinpath("version.txt").is_file():
        raise DriverError(
            "MetaDrive draws with its assets only, and the driver has a camera: get them with"
            " python -m metadrive.pull_asset"
        )
    if not _opens_buffers():
        raise DriverError(
            "MetaDrive cannot draw here, and the driver has a camera: it needs a graphics card"
            " with its driver or, drawing slowly without one, a virtual screen (xvfb-run -a before"
            " the command)"
        )


@functools.cache
def _opens_buffers() -> bool:
    """Return whether Panda3D can open a buffer of the kind that MetaDrive's camera needs."""
    try:
        trial = subprocess.run(  # noqa: S603 - our own code, no shell
            [sys.executable, "-P", "-c", _TRIAL],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_TRIAL_LIMIT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return trial.returncode == 0


def drawn_region(road: Road) -> int:
    """Return the smallest of `REGIONS` that includes both lanes of the road, in m.

    Raises:
        FreneticError: no region is large enough.
    """
    reach = float(np.abs(road.points - road.points[0]).max()) + 2.0 * road.lane_width
    for region in REGIONS:
        if reach <= 0.5 * region:
            return region
    raise FreneticError(
        f"the road reaches {reach:.0f} m from its start: MetaDrive draws {0.5 * REGIONS[-1]:.0f} m"
    )
