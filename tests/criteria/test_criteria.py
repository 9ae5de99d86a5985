"""Criteria: signals against closed forms, scipy and shapely; sets of criteria; verdicts."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import convert
from scipy.integrate import cumulative_trapezoid
from shapely import LineString, Polygon

from frenetic._support.arrays import FloatArray
from frenetic._support.entry_points import RegisteredPart
from frenetic.analysis.caution import caution
from frenetic.analysis.criteria import criteria_text
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.criteria.criterion import (
    DRIVER,
    SIGNALS,
    CriteriaSet,
    Criterion,
    Signal,
    criteria_sets,
    signal_named,
)
from frenetic.drivers import Planner, Stanley
from frenetic.errors import Fault, FreneticError, Trouble
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.measures import measure_criteria, measures_json
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.rates import rate
from frenetic.oracle.signals import LocatedDrive, mean, spread, worst
from frenetic.oracle.verdict import judge, locate_drive
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec import Spec

PERIOD = 0.05  # s between records
ISO = criteria_sets()["after-iso-11270"]


def read_criteria(entry: Any) -> CriteriaSet:
    """Return the criteria of an entry or of an option's text."""
    criteria = Spec(criteria=entry).rules.criteria
    assert isinstance(criteria, CriteriaSet)
    return criteria


def along(road: Road, speed: float, aside: float = 0.0) -> Drive:
    """Return a steady drive along the middle of the ego lane, or so many m left of it."""
    time = np.arange(0.0, (road.length - 1.0) / speed, PERIOD)
    offset = aside - 0.5 * road.lane_width
    s = speed * time
    line = road.sample(0.01)
    places = np.arange(len(line)) * 0.01
    headings = np.array([road.pose_at(place)[2] for place in s])
    x, y = (np.interp(s, places, line[:, k]) for k in (0, 1))
    curvature = road.curvature_at(s)
    # In a bend the car's way beside the line is longer or shorter than the line.
    car_speed = speed * (1.0 - curvature * offset)
    columns = {name: np.zeros(len(time)) for name in Trajectory.names()}
    columns |= {
        "time": time,
        "x": x - offset * np.sin(headings),
        "y": y + offset * np.cos(headings),
        "heading": headings,
        "speed": car_speed,
        "yaw_rate": speed * curvature,
    }
    return Drive(Trajectory(**columns), CarBody(), Rules(), road=road)


def amount(name: str, drive: Drive) -> float:
    """Return the worst value of a signal in a drive."""
    assert drive.road is not None
    measurement = worst(name, locate_drive(drive.road, drive))
    assert measurement is not None
    return measurement.value


def judged(road: Road, drive: Drive, criteria: CriteriaSet) -> Any:
    """Return the verdict on a drive by some criteria."""
    return judge(road, replace(drive, rules=Rules(criteria=criteria)))


# Closed forms


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_lateral_acceleration_on_a_circle_is_speed_squared_over_radius(
    side: float,
) -> None:
    road, speed = Road(np.full(21, side * 0.01)), 15.0
    drive = along(road, speed)
    radius = 100.0 + side * 2.0  # of the ego lane's middle, right of the road's
    car_speed = speed * radius / 100.0
    assert amount("lateral_acceleration", drive) == pytest.approx(car_speed**2 / radius, rel=1e-9)
    assert amount("yaw_rate", drive) == pytest.approx(np.degrees(speed / 100.0), rel=1e-9)
    assert amount("lateral_jerk", drive) == pytest.approx(0.0, abs=1e-9)
    assert amount("speed_excess", drive) == pytest.approx(3.6 * car_speed - 70.0, rel=1e-9)
    measurement = worst("lateral_acceleration", locate_drive(road, drive))
    assert measurement is not None
    assert measurement.side == ("left" if side > 0.0 else "right")


def test_the_jerk_on_a_clothoid_is_speed_cubed_times_the_change_of_curvature() -> None:
    change, speed = 1e-4, 12.0  # 1/m per m
    road = Road(change * 10.0 * np.arange(21), lane_width=4.0)
    drive = along(road, speed, aside=2.0)  # on the road's own line
    assert amount("lateral_jerk", drive) == pytest.approx(speed**3 * change, rel=1e-9)


