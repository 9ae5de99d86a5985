"""Drives of manoeuvres, in any simulator with any driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from frenetic.conditions.condition import START_SPEED, condition_named
from frenetic.drivers.driver import Driver
from frenetic.errors import FreneticError, RoadError
from frenetic.manoeuvres.manoeuvre import Manoeuvre, ManoeuvreDrive, ManoeuvreResult, Measures
from frenetic.oracle.drive import Drive, Rules
from frenetic.oracle.verdict import judge, locate_drive
from frenetic.parts.registry import MANOEUVRES
from frenetic.road import Road
from frenetic.road.validity import LANE_WIDTH
from frenetic.simulators.capabilities import capabilities, check_pair
from frenetic.simulators.conditions import in_conditions, rules_in
from frenetic.simulators.simulator import Simulator


@dataclass(frozen=True)
class ManoeuvrePlan:
    """A manoeuvre with its road and the conditions of its drive, ready to be driven."""

    manoeuvre: Manoeuvre
    road: Road
    conditions: Mapping[str, float]
    """All conditions of the drive: the user's conditions and the manoeuvre's."""
    speed: float
    """Speed limit on the road, in m/s."""
    wheelbase: float | None
    """Distance between the car's axles, in m; None if the simulator does not say."""

    @classmethod
    def of(
        cls,
        manoeuvre: Manoeuvre,
        simulator: Simulator,
        rules: Rules,
        *,
        conditions: Mapping[str, float] = MappingProxyType({}),
        lane_width: float = LANE_WIDTH,
        max_curvature: float | None = None,
    ) -> ManoeuvrePlan:
        """Return the plan of a manoeuvre in a simulator.

        Args:
            manoeuvre: the manoeuvre.
            simulator: the simulator.
            rules: rules of the drive, with the speed limit.
            conditions: conditions of the drive that its user sets; they may hold a speed limit.
            lane_width: width of each lane, in m.
            max_curvature: largest curvature that the road may have, in 1/m; None for the
                competition's.

        Raises:
            RoadError: no road may bend as the manoeuvre asks.
            FreneticError: the user sets a condition that the manoeuvre sets.
        """
        speed = rules_in(conditions, rules).speed_limit / 3.6
        required = dict(manoeuvre.conditions(speed))
        if both := sorted(required.keys() & conditions.keys()):
            raise FreneticError(
                f"the manoeuvre {manoeuvre.name} sets {both[0]} itself: leave the condition out"
            )
        if not capabilities(simulator).can_apply(condition_named(START_SPEED)):
            required.pop(START_SPEED, None)  # the car starts at rest
        road = manoeuvre.road(speed, lane_width)
        sharpest = float(abs(road.curvatures).max())
        if max_curvature is not None and sharpest > max_curvature:
            raise RoadError(
                f"a radius of {1.0 / sharpest:.3g} m: the road class has at least"
                f" {1.0 / max_curvature:.3g} m"
            )
        setup = getattr(simulator, "setup", None)
        wheelbase = setup(road).wheelbase if callable(setup) else None
        return cls(manoeuvre, road, {**conditions, **required}, speed, wheelbase)

    def result(self, drive: Drive) -> ManoeuvreResult:
        """Return the verdict on a drive of the plan's road, and what the manoeuvre measures."""
        result = judge(self.road, drive)
        if result.moobd is None:  # nothing was driven, or the simulator broke
            measures = Measures.missing(self.manoeuvre.QUANTITIES, f"not measured: {result.reason}")
        elif not np.isfinite(drive.trajectory.block).all():
            reason = "not measured: the simulator recorded values that are no numbers"
            measures = Measures.missing(self.manoeuvre.QUANTITIES, reason)
        else:
            located = locate_drive(self.road, drive)
            measures = self.manoeuvre.measure(ManoeuvreDrive(located, self.speed, self.wheelbase))
        return ManoeuvreResult(self.manoeuvre, self.road, drive, result, measures)


def drive_manoeuvre(
    manoeuvre: Manoeuvre | str,
    driver: Driver,
    simulator: Simulator,
    *,
    conditions: Mapping[str, float] = MappingProxyType({}),
    lane_width: float = LANE_WIDTH,
    **options: Any,
) -> ManoeuvreResult:
    """Drive a manoeuvre, and return what it measures.

    Args:
        manoeuvre: the manoeuvre, or its name: ``step``, ``lane-offset``, ``constant-radius``,
            ``sine`` or ``slalom``.
        driver: the driver.
        simulator: the simulator, which the function starts and ends. Its rules hold the speed limit
            at which the manoeuvre is driven.
        conditions: conditions of the drive, such as ``{"speed": 100.0}`` for another speed limit.
        lane_width: width of each lane, in m.
        options: options of a manoeuvre that is named, such as ``radius=100.0``.

    Raises:
        TypeError: there are options beside a manoeuvre that is an object.
        FreneticError: no manoeuvre has the name, an option is out of range, or the simulator or the
            driver cannot have the conditions.
        RoadError: no road may bend as the manoeuvre asks.
    """
    if options and not isinstance(manoeuvre, str):
        raise TypeError(f"{', '.join(options)}: options are for a manoeuvre's name, not an object")
    named: Manoeuvre = (
        MANOEUVRES.make(manoeuvre, **options) if isinstance(manoeuvre, str) else manoeuvre
    )
    check_pair(simulator, driver)  # the driver may bring its car
    plan = ManoeuvrePlan.of(
        named, simulator, simulator.rules, conditions=conditions, lane_width=lane_width
    )
    with simulator, in_conditions(plan.conditions, simulator, driver) as wrapped:
        check_pair(simulator, wrapped)
        return plan.result(simulator.drive(plan.road, wrapped))
