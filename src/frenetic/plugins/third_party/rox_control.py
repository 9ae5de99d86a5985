"""The pure pursuit of ROX Automation's `rox-control` (MIT licence)."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import ClassVar, Final

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Controls, DriveSetup, Observation
from frenetic.drivers.half_drivers import LATERAL, speed_plan
from frenetic.plugins.third_party import package

AHEAD: Final = 60.0
"""Length of the track that the controller gets, in m; our choice."""
SPACING: Final = 5.0
"""Distance between two points of the track, in m; our choice."""


class RoxControl:
    """rox-control's PurePursuitA, whose target is a fixed distance ahead of the rear axle.

    The controller steers in proportion to the angle to the target. The glue chooses the gain
    2 / `look_ahead`, which makes this pure pursuit (R. C. Coulter, CMU-RI-TR-92-01) for small
    angles. It gives the controller 60 m of track.

    A weakness of the controller: it looks for the nearest point of the track on the lines through
    the segments rather than on the segments. So it at times takes a target far ahead, and drives
    straight on for a moment.

    Args:
        lateral: largest lateral acceleration of the planned speed in bends, in m/s^2.
        look_ahead: distance from the rear axle to the target, in m.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the behaviour, increased when the controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("rox-control",)
    """Distributions whose versions belong to the behaviour, too."""

    def __init__(self, *, lateral: Positive = LATERAL, look_ahead: Positive = 8.0) -> None:
        check(locals(), RoxControl.__init__)
        self.options = {"lateral": lateral, "look_ahead": look_ahead}
        self._controllers = package("rox_control.controllers", "rox-control")
        self._track = package("rox_control", "rox-control").Track

    def reset(self, setup: DriveSetup) -> None:
        """Make the controller."""
        self._setup, self._plan = setup, speed_plan(setup, self.options["lateral"])
        look_ahead = self.options["look_ahead"]
        self._pursuit = self._controllers.PurePursuitA(
            look_ahead_distance=look_ahead, proportional_gain=2.0 / look_ahead
        )

    def act(self, observation: Observation) -> Controls:
        """Return the steering for the controller's curvature, and the pedals of the speed plan."""
        lane = observation.lane(spacing=SPACING, ahead=AHEAD, behind=SPACING)
        # In the frame of the rear axle, which stands at the origin.
        rear = self._setup.rear_axle
        self._pursuit.set_track(self._track([(x + rear, y) for x, y in lane.points.tolist()]))
        rear_axle_pose = SimpleNamespace(x=0.0, y=0.0, theta=0.0)
        curvature = self._pursuit.control(rear_axle_pose).curvature
        return self._plan.controls(observation, math.atan(curvature * self._setup.wheelbase))
