"""Decide who broke a drive, the driver or the simulator: by an error or by losing the process."""

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

_FAULT_KINDS: Final = {
    Loss.LATE: HANGS,
    Loss.ENDED: ENDS_ITS_PROCESS,
    Loss.KILLED: IS_KILLED,
    Loss.BROKE_PROTOCOL: BREAKS_PROTOCOL,
}
"""How a process was lost during a drive -> kind of the fault of a driver that lost it."""
_OUR_PURE_SIMULATORS: Final = ("frenetic.simulators.", "frenetic.testing.")
"""Prefixes of the modules whose simulators run no code but Frenetic's."""
_MEMORY_DOUBT: Final = ", by itself or by the system, as where memory is short"


def trouble_of_error(error: BaseException, driver: Driver) -> Trouble:
    """Return the trouble of a drive in which a simulator's ``drive`` raised an error.

    The driver is to blame if its code raised the error, otherwise the simulator is.
    """
    part: Literal["driver", "simulator"]
    part = "driver" if is_of_driver(error, driver) else "simulator"
    return Trouble.of(error, part, f"the {part} raised {describe_raised(error)}")


@dataclass(frozen=True)
class Blame:
    """Rules by which the driver is to blame for a process that was lost during a drive.

    While the driver is asked for controls, a process that ends or hangs is the driver's fault. At
    other times it is the driver's fault only if all other code in the process is Frenetic's. A
    process that breaks the protocol is the driver's fault if the simulator is one of Frenetic's,
    whose code keeps to the protocol.
    """

    losses: frozenset[Loss]
    """Losses that are the driver's fault even while the driver is not asked."""

    @classmethod
    def of(cls, simulator: Simulator, driver: Driver) -> Self:
        """Return the rules for a simulator and a driver in one process."""
        module = type(simulator).__module__
        if all(_is_ours(part) for part in stack_of(driver)) or not module.startswith("frenetic."):
            return cls(frozenset())
        if module.startswith(_OUR_PURE_SIMULATORS):
            return cls(frozenset(_FAULT_KINDS))
        return cls(frozenset({Loss.BROKE_PROTOCOL}))

    def fault(self, error: LostProcessError) -> Fault | None:
        """Return the driver's fault if the driver lost the process, None otherwise."""
        kind = _FAULT_KINDS.get(error.loss)
        was_asked = error.is_drivers_turn and error.loss is not Loss.BROKE_PROTOCOL
        is_drivers = was_asked or error.loss in self.losses
        return Fault("driver", kind) if kind is not None and is_drivers else None


def _is_ours(part: object) -> bool:
    """Return whether the class of a part is Frenetic's."""
    return type(part).__module__.partition(".")[0] == "frenetic"


def trouble_of_lost_process(error: LostProcessError, fault: Fault | None = None) -> Trouble:
    """Return the trouble of a drive whose process was lost.

    Args:
        error: how the process was lost.
        fault: fault of the driver that lost the process; None if the driver is not to blame.
    """
    if error.trouble.traceback:
        return replace(error.trouble, fault=fault)
    doubt = _MEMORY_DOUBT if error.loss is Loss.KILLED else ""
    return Trouble(f"the driver's process was lost: {error}{doubt}", fault=fault)
