"""Who broke a drive: the driver or the simulator, by an error or with the process."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal, Self

from frenetic.drivers.calls import is_of_driver
from frenetic.drivers.driver import Driver
from frenetic.drivers.stack import stack_of
from frenetic.errors import (
    BREAKS_PROTOCOL,
    ENDS_ITS_PROCESS,
    HANGS,
    IS_KILLED,
    Fault,
    Trouble,
    describe_raised,
)
from frenetic.processes.object_process import Loss, LostProcessError
from frenetic.simulators.simulator import Simulator

_FAULTS: Final = {
    Loss.LATE: HANGS,
    Loss.ENDED: ENDS_ITS_PROCESS,
    Loss.KILLED: IS_KILLED,
    Loss.BROKE_PROTOCOL: BREAKS_PROTOCOL,
}
"""How a process was lost during a drive -> kind of the fault of the driver that did it."""
_OUR_PURE_SIMULATORS: Final = ("frenetic.simulators.", "frenetic.testing.")
"""Beginnings of the names of modules whose simulators run no code but ours."""


def raised(error: BaseException, driver: Driver) -> Trouble:
    """Return the trouble that an error in a simulator's ``drive`` makes, possibly the driver's."""
    part: Literal["driver", "simulator"]
    part = "driver" if is_of_driver(error, driver) else "simulator"
    return Trouble.of(error, part, f"the {part} raised {describe_raised(error)}")


@dataclass(frozen=True)
class Blame:
    """Which losses of a process during a drive are the driver's doing, even if it was not asked.

    A process that ends or hangs while the driver is asked does so by the driver; at other times,
    where the simulator is code of ours alone and the driver is not. A process breaks the protocol
    by the only code in it that is not ours.
    """

    losses: frozenset[Loss]

    @classmethod
    def of(cls, simulator: Simulator, driver: Driver) -> Self:
        """Return which losses of a simulator's process are the driver's doing."""
        home = type(simulator).__module__
        if all(_is_ours(part) for part in stack_of(driver)) or not home.startswith("frenetic."):
            return cls(frozenset())
        if home.startswith(_OUR_PURE_SIMULATORS):
            return cls(frozenset(_FAULTS))
        return cls(frozenset({Loss.BROKE_PROTOCOL}))

    def fault(self, error: LostProcessError) -> Fault | None:
        """Return the driver's fault if the driver lost the process, None otherwise."""
        kind = _FAULTS.get(error.loss)
        was_asked = error.is_drivers_turn and error.loss is not Loss.BROKE_PROTOCOL
        is_drivers = was_asked or error.loss in self.losses
        return Fault("driver", kind) if kind is not None and is_drivers else None


def _is_ours(part: object) -> bool:
    return type(part).__module__.partition(".")[0] == "frenetic"


def lost_process(error: LostProcessError, fault: Fault | None = None) -> Trouble:
    """Return the trouble of a drive whose process was lost.

    Args:
        error: how the process was lost.
        fault: the driver's, if the driver lost the process.
    """
    if error.trouble.traceback:
        return replace(error.trouble, fault=fault)
    doubt = ", by itself or by the system, as where memory is short"
    loss = f"the driver's process was lost: {error}{doubt * (error.loss is Loss.KILLED)}"
    return Trouble(loss, fault=fault)