def test_the_jerk_at_the_start_of_a_circle_is_a_mean_over_half_a_second() -> None:
    speed, curvature = 10.0, 0.02
    road = Road(np.array([0.0] * 11 + [curvature] * 11))  # a clothoid of 10 m, 1 s long
    drive = along(road, speed, aside=2.0)
    assert amount("lateral_jerk", drive) == pytest.approx(speed**2 * curvature, rel=1e-6)


def test_the_edge_distance_in_the_middle_is_half_of_lane_width_minus_car_width() -> None:
    road = Road(np.zeros(21))
    gap = 0.5 * (4.0 - CarBody().width)
    for aside in (0.0, 0.5, -0.7, 1.5):
        measurement = worst("edge_distance", locate_drive(road, along(road, 15.0, aside)))
        assert measurement is not None
        assert measurement.value == pytest.approx(gap - abs(aside), abs=1e-9)
        if aside:
            assert measurement.side == ("left" if aside > 0.0 else "right")


def test_the_lateral_offset_is_the_distance_of_the_centre_from_the_middle_of_the_lane() -> None:
    road = Road(np.full(21, 0.01))
    for aside in (0.5, -0.7, 2.5):
        measurement = worst("lateral_offset", locate_drive(road, along(road, 10.0, aside)))
        assert measurement is not None
        assert measurement.value == pytest.approx(abs(aside), abs=1e-4)
        assert measurement.side == ("left" if aside > 0.0 else "right")


def test_a_wider_lane_leaves_more_room_on_its_right() -> None:
    wider = np.array([[0.0, 0.6], [200.0, 0.6]])
    road = Road(np.zeros(21), widening=wider)
    gap = 0.5 * (4.0 - CarBody().width)
    assert amount("edge_distance", along(road, 15.0, -0.5)) == pytest.approx(gap + 0.1, abs=1e-9)


def test_signals_of_steps_and_ramps_are_exact() -> None:
    road = Road(np.zeros(21))
    drive = along(road, 10.0)
    time = drive.trajectory.time

    def with_(**columns: FloatArray) -> Drive:
        known = {name: getattr(drive.trajectory, name) for name in Trajectory.names()}
        return replace(drive, trajectory=Trajectory(**known | columns))

    braking = with_(speed=10.0 - 0.4 * time)
    assert amount("deceleration", braking) == pytest.approx(0.4)
    assert amount("acceleration", braking) == pytest.approx(-0.4)
    assert amount("longitudinal_jerk", braking) == pytest.approx(0.0, abs=1e-9)
    assert amount("steering_rate", with_(steering=0.02 * time)) == pytest.approx(np.degrees(0.02))
    stands = with_(speed=np.where((time > 3.0) & (time < 8.0), 0.0, 10.0))
    assert amount("stop", stands) == pytest.approx(5.0, abs=2.0 * PERIOD)
    assert amount("stop", with_(speed=np.where(time < 3.0, 0.0, 10.0))) == 0.0, "not yet moving"
    assert amount("duration", drive) == judge(road, drive).duration


def test_the_edge_distance_agrees_with_shapely() -> None:
    roads = RandomSearch(seed=5)
    simulator = EmbeddedSimulator()
    for _ in range(12):
        candidate = roads.ask()
        road = candidate.road(4.0)
        drive = simulator.drive(road, Planner(aggression=1.15))
        located = locate_drive(road, drive)
        left = LineString(road.sample(0.05))
        right = LineString(road.sample(0.05, -4.0))
        car = located.car
        for i in range(20, len(located.distance) - 30, 15):
            if not 10.0 < located.distance[i] < road.length - 10.0:
                continue
            cos, sin = np.cos(located.path.heading[i]), np.sin(located.path.heading[i])
            corners = [
                (a * car.length / 2 + car.centre_ahead, b * car.width / 2) for a, b in _CORNERS
            ]
            box = Polygon(
                (
                    located.path.x[i] + cos * a - sin * b,
                    located.path.y[i] + sin * a + cos * b,
                )
                for a, b in corners
            )
            near = located.edge_distances[i]
            for edge, distance in zip((left, right), near, strict=True):
                if distance > 0.05:
                    assert edge.distance(box) == pytest.approx(distance, abs=0.005)
                elif distance < -0.05:
                    assert edge.intersects(box) or edge.distance(box) < -distance


