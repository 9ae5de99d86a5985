"""A simulator with its own loop; tests change its code, and the contract must find each fault."""

from __future__ import annotations

import math

import numpy as np

from frenetic import Drive, Driver, DriveSetup, Road, Rules
from frenetic.drivers.calls import blaming_driver, checked_controls
from frenetic.errors import DriverError, Trouble
from frenetic.oracle import Trajectory
from frenetic.simulators import CarBody, Observer

PERIOD = 0.05  # s


class Bicycle:
    def __init__(self, *, rules: Rules | None = None) -> None:
        self.rules, self.car = rules or Rules(), CarBody()

    def __enter__(self) -> Bicycle:
        return self

    def __exit__(self, *error: object) -> None: ...

    def drive(self, road: Road, driver: Driver) -> Drive:
        limit = self.rules.start_limit_on(road)
        setup = DriveSetup(limit, road.lane_width, PERIOD, 1.2, 1.4, 4.5, 1.6, 0.6, 4.0, 9.0)
        most_records = int(self.rules.timeout(road.length) / PERIOD) + 2
        observer = Observer(road, self.rules, self.car, most_records)
        (x, y), heading, speed = road.sample(1, -road.lane_width / 2)[0], road.pose.heading, 0.0
        steering = throttle = brake = 0.0
        rows: list[list[float]] = []
        trouble: Trouble | None = None
        try:
            with blaming_driver():
                driver.reset(setup)
                for i in range(most_records):
                    yaw_rate = speed * math.tan(steering) / setup.wheelbase
                    motion = [i * PERIOD, x, y, heading, speed, 0.0, yaw_rate]
                    rows.append([*motion, steering, steering, throttle, brake])
                    if not observer.see(i * PERIOD, x, y, heading):
                        break
                    controls = driver.act(observer.observation(speed, yaw_rate, steering))
                    wanted, throttle, brake = checked_controls(controls)
                    steering = min(max(wanted, -setup.max_steering), setup.max_steering)
                    rows[-1][8:] = [wanted, throttle, brake]
                    x += PERIOD * speed * math.cos(heading)
                    y += PERIOD * speed * math.sin(heading)
                    heading += PERIOD * speed * math.tan(steering) / setup.wheelbase
                    speed = max(speed + PERIOD * (4.0 * throttle - 9.0 * brake), 0.0)
        except DriverError as error:
            trouble = Trouble.of(error)
        return Drive(Trajectory.from_rows(np.array(rows)), self.car, self.rules, road, trouble)
