"""Objectives, which a search minimises or maximises, and evaluations of tests by them.

An objective is a function of a drive along its road. Lower values are worse for the driver, unless
it has an attribute ``higher_is_worse`` that is true. An attribute ``place_of``, a function of the
same, may say where along the road the value comes from. Your own is named ``module:function``::

    def jerk(road, drive):
        return float(abs(np.diff(drive.trajectory.lateral_speed, 2)).max())

    jerk.higher_is_worse = True

An objective decides which roads a search goes on from. Whether a drive failed is the rules' matter,
and failures are parents whatever their value. How far a strategy's threshold adapts to an objective
is said by the strategy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, TypeAlias

import numpy as np

from frenetic._support.words import lane_words
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.criteria.criterion import SIGNALS, signal_named
from frenetic.errors import CampaignError, describe_raised
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.measures import measure_criteria
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.signals import Measurement, worst
from frenetic.oracle.verdict import Result, assess, judge, locate_drive
from frenetic.parts.registry import OBJECTIVES
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation, Trace

Measure: TypeAlias = Callable[[Road, Drive], float]
"""Value of a drive along its road."""

MOOBD: Final = "moobd"
"""Name of the usual objective."""
CRITERIA: Final = "criteria"
"""Name of the objective of the least margin to a criterion."""
OOB_SHARE: Final = "oob-share"
"""Name of the objective of the largest share of the car outside its lane."""


@dataclass(frozen=True)
class Objective:
    """A named objective."""

    name: str
    """A registered name, ``package.module:function`` or ``file.py:function``."""
    measure: Measure

    @classmethod
    def load(cls, name: str) -> Objective:
        """Return the objective of a name.

        Raises:
            FreneticError: the objective cannot be loaded.
        """
        return cls(name, OBJECTIVES.load(name))

    @property
    def higher_is_worse(self) -> bool:
        """Whether a higher value is worse for the driver."""
        return bool(getattr(self.measure, "higher_is_worse", False))

    def value_of(self, evaluation: Evaluation) -> float | None:
        """Return a test's value as the function gives it; None for the MOOBD or without a drive."""
        severity = evaluation.objective
        return None if severity is None else self._turned(severity)

    def worse(self, value: float, other: float) -> float:
        """Return the value of two which is worse for the driver."""
        return max(value, other) if self.higher_is_worse else min(value, other)

    def place(self, road: Road, drive: Drive) -> float | None:
        """Return the distance along the road of the value, in m; None if the function lacks it."""
        place_of = getattr(self.measure, "place_of", None)
        return None if place_of is None else place_of(road, drive)

    def severity(self, road: Road, drive: Drive) -> float | None:
        """Return the value that a strategy minimises; None for the MOOBD.

        Raises:
            CampaignError: the function raised, or its value is no finite number.
        """
        if self.name == MOOBD:
            return None
        try:
            value = float(self.measure(road, drive))
        except Exception as error:
            raise CampaignError(
                f"the objective {self.name} raised {describe_raised(error)}"
            ) from error
        if not math.isfinite(value):
            raise CampaignError(f"the objective {self.name} is {value}: a finite number is needed")
        return self._turned(value)

    def _turned(self, value: float) -> float:
        """Return a value with the sign of a minimised one, and back."""
        return -value if self.higher_is_worse else value


def as_text(store: CampaignStore) -> str:
    """Return a campaign's objective, its worst value for the driver, and the test with it."""
    name = str(store.config.get("objective", MOOBD))
    built_in = OBJECTIVES.built_in.get(name)
    order = f"{'higher' if _is_higher_worse(store) else 'lower'} is worse"
    text = f"{name}: {built_in[1] if built_in else order}"
    test, value = _worst_test(store)
    if value is None:
        return text
    return f"{text}; {worst_value(name, value)}{worst_criterion(store)}, in test {test}"


def worst_value(name: str, value: float) -> str:
    """Return the worst value of an objective among drives, in words; see `value_text`."""
    text = value_text(name, value)
    return text if name in OBJECTIVES.built_in else f"worst {text}"


