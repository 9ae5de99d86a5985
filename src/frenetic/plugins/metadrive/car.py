"""MetaDrive's car as we drive it, and how controls become MetaDrive's actions."""

from __future__ import annotations

from typing import Final, NamedTuple

from frenetic.simulators.drive_loop import RECORD_PERIOD
from frenetic.simulators.embedded.vehicle import Vehicle

PHYSICS_STEP: Final = RECORD_PERIOD / 3
"""Step of the physics, in s: 60 Hz, Bullet's own rate. MetaDrive's 50 Hz do not fit."""

VEHICLE: Final = Vehicle.named("metadrive")
"""Sizes and limits: MetaDrive's ``static_default``, whose parameters are not drawn."""
ENGINE_FORCE: Final = 800.0
"""Force at each wheel at full throttle, in N."""
BRAKE_IMPULSE: Final = 150.0
"""Impulse by which MetaDrive's full brake slows each wheel in a step of the physics, in N s."""
FULL_BRAKE: Final = VEHICLE.brake_deceleration * VEHICLE.mass * PHYSICS_STEP / (4.0 * BRAKE_IMPULSE)
"""Share of MetaDrive's brake that is a driver's full brake: up to it, the car slows in proportion.
MetaDrive's whole pedal is four times as much, more than the tyres hold."""


class Decision(NamedTuple):
    """The car's controls until the next decision."""

    steering: float = 0.0
    """Steering asked of the front wheels in rad, positive to the left."""
    throttle: float = 0.0
    """0..1."""
    brake: float = 0.0
    """1 is `FULL_BRAKE`; MetaDrive's own drivers go beyond."""

    @classmethod
    def of_action(cls, steering: float, throttle_brake: float) -> Decision:
        """Controls of MetaDrive's action, each in -1..1."""
        return cls(
            steering * VEHICLE.steering_limit,
            max(throttle_brake, 0.0),
            max(-throttle_brake, 0.0) / FULL_BRAKE,
        )

    @property
    def wheel_angle(self) -> float:
        """Angle of the front wheels, in rad; MetaDrive's turn at once."""
        return min(max(self.steering, -VEHICLE.steering_limit), VEHICLE.steering_limit)

    @property
    def action(self) -> tuple[float, float]:
        """MetaDrive's action: steering, throttle or brake, each in -1..1; the brake wins."""
        steering = self.wheel_angle / VEHICLE.steering_limit
        if self.brake > 0.0:
            return steering, -min(self.brake * FULL_BRAKE, 1.0)
        return steering, self.throttle