_CORNERS = ((1, 1), (1, -1), (-1, -1), (-1, 1))


# Filters

# Values of a signal at its records.
columns = st.lists(st.floats(-50.0, 50.0), min_size=21, max_size=80)


@given(columns)
def test_the_moving_average_agrees_with_scipy(values: list[float]) -> None:
    column: FloatArray = np.array(values)
    time = np.arange(len(column), dtype=np.float64) * PERIOD
    whole = cumulative_trapezoid(column, time, initial=0)
    expected = (whole[10:] - whole[:-10]) / (10 * PERIOD)
    means = mean(time, column, 10 * PERIOD)
    assert np.isnan(means[:10]).all()
    assert means[10:] == pytest.approx(expected, abs=1e-9)
    np.testing.assert_array_equal(mean(time, column, 0.0), column)


@given(columns)
def test_the_mean_rate_is_the_difference_of_the_windows_ends(
    values: list[float],
) -> None:
    column: FloatArray = np.array(values)
    time = np.arange(len(column), dtype=np.float64) * PERIOD
    rates = rate(time, column, 10 * PERIOD)
    assert np.isnan(rates[:10]).all()
    assert rates[10:] == pytest.approx((column[10:] - column[:-10]) / (10 * PERIOD), abs=1e-9)
    np.testing.assert_array_equal(rate(time, column, 0.0), np.gradient(column, time))


@given(
    st.lists(st.tuples(st.floats(-50.0, 50.0), st.sampled_from([0.01, 0.05, 0.3])), min_size=1),
    st.sampled_from([0.03, 0.05, 0.5]),
)
def test_rates_are_those_of_numpy_to_the_last_bit(
    records: list[tuple[float, float]], window: float
) -> None:
    values, steps = np.array(records).T.copy()
    time = np.cumsum(steps)
    if len(time) > 1:
        np.testing.assert_array_equal(rate(time, values, 0.0), np.gradient(values, time))
    change = (values - np.interp(time - window, time, values)) / window
    expected = np.where(time - window >= time[0] - 1e-9, change, np.nan)
    if len(time) == 1:
        expected = np.array([np.nan])
    np.testing.assert_array_equal(rate(time, values, window), expected)


def test_a_window_between_two_records_is_interpolated() -> None:
    time = np.array([0.0, 0.1, 0.3, 0.35, 0.6, 1.0])
    assert mean(time, 2.0 * time, 0.5)[4:] == pytest.approx([0.7, 1.5])
    assert rate(time, 2.0 * time, 0.5)[4:] == pytest.approx([2.0, 2.0])
    assert spread(time, np.array([0.0, 5.0, 1.0, 1.0, 2.0, 1.5]), 0.3).tolist() == [
        0.0, 5.0, 5.0, 4.0, 1.0, 0.0,
    ]  # fmt: skip


def test_spread_in_a_window_is_that_of_its_values_and_missing_if_one_is_missing() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        time = np.sort(20.0 * rng.random(rng.integers(1, 200)))
        values = rng.normal(size=len(time))
        values[rng.random(len(time)) < 0.01] = np.nan
        window = 10.0 * rng.random()
        windows = [values[(time >= end - window) & (time <= end)] for end in time]
        expected = [np.ptp(inside) for inside in windows]
        np.testing.assert_array_equal(spread(time, values, window), expected)


# Sets of criteria


def test_limits_agree_with_published_values() -> None:
    limits = {criterion.signal: criterion for criterion in ISO.criteria}
    # The same values as in opendbc: ISO_LATERAL_ACCEL, ISO_LATERAL_JERK and JERK_MEAS_T.
    assert (limits["lateral_acceleration"].limit, limits["lateral_jerk"].limit) == (3.0, 5.0)
    assert limits["lateral_jerk"].window == 0.5
    for criteria_set in criteria_sets().values():
        assert all(criterion.clause for criterion in criteria_set.criteria), (
            "each limit cites its source"
        )
        assert criteria_set.left_out or not criteria_set, "the set names the limits it leaves out"


