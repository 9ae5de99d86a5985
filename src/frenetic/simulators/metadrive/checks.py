"""What the MetaDrive simulator looks at when it is asked whether it works."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Final

from frenetic.doctor import Check, broken, drive_checks

if TYPE_CHECKING:
    from frenetic.simulators.metadrive.simulator import MetaDriveSimulator

PACKAGE: Final = "metadrive-simulator"
EXTRA: Final = 'pip install "frenetic-roads[metadrive]"'


def checks(simulator: MetaDriveSimulator) -> Iterator[Check]:
    """The package, the engine (whose car has to be the one that is known), and two drives.

    Assets are not looked for: the engine draws nothing.
    """
    try:
        yield Check("package", True, f"{PACKAGE} {version(PACKAGE)}")
    except PackageNotFoundError:
        yield Check("package", False, f"{PACKAGE} is not installed", EXTRA)
        return
    try:
        simulator.__enter__()
    except Exception as error:
        yield broken("engine", error, f"the message says what to do; or install it anew: {EXTRA}")
        return
    try:
        yield Check("engine", True, "it starts, without any assets, and has the known car")
        yield from drive_checks(simulator)
    finally:
        simulator.__exit__(None, None, None)
