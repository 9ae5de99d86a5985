"""Frenetic finds the roads on which an automated driver leaves its lane.

`__all__` lists the public names of the top package. Each is imported when it is used, so ``import
frenetic`` takes no time, and the command line can answer Ctrl-C before slow imports.
"""

TYPE_CHECKING = False  # as in `typing`, whose import takes time
if TYPE_CHECKING:
    from typing import Any

    from frenetic.campaign import Budget, Campaign, CampaignStore, Test
    from frenetic.drivers import (
        BeamngAi,
        Camera,
        Controls,
        Delayed,
        Driver,
        DriveSetup,
        LimitedView,
        Noisy,
        Observation,
        Planner,
        Stanley,
    )
    from frenetic.errors import FreneticError
    from frenetic.export import data_frame
    from frenetic.oracle.outcome import Outcome
    from frenetic.oracle.verdict import Result, judge
    from frenetic.report import Results, draw_drive, draw_road, resume, run
    from frenetic.road import Road, check_validity
    from frenetic.search import (
        Candidate,
        Evaluation,
        Frenetic,
        Frenetic2021,
        RandomSearch,
        Strategy,
    )
    from frenetic.simulators import (
        Drive,
        EmbeddedSimulator,
        Motion,
        Rules,
        Simulator,
        SteppedSimulator,
        Vehicle,
    )
    from frenetic.spec import Spec
    from frenetic.spec.terms import Terms

_MODULES = {
    "BeamngAi": "frenetic.drivers",
    "Budget": "frenetic.campaign",
    "Camera": "frenetic.drivers",
    "Campaign": "frenetic.campaign",
    "CampaignStore": "frenetic.campaign",
    "Candidate": "frenetic.search",
    "Controls": "frenetic.drivers",
    "Delayed": "frenetic.drivers",
    "Drive": "frenetic.simulators",
    "DriveSetup": "frenetic.drivers",
    "Driver": "frenetic.drivers",
    "EmbeddedSimulator": "frenetic.simulators",
    "Evaluation": "frenetic.search",
    "Frenetic": "frenetic.search",
    "Frenetic2021": "frenetic.search",
    "FreneticError": "frenetic.errors",
    "LimitedView": "frenetic.drivers",
    "Motion": "frenetic.simulators",
    "Noisy": "frenetic.drivers",
    "Observation": "frenetic.drivers",
    "Outcome": "frenetic.oracle.outcome",
    "Planner": "frenetic.drivers",
    "RandomSearch": "frenetic.search",
    "Result": "frenetic.oracle.verdict",
    "Results": "frenetic.report",
    "Road": "frenetic.road",
    "Rules": "frenetic.simulators",
    "Simulator": "frenetic.simulators",
    "Spec": "frenetic.spec",
    "Stanley": "frenetic.drivers",
    "SteppedSimulator": "frenetic.simulators",
    "Strategy": "frenetic.search",
    "Terms": "frenetic.spec.terms",
    "Test": "frenetic.campaign",
    "Vehicle": "frenetic.simulators",
    "check_validity": "frenetic.road",
    "data_frame": "frenetic.export",
    "draw_drive": "frenetic.report",
    "draw_road": "frenetic.report",
    "judge": "frenetic.oracle.verdict",
    "resume": "frenetic.report",
    "run": "frenetic.report",
}
"""Public name -> module from which `__getattr__` imports it on use."""


def __getattr__(name: str) -> "Any":
    """Import a public name when it is used first."""
    from frenetic._support.lazy_names import import_name  # not needed by ``import frenetic``

    return import_name(__name__, _MODULES, name)


__all__ = [
    "BeamngAi",
    "Budget",
    "Camera",
    "Campaign",
    "CampaignStore",
    "Candidate",
    "Controls",
    "Delayed",
    "Drive",
    "DriveSetup",
    "Driver",
    "EmbeddedSimulator",
    "Evaluation",
    "Frenetic",
    "Frenetic2021",
    "FreneticError",
    "LimitedView",
    "Motion",
    "Noisy",
    "Observation",
    "Outcome",
    "Planner",
    "RandomSearch",
    "Result",
    "Results",
    "Road",
    "Rules",
    "Simulator",
    "Spec",
    "Stanley",
    "SteppedSimulator",
    "Strategy",
    "Terms",
    "Test",
    "Vehicle",
    "check_validity",
    "data_frame",
    "draw_drive",
    "draw_road",
    "judge",
    "resume",
    "run",
]


def __dir__() -> list[str]:
    """Return all names, also public ones that are not imported yet."""
    return sorted({*globals(), *__all__})
