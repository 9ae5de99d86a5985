"""What MetaDrive draws for a driver's camera, and whether it can here; imports nothing of it."""

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
REGIONS: Final = (256, 512, 1024, 2048)
"""Sizes of the square around the road's start that MetaDrive can draw, in m; each takes four times
the memory and the time of the one before."""
_LIMIT: Final = 300.0  # s for the trial
# Opens what MetaDrive's camera draws into. Elsewhere than in this process: a graphics driver may
# crash, and this process may fork.
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
    """Check whether MetaDrive has its assets and can open what its camera draws into.

    Without MetaDrive it checks nothing.

    Raises:
        DriverError: it cannot draw here.
    """
    package = find_spec(PACKAGE)
    if package is None or package.origin is None:
        return  # the simulator says so when it starts
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
    """Return whether Panda3D opens a buffer as MetaDrive's camera needs it."""
    try:
        trial = subprocess.run(  # noqa: S603 - our own code, no shell
            [sys.executable, "-P", "-c", _TRIAL],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_LIMIT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return trial.returncode == 0


def drawn_region(road: Road) -> int:
    """Smallest of `REGIONS` with both lanes of the road in it.

    Raises:
        FreneticError: the road is too long.
    """
    reach = float(np.abs(road.points - road.points[0]).max()) + 2.0 * road.lane_width
    for region in REGIONS:
        if reach <= 0.5 * region:
            return region
    raise FreneticError(
        f"the road reaches {reach:.0f} m from its start: MetaDrive draws {0.5 * REGIONS[-1]:.0f} m"
    )
