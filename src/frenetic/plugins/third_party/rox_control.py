"""ROX Automation's `rox-control`: pure pursuit (MIT licence)."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import ClassVar, Final

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.plugins.third_party import LATERAL, package, speed_plan

AHEAD: Final = 60.0
"""Length of track that it is shown, in m."""
SPACING: Final = 5.0
"""Distance between the track's points, in m."""


class RoxControl:
    """rox-control's PurePursuitA, whose target is a fixed distance ahead of the rear axle.

    It steers in proportion to the angle to the target. The glue chooses the gain 2 / `look_ahead`,
    with which that is pure pursuit (R. C. Coulter, CMU-RI-TR-92-01) for small angles, and shows it
    60 m of track. It looks for its place on the lines through the track's segments instead of the
    segments, and so at times takes a target far ahead; then it goes straight on for a moment.

    Args:
        lateral: m/s^2, lateral acceleration that the planned speed keeps to in bends.
        look_ahead: m from the rear axle to the target.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("rox-control",)
    """Distributions whose versions belong to it."""

    def __init__(self, *, lateral: Positive = LATERAL, look_ahead: Positive = 8.0) -> None:
        check(locals(), RoxControl.__init__)
        self.options = {"lateral": lateral, "look_ahead": look_ahead}
        self._controllers = package("rox_control.controllers", "rox-control")
        self._track = package("rox_control", "rox-control").Track

    def reset(self, setup: DriveSetup) -> None:
        """Make the controller."""
        self._setup, self._plan = setup, speed_plan(setup, self.options["lateral"])
        reach = self.options["look_ahead"]
        self._pursuit = self._controllers.PurePursuitA(
            look_ahead_distance=reach, proportional_gain=2.0 / reach
        )

    def act(self, observation: Observation) -> Controls:
        """Return the curvature to drive, in the frame of the rear axle."""
        lane = observation.lane(spacing=SPACING, ahead=AHEAD, behind=SPACING)
        rear = self._setup.rear_axle
        self._pursuit.set_track(self._track([(x + rear, y) for x, y in lane.points.tolist()]))
        curvature = self._pursuit.control(SimpleNamespace(x=0.0, y=0.0, theta=0.0)).curvature
        return self._plan.controls(observation, math.atan(curvature * self._setup.wheelbase))
