"""MetaDrive's car: its sizes and forces, and controls as MetaDrive's actions."""

from __future__ import annotations

from typing import Final, NamedTuple

from frenetic.simulators.drive_loop import RECORD_PERIOD
from frenetic.simulators.embedded.vehicle import Vehicle

PHYSICS_STEP: Final = RECORD_PERIOD / 3
"""Step of the physics, in s: 60 Hz, the default rate of Bullet. MetaDrive's 50 Hz do not divide the
record period."""

VEHICLE: Final = Vehicle.named("metadrive")
"""Sizes and limits of MetaDrive's vehicle ``static_default``, whose parameters are not random."""
ENGINE_FORCE: Final = 800.0
"""Force at each wheel at full throttle, in N."""
BRAKE_IMPULSE: Final = 150.0
"""Impulse by which MetaDrive's full brake slows each wheel in a step of the physics, in N s."""
FULL_BRAKE: Final = VEHICLE.brake_deceleration * VEHICLE.mass * PHYSICS_STEP / (4.0 * BRAKE_IMPULSE)
"""Share of MetaDrive's brake pedal that a driver's full brake stands for. Up to it the deceleration
is proportional to the pedal; the whole pedal brakes four times as hard, beyond the tyres' grip."""


class Decision(NamedTuple):
    """Controls of the car until the next decision."""

    steering: float = 0.0
    """Steering asked of the front wheels in rad, positive to the left."""
    throttle: float = 0.0
    """Throttle, 0..1."""
    brake: float = 0.0
    """Brake, where 1 stands for `FULL_BRAKE`; MetaDrive's drivers may brake harder."""

    @classmethod
    def of_action(cls, steering: float, throttle_brake: float) -> Decision:
        """Return the controls that an action of MetaDrive stands for.

        Args:
            steering: steering, -1..1, positive to the left.
            throttle_brake: throttle (above 0) or brake (below 0), -1..1.
        """
        return cls(
            steering * VEHICLE.steering_limit,
            max(throttle_brake, 0.0),
            max(-throttle_brake, 0.0) / FULL_BRAKE,
        )

    @property
    def wheel_angle(self) -> float:
        """Angle of the front wheels, in rad; MetaDrive's wheels turn at once."""
        return min(max(self.steering, -VEHICLE.steering_limit), VEHICLE.steering_limit)

    @property
    def action(self) -> tuple[float, float]:
        """MetaDrive's action: steering, and throttle or brake, each -1..1.

        With throttle and brake at once, the brake counts.
        """
        steering = self.wheel_angle / VEHICLE.steering_limit
        if self.brake > 0.0:
            return steering, -min(self.brake * FULL_BRAKE, 1.0)
        return steering, self.throttle
