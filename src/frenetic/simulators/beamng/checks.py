"""What the BeamNG.tech simulator looks at when it is asked whether it works."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import version
from typing import TYPE_CHECKING, Final

from frenetic.doctor import Check, drive_checks
from frenetic.drivers import BeamngAi
from frenetic.simulators.beamng.errors import BeamngError
from frenetic.simulators.beamng.link import Link, beamngpy, executable

if TYPE_CHECKING:
    from frenetic.simulators.beamng.simulator import BeamngSimulator

_MORE: Final = "see the message; 'frenetic --debug doctor' says more"


def checks(simulator: BeamngSimulator) -> Iterator[Check]:
    """Package, installation, start, version, licence, level, vehicle, and how the car drives."""
    try:
        beamngpy()
    except BeamngError as error:
        yield _broken("package", error)
        return
    yield Check("package", True, f"beamngpy {version('beamngpy')}")
    place = simulator.place
    if place.home is not None:
        try:
            yield Check("installation", True, str(executable(place.home)))
        except BeamngError as error:
            yield _broken("installation", error)
            return
    name = "port" if place.home is None else "start"
    try:
        simulator.connect()
    except BeamngError as error:
        yield _broken(name, error)
        return
    try:
        yield Check(name, True, f"BeamNG.tech {simulator.link.version} answers")
        yield _licence(simulator.link)
        yield from _driving(simulator)
    finally:
        simulator.__exit__(None, None, None)


def _broken(name: str, error: BeamngError) -> Check:
    return Check(name, False, error.found, error.remedy or _MORE)


def _licence(link: Link) -> Check:
    if link.is_licensed:
        return Check("licence", True, "it found its licence")
    return Check(
        "licence",
        False,
        "it did not find its licence",
        f"put tech.key into its user folder{f' ({link.user_folder})' if link.user_folder else ''}",
    )


def _driving(simulator: BeamngSimulator) -> Iterator[Check]:
    try:
        for name, wanted, known in (
            ("level", simulator.level, simulator.link.levels()),
            ("vehicle", simulator.vehicle, simulator.link.vehicles()),
        ):
            if wanted not in known:
                listed = ", ".join(sorted(known)[:20])
                yield Check(name, False, f"there is no {name} {wanted}", f"choose one of {listed}")
                return
            yield Check(name, True, f"{wanted}, one of {len(known)}")
        simulator.measure()
        car = simulator.measured
    except BeamngError as error:
        yield _broken("car", error)
        return
    side = "left" if car.steering > 0.0 else "right"
    yield Check(
        "car",
        True,
        f"{car.length:g} by {car.width:g} m, steers by {abs(car.steering):.2f} rad, a positive"
        f" input to the {side}",
    )
    for driver, who in ((BeamngAi(), "BeamNG.AI"), (None, "Stanley")):
        yield from drive_checks(simulator, driver, who=who)
