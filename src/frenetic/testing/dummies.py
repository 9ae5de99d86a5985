"""Deterministic, cheap stand-ins with a knob, from which tests and plug-ins start."""

from __future__ import annotations

from collections.abc import Callable

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


class DummySimulator(Ready):
    """Moves a car along the ego lane at a steady speed, drifting from its centre; no physics.

    The driver is reset but never asked, the car moves from the first record on, and the drive is
    recorded to the road's last point. A drive fails where the drift takes the car out of the lane,
    so the outcome is a function of the road.

    Args:
        drift: m to the left of the ego lane's centre that the car reaches in the middle of the
            road, given the road.
        rules: when a drive ends.
        speed: m/s.
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
        period = 0.05
        driver.reset(
            DriveSetup(
                speed_limit=self.rules.start_limit_on(road),
                lane_width=road.lane_width,
                period=period,
                front_axle=1.2,
                rear_axle=1.4,
                car_length=self.car.length,
                car_width=self.car.width,
                max_steering=1.0,
                max_acceleration=4.0,
                max_deceleration=9.0,
            )
        )
        n = max(int(road.length / (self.speed * period)), 1) + 1
        along = np.linspace(0.0, road.length, n)
        lateral = -0.5 * road.lane_width + self.drift(road) * np.sin(np.pi * along / road.length)
        poses = [road.pose_at(s) for s in along]
        heading = np.array([pose.heading for pose in poses])
        zeros = np.zeros(n)
        return Drive(
            Trajectory(
                time=period * np.arange(n, dtype=np.float64),
                x=np.array([pose.x for pose in poses]) - lateral * np.sin(heading),
                y=np.array([pose.y for pose in poses]) + lateral * np.cos(heading),
                heading=heading,
                speed=np.full(n, self.speed),
                lateral_speed=zeros,
                yaw_rate=np.gradient(heading, period),
                steering=zeros,
                steering_input=zeros,
                throttle=zeros,
                brake=zeros,
            ),
            self.car,
            self.rules,
        )


class DummyDriver:
    """Always answers with the same controls."""

    def __init__(self, steering: float = 0.0, throttle: float = 0.0, brake: float = 0.0) -> None:
        self.controls = Controls(steering, throttle, brake)

    def reset(self, setup: DriveSetup) -> None:
        """Forgets nothing."""

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
    """Ask and tell a strategy with a scripted verdict; return the evaluations in order.

    Args:
        strategy: the strategy that is asked and told.
        verdict: outcome and MOOBD (None unless PASS or FAIL) of a candidate.
        budget: tests to run, each of which spends an equal share of the budget unless INVALID.
        outstanding: candidates asked before the first of them is told.
    """
    evaluations: list[Evaluation] = []
    waiting: list[Candidate] = []
    spent = 0
    while spent < budget:
        while len(waiting) < outstanding and (proposed := strategy.ask()) is not None:
            waiting.append(proposed)
        candidate = waiting.pop(0)
        outcome, moobd = verdict(candidate)
        spent += outcome is not Outcome.INVALID
        evaluation = Evaluation(candidate, outcome, moobd, spent / budget)
        strategy.tell(evaluation)
        evaluations.append(evaluation)
    return evaluations