def test_criteria_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "ours.toml"
    path.write_text(
        'about = "ours"\nlateral_acceleration = 2.5\n'
        'lateral_jerk = {limit = 4, window = 0.4, clause = "7.2"}\n'
    )
    criteria = read_criteria(str(path))
    assert criteria == CriteriaSet(
        "ours",
        (Criterion("lateral_acceleration", 2.5, 0.0), Criterion("lateral_jerk", 4.0, 0.4, "7.2")),
        about="ours",
    )
    assert read_criteria(f"{path},yaw_rate=20").criteria[2].limit == 20.0
    assert read_criteria(f"{path},lateral_jerk=3").criteria[1].window == 0.4
    assert read_criteria(json.loads(json.dumps(criteria.entry()))) == criteria, (
        "a run's file restores the criteria"
    )


def test_limits_in_options_replace_the_limits_of_the_set() -> None:
    criteria = read_criteria("after-iso-11270,lateral_jerk=4,duration=60")
    limits = {criterion.signal: criterion for criterion in criteria.criteria}
    assert (limits["lateral_jerk"].limit, limits["lateral_jerk"].window) == (4.0, 0.5)
    assert limits["duration"].clause == "as given"
    assert limits["lateral_acceleration"] == ISO.criteria[1]
    assert criteria.entry() == "after-iso-11270,lateral_jerk=4,duration=60"
    exact = criteria.with_limits({"lateral_jerk": 4.00000001})
    assert read_criteria(exact.entry()) == exact
    assert read_criteria(criteria.entry()) == criteria
    assert not read_criteria("competition")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("iso", "there are no criteria 'iso': choose competition, after-iso-11270"),
        ("after-iso-11270,jerk=4", "there is no signal jerk: choose from edge_distance"),
        ("after-iso-11270,lateral_jerk=nan", "lateral_jerk is nan"),
        ("missing.toml", "missing.toml"),
    ],
)
def test_the_error_names_the_mistake(text: str, message: str) -> None:
    with pytest.raises(FreneticError) as error:
        read_criteria(text)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lateral_jerk = {window = 1}", "lateral_jerk: Object missing required field `limit`"),
        (
            "lateral_jerk = {limit = 1, windows = 1}",
            "contains unknown field `windows`",
        ),
        ("lateral_jerk = {limit = 1, window = -1}", "window is -1"),
        ("sideways = 1", "there is no signal sideways"),
        ("lateral_jerk =", "holds no criteria"),
        ("about = 1", "about is 1"),
    ],
)
def test_the_error_names_the_mistake_in_a_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "ours.toml"
    path.write_text(text)
    with pytest.raises(FreneticError, match=message):
        CriteriaSet.of(str(path))


# Verdicts


def test_an_exceeded_criterion_fails_a_drive_and_is_reported() -> None:
    road = Road(np.array([0.0] * 5 + [0.03] * 12))
    drive = along(road, 14.0)
    assert judge(road, drive).outcome is Outcome.PASS
    result = judged(road, drive, ISO)
    assert result.outcome is Outcome.FAIL
    assert [finding.criterion for finding in result.findings] == [
        "lateral_jerk",
        "lateral_acceleration",
    ]
    assert result.finding.criterion == "lateral_jerk", "the first"
    assert result.departure is None
    assert "ateral acceleration" in result.reason
    assert "(at most 3 m/s²)" in result.reason
    gentle = judged(road, drive, CriteriaSet("gentle", (Criterion("yaw_rate", 90.0, 0.0),)))
    assert (gentle.outcome, gentle.findings) == (Outcome.PASS, ())


def test_leaving_the_lane_is_the_main_finding() -> None:
    road = Road(np.array([0.0, 0.0, 0.05, 0.06, 0.07, 0.0]))
    drive = EmbeddedSimulator().drive(road, Planner(aggression=1.6))
    result = judged(road, drive, ISO)
    assert result.departure is not None
    assert result.finding is result.departure
    assert len(result.findings) > 1
    assert result.reason == judge(road, drive).reason
    assert list(result.findings) == sorted(result.findings, key=lambda finding: finding.time)
    rows = drive.trajectory.to_rows()[: round(result.departure.time / PERIOD)]
    fault = Fault("driver", "ValueError")
    broke = Drive(Trajectory.from_rows(rows), trouble=Trouble("it raised", fault=fault))
    faulty = judged(road, broke, ISO)
    assert faulty.finding.criterion == DRIVER
    assert len(faulty.findings) > 1


