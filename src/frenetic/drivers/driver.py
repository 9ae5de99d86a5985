"""The `Driver` protocol: the system under test gets observations and answers with controls."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.drivers.camera import Camera
from frenetic.errors import FreneticError

if TYPE_CHECKING:
    from frenetic.drivers.camera import Image
    from frenetic.drivers.lane import Lane
    from frenetic.road import Road

AHEAD_SPACING = 2.0
"""Distance along the road between two points of the view ahead, in m."""
AHEAD_POINTS = 40
"""Number of points of a full view, which is 78 m long."""
DRAG_FADE_SPEED: Final = 0.5
"""Speed below which brakes and `DriveSetup.rolling_drag` fade out, in m/s, for a smooth stop; our
choice."""
MOST_LANE_POINTS: Final = 100_000
"""Number of points of the longest lane that `Observation.lane` returns; our choice."""
_STEPS_ROUNDING: Final = 1e-9
"""Number of steps by which a computed number may fall short of a whole number; our choice."""


@dataclass(frozen=True)
class DriveSetup:
    """The setup of a drive for its driver: the car, the lane and the speed limit at the start."""

    speed_limit: float
    """Speed limit at the start, in m/s; later ones are in `Observation.speed_limit`."""
    lane_width: float
    """Width of the lane, in m."""
    period: float
    """Time between two calls of `act`, in s."""
    front_axle: float
    """Distance from the centre of mass to the front axle, in m."""
    rear_axle: float
    """Distance from the centre of mass to the rear axle, in m."""
    car_length: float
    """Length of the car, in m."""
    car_width: float
    """Width of the car, in m."""
    max_steering: float
    """Largest angle of the front wheels, in rad."""
    max_acceleration: float
    """Acceleration at full throttle and low speed, in m/s^2."""
    max_deceleration: float
    """Deceleration at full brake on a dry road, in m/s^2."""
    switch_speed: float = math.inf
    """Speed above which the engine's power limits the acceleration, in m/s: above it, the largest
    acceleration is proportional to 1/speed."""
    rolling_drag: float = 0.0
    """Deceleration of a rolling car without pedals, in m/s^2; 0 if the simulator does not know."""
    air_drag: float = 0.0
    """Deceleration by the air per square of the speed, in 1/m; 0 if the simulator does not know."""
    mass: float | None = None
    """Mass of the car, in kg. This field and the fields below are None if the simulator does not
    know."""
    yaw_inertia: float | None = None
    """Yaw inertia about the vertical axis, in kg m^2."""
    front_cornering_stiffness: float | None = None
    """Lateral force of the front axle per slip angle, for small slip angles and the load at rest,
    in N/rad, positive. For a Pacejka tyre: B C D times the load of both wheels."""
    rear_cornering_stiffness: float | None = None
    """Lateral force of the rear axle per slip angle, in N/rad, positive."""
    steering_rate: float | None = None
    """Fastest change of the front wheels' angle, in rad/s."""
    steering_lag: float | None = None
    """Time constant with which the front wheels follow the wanted angle, in s."""

    @property
    def wheelbase(self) -> float:
        """Distance between the axles, in m."""
        return self.front_axle + self.rear_axle


