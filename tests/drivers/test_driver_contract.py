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


class Own:
    """A driver that steers as Stanley does, and goes wrong in one way."""

    def __init__(self, **wrong: Any) -> None:
        self.stanley, self.wrong, self.drives = Stanley(), wrong, 0

    def reset(self, setup: DriveSetup) -> None:
        self.drives += 1
        self.stanley.reset(setup)

    def act(self, observation: Observation) -> Any:
        controls = self.stanley.act(observation)
        if self.wrong.get("forgets_nothing"):
            return replace(controls, steering=controls.steering + 1e-3 * self.drives)
        return replace(controls, **self.wrong) if self.wrong else None


class Eager(Own):
    """A correct driver: what its pedals ask for beyond 0 to 1 is cut."""

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
        (Own(throttle=0.0), "keeps_a_straight_lane", "Car moved less than 1 m in 10 s at 0 m"),
        (Own(steering=math.nan), "keeps_a_straight_lane", "steering = nan, not a finite number"),
        (Own(forgets_nothing=True), "behaves_the_same_after_reset", "reset has to forget all"),
        (Own(), "controls_are_numbers", "the driver returned NoneType instead of"),
        (Own(brake="much"), "controls_are_numbers", "brake = 'much', not a finite number"),
    ],
)
def test_the_contract_says_what_is_wrong(driver: Any, test: str, message: str) -> None:
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
        (Own(steering=-0.1), "left-hand circle: 3.42 m right of its lane"),
        (Own(steering=-0.1), "wheels point 0.100 rad to the right"),
        (Own(throttle=0.0, brake=1.0), "left-hand circle: it ends after 0 of 170 m"),
        (Own(), "the driver returned NoneType instead of"),
    ],
)
def test_the_trackers_contract_says_what_is_wrong(driver: Driver, message: str) -> None:
    class Contract(TrackerContract):
        def make(self) -> Driver:
            return driver

    with pytest.raises(AssertionError) as caught:
        Contract().test_keeps_to_its_lanes_centre("left-hand circle")
    assert message in str(caught.value)