def value_text(name: str, value: float) -> str:
    """Return an objective's value for a drive, with its unit: ``largest lateral jerk 9.60 m/s³``.

    Args:
        name: of the objective, which is not the MOOBD.
        value: in the objective's unit and with its sign.
    """
    if name == CRITERIA:
        return f"worst margin to a criterion {value:.3g}"
    if name == OOB_SHARE:
        return f"at most {100.0 * value:.0f} % of the car outside its lane"
    if (row := name.replace("-", "_")) in SIGNALS:
        measure = signal_named(row)
        text = f"{measure.words} {measure.text(value)}"
        return f"{'least' if measure.is_least else 'largest'} {text}"
    return f"{name} {value:.3g}"


def worst_criterion(store: CampaignStore) -> str:
    """Return the criterion with the worst margin: ``: lateral jerk 9.60 m/s³ (at most 5 m/s³)``.

    Empty if the campaign does not minimise the margin to its criteria.
    """
    if store.config.get("objective") != CRITERIA:
        return ""
    test_id, _ = _worst_test(store)
    test = None if test_id is None else store.test(test_id)
    if test is None or test.drive is None:
        return ""
    return f": {_nearest(test.road, test.drive).words}"


def _worst_test(store: CampaignStore) -> tuple[int | None, float | None]:
    """Return the first test with the worst value of a campaign's objective, and the value."""
    values = objectives(store)
    if not values:
        return None, None
    test = (max if _is_higher_worse(store) else min)(values, key=lambda number: values[number])
    return test, values[test]


def worst_test(store: CampaignStore, objective: Objective) -> Test | None:
    """Return the stored test that is worst for the driver, by an objective; None before a drive.

    Raises:
        CampaignError: the campaign is damaged.
    """
    if values := objectives(store):
        turn = -1.0 if objective.higher_is_worse else 1.0
        return store.test(min(values, key=lambda test: turn * values[test]))
    lowest = next(store.tests(order_by="moobd", limit=1, with_trajectory=True), None)
    return None if lowest is None or lowest.moobd is None else lowest


def _is_higher_worse(store: CampaignStore) -> bool:
    return store.config.get("higher_is_worse") is True


def objectives(store: CampaignStore) -> dict[int, float]:
    """Return the objective's values, by the ids of tests in their order.

    There are no values if the MOOBD is minimised.
    """
    select = "SELECT id, objective FROM test WHERE objective IS NOT NULL ORDER BY id"
    return dict(store.rows(select))


def moobd(road: Road, drive: Drive) -> float:
    """Return the minimum oob distance, in m; lower is worse."""
    return float(assess(road, drive).oob_distance.min())


def oob_share(road: Road, drive: Drive) -> float:
    """Return the largest share 0..1 of the car's box outside its lane; higher is worse."""
    return float(assess(road, drive).oob_share.max())


oob_share.higher_is_worse = True  # type: ignore[attr-defined]


def criteria(road: Road, drive: Drive) -> float:
    """Return the least distance from a limit of the criteria, in shares of their signals' scales.

    The lane counts as a criterion, with the MOOBD in m.
    """
    return _nearest(road, drive).share


class _Margin(NamedTuple):
    """The margin of a drive to a criterion."""

    share: float
    """Share of the signal's scale; the MOOBD in m for the lane."""
    distance: float
    """Distance along the road, in m."""
    words: str
    """The value and its limit."""


def _nearest(road: Road, drive: Drive) -> _Margin:
    """Return the least margin of a drive to a criterion."""
    assessed = assess(road, drive)
    least = int(np.argmin(assessed.oob_distance))
    moobd, place = float(assessed.oob_distance[least]), float(assessed.distance[least])
    nearest = _Margin(moobd, place, f"the car's centre {lane_words(moobd, road.lane_width)}")
    for measure in measure_criteria(road, drive, drive.rules.criteria.criteria):
        nearest = min(nearest, _Margin(measure.share, measure.distance, measure.text()))
    return nearest


criteria.place_of = lambda road, drive: _nearest(road, drive).distance  # type: ignore[attr-defined]


