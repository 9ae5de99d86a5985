"""The contracts of drivers: our drivers pass, and each fault fails its test."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from frenetic.drivers import (
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
from frenetic.plugins.vision.marking_follower import MarkingFollower
from frenetic.testing import DriverContract, TrackerContract


class TestPlanner(DriverContract):
    def make(self) -> Driver:
        return Planner()


class TestStanley(DriverContract):
    def make(self) -> Driver:
        return Stanley()


class TestTracker(TrackerContract):
    def make(self) -> Driver:
        return Stanley()


class TestMarkingFollower(DriverContract):
    def make(self) -> Driver:
        return MarkingFollower()


class TestWrappers(DriverContract):
    def make(self) -> Driver:
        return Delayed(Noisy(LimitedView(Stanley())), seconds=0.1)


class FaultyStanley:
    """Stanley with one fault: other values of its controls, no controls, or a memory of drives."""

    def __init__(self, **changes: Any) -> None:
        self.stanley, self.changes, self.drives = Stanley(), changes, 0

    def reset(self, setup: DriveSetup) -> None:
        self.drives += 1
        self.stanley.reset(setup)

    def act(self, observation: Observation) -> Any:
        controls = self.stanley.act(observation)
        if self.changes.get("forgets_nothing"):
            return replace(controls, steering=controls.steering + 1e-3 * self.drives)
        return replace(controls, **self.changes) if self.changes else None


class Eager(FaultyStanley):
    """A correct driver whose pedals go beyond 0 to 1, where they are cut."""

    def act(self, observation: Observation) -> Controls:
        controls = self.stanley.act(observation)
        pedal = 3.0 * (controls.throttle - controls.brake)
        return Controls(controls.steering, pedal, -pedal)


class TestEager(DriverContract):
    def make(self) -> Driver:
        return Eager()


@pytest.mark.parametrize(
    ("driver", "test", "message"),
    [
        (object(), "is_a_driver", "it needs the methods reset and act"),
        (
            FaultyStanley(throttle=0.0),
            "keeps_a_straight_lane",
            "Car moved less than 1 m in 10 s at 0 m",
        ),
        (
            FaultyStanley(steering=math.nan),
            "keeps_a_straight_lane",
            "steering = nan, not a finite number",
        ),
        (
            FaultyStanley(forgets_nothing=True),
            "behaves_the_same_after_reset",
            "reset has to forget all",
        ),
        (FaultyStanley(), "controls_are_numbers", "the driver returned NoneType instead of"),
        (
            FaultyStanley(brake="much"),
            "controls_are_numbers",
            "brake = 'much', not a finite number",
        ),
    ],
)
def test_a_failing_contract_names_the_fault(driver: Any, test: str, message: str) -> None:
    class Contract(DriverContract):
        def make(self) -> Driver:
            instance: Driver = driver
            return instance

    with pytest.raises(AssertionError) as caught:
        getattr(Contract(), f"test_{test}")()
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        (FaultyStanley(steering=-0.1), "left-hand circle: 3.42 m right of its lane"),
        (FaultyStanley(steering=-0.1), "wheels point 0.100 rad to the right"),
        (FaultyStanley(throttle=0.0, brake=1.0), "left-hand circle: it ends after 0 of 170 m"),
        (FaultyStanley(), "the driver returned NoneType instead of"),
    ],
)
def test_a_failing_tracker_contract_names_the_fault(driver: Driver, message: str) -> None:
    class Contract(TrackerContract):
        def make(self) -> Driver:
            return driver

    with pytest.raises(AssertionError) as caught:
        Contract().test_keeps_to_its_lanes_centre("left-hand circle")
    assert message in str(caught.value)