def test_a_drive_shorter_than_the_window_has_no_mean() -> None:
    road = Road(np.zeros(5))  # 4 s, longer than the usual window of each signal
    drive = along(road, 10.0)
    assert measure_criteria(road, drive, [Criterion("lateral_jerk", 5.0, 60.0)]) == []
    names = [row["signal"] for row in measures_json(road, drive)]
    assert names == list(SIGNALS)


def test_a_value_of_nan_is_an_error() -> None:
    road = Road(np.zeros(21))
    drive = along(road, 10.0)
    rows = drive.trajectory.to_rows()
    rows[40, 4] = np.nan
    broken = replace(drive, trajectory=Trajectory.from_rows(rows))
    assert judge(road, broken).outcome is Outcome.PASS, "leaving the lane depends on positions only"
    assert judged(road, broken, ISO).outcome is Outcome.ERROR


def test_each_verdict_agrees_with_the_measured_margins() -> None:
    roads, simulator = RandomSearch(seed=2), EmbeddedSimulator()
    outcomes = set()
    for driver in (Planner(), Planner(lateral_acceleration=2.0, smoothing=8.0), Stanley()):
        for _ in range(6):
            road = roads.ask().road(4.0)
            drive = simulator.drive(road, driver)
            for criteria_set in criteria_sets().values():
                result = judged(road, drive, criteria_set)
                shares = [
                    measurement.margin
                    for measurement in measure_criteria(road, drive, criteria_set.criteria)
                ]
                breaches = sum(margin < 0.0 for margin in shares)
                assert breaches == sum(finding.criterion != "lane" for finding in result.findings)
                if not breaches and not result.departure:
                    assert result.outcome is judge(road, drive).outcome
                outcomes.add(result.outcome)
    assert outcomes == {Outcome.PASS, Outcome.FAIL}


def test_signals_and_their_limits_as_text() -> None:
    assert signal_named("lateral_jerk").text(4.0) == "4.00 m/s³"
    assert ISO.criteria[2].text() == "at most 5 m/s³ in the mean of 0.5 s"
    assert ISO.criteria[0].text() == "at least 0 m"


# Other packages


def top_speed(located: LocatedDrive, _: float) -> FloatArray:
    return located.path.speed


TOP_SPEED = Signal("top_speed", "m/s", "of the car", 10.0, series=top_speed)
SLOW = CriteriaSet("of the object", (Criterion("duration", 1e4, 0.0, "our handbook"),), "slow")
NO_SERIES = replace(TOP_SPEED, name="no_series", series=lambda located, _: np.zeros(3))


def test_a_package_adds_signals_and_criteria_sets(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = tuple(
        RegisteredPart(name, f"{__name__}:{target}", "theirs")
        for name, target in zip(
            ("top_speed", "slow", "no_series"), ("TOP_SPEED", "SLOW", "NO_SERIES"), strict=True
        )
    )
    installed = {"frenetic.criteria": entries}
    monkeypatch.setattr("frenetic.criteria.criterion.installed", lambda group: installed[group])
    road = Road(np.zeros(21))
    drive = along(road, 15.0)
    criteria = read_criteria("slow,top_speed=12")
    assert criteria.name == "slow"
    result = judged(road, drive, criteria)
    assert result.reason == "Top speed 15.00 m/s at 0 m (at most 12 m/s)"
    document = json.loads(json.dumps(criteria.as_json()))
    assert convert(document, CriteriaSet) == criteria, "a campaign's record restores the criteria"
    broken = judged(road, drive, read_criteria("slow,no_series=1"))
    assert broken.outcome is Outcome.ERROR
    assert "one value a record is needed" in broken.reason


def test_a_campaign_warns_of_less_time_than_its_criteria_ask_for(tmp_path: Path) -> None:
    rules = Rules(criteria=criteria_sets()["after-un-r157"])
    for simulations, is_said in ((1, True), (20, False)):
        campaign = Campaign(
            strategy=RandomSearch(seed=1),
            simulator=EmbeddedSimulator(rules=rules),
            driver=Planner(lateral_acceleration=2.0),
            budget=Budget(simulations=simulations),
            folder=tmp_path / str(simulations),
        )
        assert campaign.run().failed == 0
        with CampaignStore.open(campaign.folder) as store:
            assert ("after-un-r157 asks for 300 s" in caution(store)) is is_said
            assert ("less than the 5 min" in criteria_text(store)) is is_said
