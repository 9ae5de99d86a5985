from __future__ import annotations

from frenetic.drivers import Delayed, Driver, LimitedView, Noisy, Planner, Stanley
from frenetic.testing import DriverContract
from frenetic.vision.marking_follower import MarkingFollower


class TestPlanner(DriverContract):
    def make(self) -> Driver:
        return Planner()


class TestStanley(DriverContract):
    def make(self) -> Driver:
        return Stanley()


class TestMarkingFollower(DriverContract):
    def make(self) -> Driver:
        return MarkingFollower()


class TestLayers(DriverContract):
    def make(self) -> Driver:
        return Delayed(Noisy(LimitedView(Stanley())), seconds=0.1)
