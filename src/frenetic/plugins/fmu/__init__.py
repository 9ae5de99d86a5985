"""Functional mock-up units (FMUs) as drivers: controllers that Simulink or Modelica exported.

The names below are imported when they are used, so the command line stays fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from frenetic._support.lazy_names import import_name

if TYPE_CHECKING:
    from frenetic.plugins.fmu.driver import Fmu
    from frenetic.plugins.fmu.instance import FmuError
    from frenetic.plugins.fmu.table import SignalTable, VariableLink

__all__ = ["Fmu", "FmuError", "SignalTable", "VariableLink"]

_MODULES = {
    "Fmu": "frenetic.plugins.fmu.driver",
    "FmuError": "frenetic.plugins.fmu.instance",
    "SignalTable": "frenetic.plugins.fmu.table",
    "VariableLink": "frenetic.plugins.fmu.table",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> Any:
    return import_name(__name__, _MODULES, name)
