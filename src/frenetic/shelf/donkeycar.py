"""donkeycar's `LineFollower`: a line in one row of a camera's picture, and a PID (MIT licence)."""

from __future__ import annotations

from types import SimpleNamespace
from typing import ClassVar

from frenetic._support.bounds import Positive, check
from frenetic.drivers import Camera, Controls, DriveSetup, Observation
from frenetic.shelf import package, speed_plan


class Donkeycar:
    """donkeycar's LineFollower on the white line at its lane's right edge, by camera alone.

    It holds the line at the column where it first sees it. The glue chooses the colour, the row
    and the gains, since those of its template are for yellow tape on the floor of a room, and shows
    it the right half of the picture: it takes the brightest column, whichever line that is. The
    time of its PID is the drive's. Its throttle is left out: it knows no speed.

    Args:
        lateral: m/s^2, lateral acceleration that the planned speed keeps to in bends.
        gain: share of full lock per pixel.
        damping: s, of the line's speed across the picture.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Raised when its controls change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("donkeycar",)
    """Distributions whose versions belong to it."""

    def __init__(
        self, *, lateral: Positive = 2.0, gain: Positive = 0.005, damping: Positive = 0.1
    ) -> None:
        check(locals(), Donkeycar.__init__)
        self.options = {"lateral": lateral, "gain": gain, "damping": damping}
        self.camera = Camera(width=160, height=120)
        self._pid = package("simple_pid", "donkeycar").PID
        self._follower = package("donkeycar.parts.line_follower", "donkeycar").LineFollower

    def reset(self, setup: DriveSetup) -> None:
        """Makes a follower that has not seen the line yet."""
        self._setup, self._plan = setup, speed_plan(setup, self.options["lateral"])
        gain, self._time = self.options["gain"], 0.0
        damping = gain * self.options["damping"]
        # Positive steers to the right, as in donkeycar: where the line is.
        pid = self._pid(-gain, 0.0, -damping, sample_time=None, time_fn=lambda: self._time)
        config = SimpleNamespace(
            OVERLAY_IMAGE=False,
            SCAN_Y=75,
            SCAN_HEIGHT=6,
            COLOR_THRESHOLD_LOW=(0, 0, 170),
            COLOR_THRESHOLD_HIGH=(180, 60, 255),
            TARGET_PIXEL=None,
            TARGET_THRESHOLD=10,
            CONFIDENCE_THRESHOLD=1,
            THROTTLE_INITIAL=0.0,
            THROTTLE_STEP=0.0,
            THROTTLE_MAX=0.0,
            THROTTLE_MIN=0.0,
        )
        self._part = self._follower(pid, config)

    def act(self, observation: Observation) -> Controls:
        """Its steering."""
        self._time = observation.time + 1.0  # its PID divides by the time since it was made
        assert observation.image is not None
        half = observation.image[:, observation.image.shape[1] // 2 :]
        steering, _, _ = self._part.run(half)
        steering = min(max(float(steering), -1.0), 1.0)
        return self._plan.controls(observation, -steering * self._setup.max_steering)
