"""Cheap, deterministic stand-ins for a simulator, a driver and a campaign."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation
from frenetic.search.strategy import Strategy
from frenetic.simulators.simulator import Ready


def no_drift(road: Road) -> float:  # noqa: ARG001
    """Return 0 m for every road."""
    return 0.0


_PERIOD: Final = 0.05
"""Time between two records of a drive, in s."""


class DummySimulator(Ready):
    """A simulator without physics: the car drives at a steady speed and drifts in its lane.

    The driver is reset but never asked for controls. The car moves from the first record on, and
    the drive is recorded to the road's last point. A drive fails where the drift takes the car out
    of its lane, so the outcome is a function of the road.

    Args:
        drift: function of the road that returns how far left of the ego lane's centre the car is in
            the middle of the road, in m.
        rules: rules that say when a drive ends.
        speed: speed of the car, in m/s.
    """

    def __init__(
        self,
        drift: Callable[[Road], float] = no_drift,
        *,
        rules: Rules | None = None,
        speed: float = 10.0,
    ) -> None:
        self.drift = drift
        self.rules = rules or Rules()
        self.car = CarBody()
        self.speed = speed

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Return a drive at 20 Hz from the road's start to its end."""
        driver.reset(
            DriveSetup(
                speed_limit=self.rules.start_limit_on(road),
                lane_width=road.lane_width,
                period=_PERIOD,
                front_axle=1.2,
                rear_axle=1.4,
                car_length=self.car.length,
                car_width=self.car.width,
                max_steering=1.0,
                max_acceleration=4.0,
                max_deceleration=9.0,
            )
        )
        count = max(int(road.length / (self.speed * _PERIOD)), 1) + 1
        distances = np.linspace(0.0, road.length, count)
        drift = self.drift(road) * np.sin(np.pi * distances / road.length)
        offset = -0.5 * road.lane_width + drift  # [m] left of the centre line
        poses = [road.pose_at(distance) for distance in distances]
        heading = np.array([pose.heading for pose in poses])
        zeros = np.zeros(count)
        return Drive(
            Trajectory(
                time=_PERIOD * np.arange(count, dtype=np.float64),
                x=np.array([pose.x for pose in poses]) - offset * np.sin(heading),
                y=np.array([pose.y for pose in poses]) + offset * np.cos(heading),
                heading=heading,
                speed=np.full(count, self.speed),
                lateral_speed=zeros,
                yaw_rate=np.gradient(heading, _PERIOD),
                steering=zeros,
                steering_input=zeros,
                throttle=zeros,
                brake=zeros,
            ),
            self.car,
            self.rules,
        )


class DummyDriver:
    """A driver that always answers with the same controls."""

    def __init__(self, steering: float = 0.0, throttle: float = 0.0, brake: float = 0.0) -> None:
        self.controls = Controls(steering, throttle, brake)

    def reset(self, setup: DriveSetup) -> None:
        """Do nothing: this driver has no memory."""

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002
        """Return the same controls."""
        return self.controls


def converse(
    strategy: Strategy,
    verdict: Callable[[Candidate], tuple[Outcome, float | None]],
    budget: int,
    *,
    outstanding: int = 1,
) -> list[Evaluation]:
    """Run a campaign without a simulator, and return the evaluations in the order of telling.

    Args:
        strategy: the strategy that is asked for candidates and told their evaluations.
        verdict: function of a candidate that returns outcome and MOOBD; the MOOBD is None unless
            the outcome is PASS or FAIL.
        budget: number of tests to run, without INVALID ones; each spends the same share.
        outstanding: number of candidates that are asked before the first of them is told.
    """
    evaluations: list[Evaluation] = []
    waiting: list[Candidate] = []
    tests = 0
    while tests < budget:
        while len(waiting) < outstanding and (proposed := strategy.ask()) is not None:
            waiting.append(proposed)
        candidate = waiting.pop(0)
        outcome, moobd = verdict(candidate)
        tests += outcome is not Outcome.INVALID
        evaluation = Evaluation(candidate, outcome, moobd, tests / budget)
        strategy.tell(evaluation)
        evaluations.append(evaluation)
    return evaluations
