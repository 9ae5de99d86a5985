"""Where BeamNG.tech is: an installation to start, or one that is running."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, Final

from frenetic.plugins.beamng.package import BeamngError
from frenetic.plugins.beamng.process import LOOPBACK

DEFAULT_PORT: Final = 25252
"""Port on which BeamNG.tech listens by default."""
HOME_VARIABLE: Final = "BNG_HOME"
"""Environment variable that says where BeamNG.tech is installed."""


def location_arguments(
    home: str | None,
    user: str | None,
    host: str | None,
    port: int | None,
    headless: bool,
    no_gpu: bool,
) -> dict[str, Any]:
    """Return BeamNGpy's arguments that say where BeamNG.tech is.

    With a home, BeamNG.tech is started; with a host or a port, one that is running is connected to.

    Args:
        home: folder of the installation; by default the environment variable `HOME_VARIABLE`.
        user: folder for what BeamNG.tech writes.
        host: host of a running BeamNG.tech.
        port: port of a running BeamNG.tech.
        headless: whether it is started without a window.
        no_gpu: whether it is started without a graphics card.

    Raises:
        BeamngError: no option says where BeamNG.tech is, or the options contradict each other.
    """
    is_running = host is not None or port is not None
    if home is None and not is_running:
        home = os.environ.get(HOME_VARIABLE) or None
        if home is None:
            raise BeamngError(
                "nothing says where BeamNG.tech is: give its folder as home, set"
                f" {HOME_VARIABLE}, or give the port (and the host) of one that runs"
            )
    elif home is not None and is_running:
        raise BeamngError(
            "home excludes host and port: give a home to start BeamNG.tech on this machine, or a"
            " host or port to connect to one that runs"
        )
    if home is None:
        if user or headless or no_gpu:
            raise BeamngError(
                "user, headless and no_gpu are for a BeamNG.tech that is started: give home, too"
            )
        return {"host": host or LOOPBACK, "port": port or DEFAULT_PORT, "home": None}
    folders = {
        name: folder and str(Path(folder).expanduser().resolve())
        for name, folder in (("home", home), ("user", user))
    }
    if " " in (folders["user"] or ""):
        raise BeamngError(
            f"user {user!r}: BeamNG.tech takes no folder with a space in its path; give another"
        )
    return {"host": LOOPBACK, "port": None, **folders, "headless": headless, "nogpu": no_gpu}