class Worst:
    """An objective: the worst value of a signal, see `frenetic.criteria.criterion`.

    It is by the drive's criterion for it, or else in the signal's usual window; 0 for a drive
    that is shorter than that.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.higher_is_worse = not signal_named(name).is_least

    def _measured(self, road: Road, drive: Drive) -> Measurement | None:
        return worst(self.name, locate_drive(road, drive))

    def __call__(self, road: Road, drive: Drive) -> float:
        """Return the value in a drive."""
        peak = self._measured(road, drive)
        return 0.0 if peak is None else peak.value

    def place_of(self, road: Road, drive: Drive) -> float | None:
        """Return the distance along the road of the value, in m."""
        peak = self._measured(road, drive)
        return None if peak is None else peak.distance


def __getattr__(name: str) -> Measure:
    """Return the objective of a built-in signal."""
    if name in SIGNALS:
        return Worst(name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


# Evaluations of tests for strategies, live and when a campaign is resumed

_END: Final = 1e-3  # [s] after the end of a drive, for the rounding of its times


def evaluate(
    candidate: Candidate,
    road: Road | None,
    drive: Drive | None,
    *,
    budget_spent: float = 0.0,
    objective: str | Objective = MOOBD,
) -> Evaluation:
    """Return the evaluation of a candidate, for asking and telling without a campaign.

    Args:
        candidate: from the strategy.
        road: the candidate's road as it was driven.
        drive: of that road; None for an INVALID road, which nobody drove.
        budget_spent: share of the budget, 0..1, after this drive.
        objective: objective of the strategy, or its name, see `frenetic.campaign.objective`.

    Raises:
        CampaignError: the objective has no value for the drive.
        FreneticError: the objective cannot be loaded.
    """
    if road is None or drive is None:
        return Evaluation(candidate, Outcome.INVALID, None, budget_spent)
    result = judge(road, drive)
    if not result.outcome.is_driven:
        return Evaluation(candidate, result.outcome, None, budget_spent, duration=result.duration)
    minimised = objective if isinstance(objective, Objective) else Objective.load(objective)
    severity, path = minimised.severity(road, drive), drive.trajectory
    place = None if severity is None else minimised.place(road, drive)
    return _evaluation(
        candidate,
        result,
        budget_spent,
        severity,
        place,
        lambda: _trace_of(road, path, result.duration),
    )


def evaluation_of(
    test: Test, read_trajectory: Callable[[], Trajectory | None], objective: Objective
) -> Evaluation:
    """Return the evaluation of a test.

    It follows from stored values alone, so it is the same when the campaign is resumed.

    Args:
        test: the test, with its setting.
        read_trajectory: returns the stored trajectory; None if nothing was driven.
        objective: objective of the strategy.

    Raises:
        CampaignError: the objective has no value for the test.
    """
    severity = place = None
    if test.outcome.is_driven and objective.name != MOOBD:
        drive = replace(test, trajectory=read_trajectory()).drive
        if drive is not None:
            severity = objective.severity(test.road, drive)
            place = objective.place(test.road, drive)
    return _evaluation(
        test.candidate,
        test.result,
        test.budget_spent,
        severity,
        place,
        lambda: _trace(test, read_trajectory()),
    )


def _evaluation(
    candidate: Candidate,
    result: Result,
    budget_spent: float,
    severity: float | None,
    place: float | None,
    read_trace: Callable[[], Trace | None],
) -> Evaluation:
    return Evaluation(
        candidate,
        result.outcome,
        result.moobd,
        budget_spent,
        finding=result.finding,
        worst_place=result.moobd_distance if place is None else place,
        duration=result.duration,
        fault=result.fault,
        objective=severity,
        read_trace=read_trace,
    )


def _trace(test: Test, path: Trajectory | None) -> Trace | None:
    if path is None or not test.outcome.is_driven:
        return None
    return _trace_of(test.road, path, test.result.duration)


def _trace_of(road: Road, path: Trajectory, duration: float | None) -> Trace:
    end = np.inf if duration is None else duration + _END
    n = int(np.searchsorted(path.time, end))
    return Trace.along(road, np.column_stack((path.x[:n], path.y[:n])), path.speed[:n])
