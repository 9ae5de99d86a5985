"""A sound driver, and drivers that each add one known fault to it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from frenetic.drivers import Controls, DriveSetup, Observation, Planner

SPACING: Final = 2.0  # [m] of the view
COMFORT: Final = 4.0  # [m/s^2] of lateral acceleration


class Sound(Planner):
    """Takes bends at 4 m/s² and brakes for them in time."""

    def __init__(self, lateral_acceleration: float = COMFORT) -> None:
        super().__init__(lateral_acceleration=lateral_acceleration, braking=3.0)


class BrakesLate(Sound):
    """Looks at the next 12 m of road only when it chooses its speed."""

    def act(self, observation: Observation) -> Controls:
        near = observation.curvature_ahead[: round(12.0 / SPACING)]
        wanted = min(math.sqrt(COMFORT / max(np.abs(near).max(), 1e-6)), 70.0 / 3.6)
        missing = 0.5 * (wanted - observation.speed)
        pedals = float(np.clip(missing, 0.0, 1.0)), float(np.clip(-missing, 0.0, 1.0))
        return Controls(super().act(observation).steering, *pedals)


class WeakSteering(Sound):
    """Steers half as much as it should."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return replace(controls, steering=0.5 * controls.steering)


class ShortWheelbase(Sound):
    """Believes that its car is half as long as it is."""

    def reset(self, setup: DriveSetup) -> None:
        half = 0.5 * setup.front_axle, 0.5 * setup.rear_axle
        super().reset(replace(setup, front_axle=half[0], rear_axle=half[1]))


class Lagging(Sound):
    """Steers half a second late."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.steering = 0.0

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        self.steering += 0.1 * (controls.steering - self.steering)
        return replace(controls, steering=self.steering)


class Limited(Sound):
    """Cuts its steering at 0.08 rad."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return replace(controls, steering=float(np.clip(controls.steering, -0.08, 0.08)))


class WrongSign(Sound):
    """Steers to the right in left-hand bends."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        is_left = controls.steering > 0.03
        return replace(controls, steering=-controls.steering) if is_left else controls


class TooFast(Sound):
    """Believes that its tyres hold 14 m/s²."""

    def __init__(self) -> None:
        super().__init__(lateral_acceleration=14.0)


class CutsBends(Sound):
    """Aims at a point 70 m² times the curvature inside its lane's centre."""

    def act(self, observation: Observation) -> Controls:
        shift = 70.0 * observation.curvature_ahead
        ahead = observation.ahead + np.column_stack([np.zeros(len(shift)), shift])
        return super().act(replace(observation, ahead=ahead))


class Raises(Sound):
    """Raises an error where the road bends sharply."""

    def act(self, observation: Observation) -> Controls:
        if np.abs(observation.curvature_ahead).max() > 0.064:
            raise ValueError("no plan")
        return super().act(observation)


class Stops(Sound):
    """Stops in front of sharp bends."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        is_sharp = np.abs(observation.curvature_ahead[:10]).max() > 0.06
        return replace(controls, throttle=0.0, brake=1.0) if is_sharp else controls


class Unrepeatable(Sound):
    """Steers with noise whose generator is not reset between drives."""

    def __init__(self) -> None:
        super().__init__()
        self.noise = np.random.default_rng(1)

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return replace(controls, steering=controls.steering + self.noise.normal(0.0, 0.3))


class WrongFeedForward(Sound):
    """Steers by the curvature ahead, with the wrong sign where the road bends sharply."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.wheelbase = setup.wheelbase

    def act(self, observation: Observation) -> Controls:
        bends = observation.curvature_ahead
        bend = float(bends[min(int(0.3 * observation.speed / SPACING), len(bends) - 1)])
        bend = -bend if abs(bend) > 0.04 else bend
        steering = math.atan(self.wheelbase * bend)
        steering -= 0.08 * observation.lateral_offset + 0.6 * observation.heading_error
        return replace(super().act(observation), steering=steering)


class RateLimited(Sound):
    """Turns its steering by 0.15 rad/s at most."""

    def __init__(self) -> None:
        super().__init__(lateral_acceleration=5.0)

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.steering = 0.0

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        change = float(np.clip(controls.steering - self.steering, -0.0075, 0.0075))
        self.steering += change
        return replace(controls, steering=self.steering)


class WindUp(Sound):
    """Adds the integral of its offset without a limit."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.integral = 0.0

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        self.integral += 0.05 * observation.lateral_offset
        return replace(controls, steering=controls.steering - 0.25 * self.integral)


class Degrees(Sound):
    """Gives its steering in degrees."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return replace(controls, steering=math.degrees(controls.steering))


class LateSpeed(Sound):
    """Sees the speed that its car had 1.5 s ago."""

    def reset(self, setup: DriveSetup) -> None:
        super().reset(setup)
        self.speeds: list[float] = []

    def act(self, observation: Observation) -> Controls:
        self.speeds.append(observation.speed)
        return super().act(replace(observation, speed=self.speeds[max(len(self.speeds) - 31, 0)]))


class DeadBand(Sound):
    """Does not steer by less than 0.07 rad."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return controls if abs(controls.steering) > 0.07 else replace(controls, steering=0.0)


class BothPedals(Sound):
    """Presses the throttle by 0.6, and the brake by 0.3 at least."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return replace(controls, throttle=0.6, brake=max(controls.brake, 0.3))