@dataclass(frozen=True, eq=False)
class Observation:
    """What a driver sees: its car relative to the ego lane, and the lane ahead."""

    time: float
    """Time since the start, in s."""
    speed: float
    """Speed along the car, in m/s."""
    yaw_rate: float
    """Yaw rate in rad/s, positive to the left."""
    steering: float
    """Angle of the front wheels in rad, positive to the left."""
    lateral_offset: float
    """Offset of the centre of mass to the left of the ego lane's centre line, in m."""
    heading_error: float
    """Heading of the car minus heading of the lane, in rad from -pi to pi, positive if the car
    points to the left."""
    ahead: FloatArray
    """Points of the ego lane's centre line in the car's frame, (n, 2) in m: x ahead, y to the left.

    The origin is the centre of mass. The first point is beside it, and the next points follow every
    2 m of road; beyond the road's end they continue straight. n is at most 40; a limited view has
    fewer points."""
    curvature_ahead: FloatArray
    """Curvature of the ego lane's centre line at the points of `ahead`, (n,) in 1/m."""
    distance: float = 0.0
    """Distance along the road, in m."""
    image: Image | None = None
    """The camera's picture, (height, width, 3) RGB from 0 to 255; None without a camera.

    The first row is on top."""
    x: float = 0.0
    """Coordinate of the centre of mass on the map, in m."""
    y: float = 0.0
    """Coordinate of the centre of mass on the map, in m."""
    heading: float = 0.0
    """Heading of the car on the map, in rad counter-clockwise from +x, without jumps by a turn."""
    lateral_speed: float = 0.0
    """Speed across the car, in m/s, positive to the left."""
    view: float = math.inf
    """Length of road ahead at which `lane` ends, in m; infinite unless the view is limited."""
    speed_limit: float = math.inf
    """Speed limit where the car is, in m/s."""
    speed_limit_ahead: FloatArray = field(default_factory=lambda: np.empty(0))
    """Lowest speed limit from each point of `ahead` to the next, (n,) in m/s; empty if the
    simulator does not know."""
    _road: Road | None = field(default=None, repr=False)
    """Road of the drive, for `lane`; None if the simulator makes observations without it."""

    def lane(self, spacing: float = 1.0, ahead: float = 100.0, behind: float = 0.0) -> Lane:
        """Return the ego lane's centre line, at any spacing and length, also behind the car.

        The lane is computed from this observation's `distance`, `lateral_offset` and
        `heading_error`. A wrapper that changes these values changes the lane, too, and a wrapper
        that limits the view makes the lane shorter. Beyond both ends of the road the lane continues
        straight, as `ahead` does.

        Args:
            spacing: distance along the road between two points, in m; one point is beside the car.
            ahead: length of road ahead of the car, in m.
            behind: length of road behind the car, in m.

        Raises:
            ValueError: a length is out of range, or the lane has too many points.
            FreneticError: the observation does not say on which road the car is.
        """
        from frenetic.drivers.lane import lane_of  # numba takes its time

        if self._road is None:
            raise FreneticError("no lane is known: the simulator makes observations of its own")
        if not (spacing > 0.0 and ahead >= 0.0 and behind >= 0.0):
            raise ValueError(
                f"a lane {ahead:g} m ahead and {behind:g} m behind, every {spacing:g} m: numbers"
                " of at least 0 and a spacing above 0 are needed"
            )
        lengths = (behind / spacing, min(ahead, self.view) / spacing)
        if not sum(lengths) < MOST_LANE_POINTS:
            raise ValueError(
                f"a lane {ahead:g} m ahead and {behind:g} m behind, every {spacing:g} m: at most"
                f" {MOST_LANE_POINTS} points are allowed"
            )
        # Whole numbers of steps, in spite of rounding: 0.3 m are 3 steps of 0.1 m.
        steps_behind, steps_ahead = (math.floor(length + _STEPS_ROUNDING) for length in lengths)
        return lane_of(
            self._road,
            self.distance,
            self.lateral_offset,
            self.heading_error,
            spacing * np.arange(-steps_behind, steps_ahead + 1, dtype=np.float64),
        )


def new_observation(attributes: dict[str, Any]) -> Observation:
    """Return an observation with all these attributes, of which it keeps the dictionary.

    The constructor takes three times as long, since it sets each attribute by a call.
    """
    observation = object.__new__(Observation)
    object.__setattr__(observation, "__dict__", attributes)
    return observation


def changed_observation(observation: Observation, **attributes: Any) -> Observation:
    """Return an observation with some other attributes, as `dataclasses.replace` does."""
    return new_observation(vars(observation) | attributes)


@dataclass(frozen=True)
class Controls:
    """A driver's answer, which holds until its next answer."""

    steering: float
    """Wanted angle of the front wheels in rad, positive to the left; the car limits it."""
    throttle: float = 0.0
    """Position of the throttle pedal, 0 to 1; values outside are cut."""
    brake: float = 0.0
    """Position of the brake pedal, 0 to 1; values outside are cut."""

    @classmethod
    def from_acceleration(
        cls, acceleration: float, steering: float, *, speed: float, setup: DriveSetup
    ) -> Controls:
        """Return controls for an acceleration, as far as the car's engine and brakes allow.

        The pedals make up for the drag in the setup. An acceleration beyond the car's abilities
        becomes a full pedal.

        Args:
            acceleration: wanted acceleration, in m/s^2, negative to brake.
            steering: wanted angle of the front wheels, in rad, positive to the left.
            speed: speed of the car, `Observation.speed`, in m/s.
            setup: the setup with which the driver was reset.
        """
        rolling_drag = setup.rolling_drag * min(max(speed / DRAG_FADE_SPEED, -1.0), 1.0)
        wanted = acceleration + rolling_drag + setup.air_drag * speed * abs(speed)
        max_acceleration = setup.max_acceleration
        if speed > setup.switch_speed:
            max_acceleration *= setup.switch_speed / speed
        if wanted >= 0.0:
            return cls(steering, throttle=min(wanted / max_acceleration, 1.0))
        return cls(steering, brake=min(-wanted / setup.max_deceleration, 1.0))


@runtime_checkable
class Driver(Protocol):
    """The system under test.

    A simulator calls `reset` before every drive and `act` in every control period, by default 20
    times a second. A driver may be of any class that has these two methods. It must behave the same
    after every `reset`, or a failing road cannot be reproduced: draw random numbers from a
    generator that `reset` makes from a fixed seed.

    An attribute ``period`` of the driver, 0.01 to 0.2 s, sets another control period.
    """

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive and prepare for the next."""

    def act(self, observation: Observation) -> Controls:
        """Return the controls for the next period."""


@runtime_checkable
class SelectiveDriver(Driver, Protocol):
    """A driver that cannot drive in every simulator."""

    def check_simulator(self, simulator: Any) -> None:
        """Raise a `DriverError` if the driver cannot drive in this simulator."""


@runtime_checkable
class CameraDriver(Driver, Protocol):
    """A driver that sees through a camera: its observations have an `image`."""

    camera: Camera
    """The driver's camera, the same in every drive."""
