"""A trace holds the signals of its drive, with units, and its events."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from frenetic.campaign import CampaignStore
from frenetic.criteria.criterion import CriteriaSet, Signal, signal_named
from frenetic.drivers import Planner
from frenetic.errors import FreneticError
from frenetic.export import TRACE_COLUMNS, DriveTrace, trace_of, trace_of_test
from frenetic.export.trace_columns import field_name
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.measures import measures_json
from frenetic.oracle.verdict import Result, judge
from frenetic.road import Pose, Road
from frenetic.simulators import EmbeddedSimulator

pytest_plugins = ["sample_campaign"]

BEND = [0.0, 0.01, 0.0, 0.0, 0.01, 0.012, -0.03, -0.036, -0.05, 0.0, 0.0, 0.0, 0.02, 0.02]
"""The default driver leaves its lane here, to the right."""
OTHER_NAMES = {"yaw_rate", "deceleration", "duration"}
"""Signals that are columns with another sign or unit: yaw rate, acceleration, time."""


@cache
def driven(rules: Rules = Rules()) -> tuple[Road, Drive, Result]:  # noqa: B008
    """A drive that leaves its lane."""
    road, _ = Road(BEND).placed(200.0)
    assert road is not None
    with EmbeddedSimulator(rules=rules) as simulator:
        drive = simulator.drive(road, Planner())
    return road, drive, judge(road, drive)


def circle(curvature: float, speed: float, **profiles: object) -> tuple[Road, Drive]:
    """A drive at constant speed on the middle of the lane of a road that bends to the left."""
    road = Road([curvature] * 12, pose=Pose(0.0, 0.0, 0.0), **profiles)  # type: ignore[arg-type]
    radius = 1.0 / curvature + 0.5 * road.lane_width
    time = np.arange(0.0, 6.0, 0.1)
    angle = speed * time / radius
    still = np.zeros(len(time))
    trajectory = Trajectory(
        time=time,
        x=radius * np.sin(angle),
        y=1.0 / curvature - radius * np.cos(angle),
        heading=angle + 2.0 * np.pi,
        speed=still + speed,
        lateral_speed=still,
        yaw_rate=still + speed / radius,
        steering=still + 0.05,
        steering_input=still + 0.06,
        throttle=still + 0.3,
        brake=still,
    )
    return road, Drive(trajectory, CarBody(length=4.0, width=1.6), Rules(speed_limit=36.0))


def test_signals_on_a_circle_have_closed_forms() -> None:
    curvature, speed = 0.02, 12.0
    road, drive = circle(curvature, speed)
    trace = trace_of(road, drive, judge(road, drive))
    radius = 1.0 / curvature + 2.0
    inner, outer = radius - 0.8, np.hypot(radius + 0.8, 2.0)
    expected = {
        "distance": speed * drive.trajectory.time / radius / curvature,
        "lateral_offset": 0.0,
        "heading_error": 0.0,
        "oob_distance": 2.0,
        "oob_share": 0.0,
        "edge_distance": min(inner - 50.0, 54.0 - outer),
        "lateral_acceleration": speed**2 / radius,
        "acceleration": 0.0,
        "slip_angle": 0.0,
        "road_curvature": curvature,
        "lane_width": 4.0,
        "speed_limit": 36.0,
        "speed_excess": 3.6 * speed - 36.0,
        "steering_rate": 0.0,
        "grade": 0.0,
    }
    for name, value in expected.items():
        np.testing.assert_allclose(trace.column(name), value, atol=2e-4, err_msg=name)
    jerk = trace.column("lateral_jerk")
    assert np.isnan(jerk[:5]).all()  # its window begins before the drive
    np.testing.assert_allclose(jerk[6:], 0.0, atol=1e-9)


def test_slopes_and_widths_are_those_beside_the_car() -> None:
    road, drive = circle(
        0.02,
        12.0,
        grade=[(0.0, 0.0), (100.0, 0.1)],
        superelevation=[(0.0, 0.03)],
        widening=[(0.0, 0.0), (100.0, 1.0)],
        speed_limits=[(0.0, 50.0), (30.0, 30.0)],
    )
    trace = trace_of(road, drive, judge(road, drive))
    distance = trace.column("distance")
    np.testing.assert_allclose(trace.column("grade"), 0.001 * distance, atol=1e-12)
    np.testing.assert_allclose(trace.heights, 0.0005 * distance**2, atol=1e-9)
    np.testing.assert_allclose(trace.column("lane_width"), 4.0 + 0.01 * distance, atol=1e-9)
    assert set(trace.column("superelevation")) == {0.03}
    assert (trace.column("speed_limit") == np.where(distance < 30.0, 50.0, 30.0)).all()


def test_the_car_that_slips_and_turns_has_angles() -> None:
    road, drive = circle(0.02, 12.0)
    path = drive.trajectory
    turned = replace(path, heading=path.heading - 0.2, lateral_speed=0.0 * path.time - 2.0)
    trace = trace_of(road, replace(drive, trajectory=turned), judge(road, drive))
    np.testing.assert_allclose(trace.column("heading_error"), -0.2, atol=1e-6)
    np.testing.assert_allclose(trace.column("slip_angle"), np.arctan2(-2.0, 12.0))


def test_recorded_columns_are_the_trajectory_up_to_its_end() -> None:
    road, drive, result = driven()
    trace = trace_of(road, drive, result)
    assert len(trace) == len(drive.trajectory)
    for name in Trajectory.names():
        assert (trace.column(name) == getattr(drive.trajectory, name)).all()
    longer = np.concatenate([drive.trajectory.to_rows(), drive.trajectory.to_rows()[-1:]])
    longer[-1, 0] += 0.05
    after = trace_of(road, replace(drive, trajectory=Trajectory.from_rows(longer)), result)
    assert (after.values[0] == trace.values[0]).all()


def test_the_worst_values_are_those_that_a_drive_prints() -> None:
    road, drive, result = driven()
    trace = trace_of(road, drive, result)
    rows = {row["signal"]: row for row in measures_json(road, drive)}
    columns = {column.name: column for column in trace.columns}
    assert rows.keys() - OTHER_NAMES <= columns.keys()
    for name in rows.keys() - OTHER_NAMES:
        values = trace.column(name)
        amounts = np.abs(values) if rows[name]["side"] and name != "edge_distance" else values
        worst = np.nanmin(amounts) if name == "edge_distance" else np.nanmax(amounts)
        assert worst == pytest.approx(rows[name]["value"], rel=1e-12), name
        assert columns[name].unit == rows[name]["unit"]
    assert -np.nanmin(trace.column("acceleration")) == rows["deceleration"]["value"]
    assert trace.column("oob_distance").min() == result.moobd
    assert trace.column("oob_share").max() == result.max_oob_share


def test_events_are_the_first_mistake_the_breaches_and_the_end() -> None:
    rules = Rules(criteria=CriteriaSet.of("competition", {"lateral_acceleration": 3.0}))
    road, drive, result = driven(rules)
    trace = trace_of(road, drive, result)
    names = [event.name for event in trace.events]
    assert sorted(names[:-1]) == ["lane", "lateral_acceleration", "mistake"]
    times = [event.time for event in trace.events]
    assert times == sorted(times)
    by_name = {event.name: event for event in trace.events}
    assert by_name["end"].text == f"FAIL: {result.reason}"
    assert by_name["lane"].text == "leaves its lane to the right"
    assert by_name["lateral_acceleration"].text.endswith("to the right; the limit is 3 m/s²")
    departure = result.departure
    assert departure is not None
    assert (by_name["lane"].time, by_name["lane"].distance) == (departure.time, departure.distance)
    assert by_name["mistake"].time < departure.time


def test_a_drive_that_passes_has_its_end_only() -> None:
    road = Road([0.0] * 12, pose=Pose(100.0, 20.0, 1.5))
    with EmbeddedSimulator() as simulator:
        drive = simulator.drive(road, Planner())
    trace = trace_of(road, drive, judge(road, drive))
    assert [event.name for event in trace.events] == ["end"]
    assert trace.events[0].text.startswith("PASS")


def test_conditions_are_columns() -> None:
    road, drive, result = driven()
    trace = trace_of(road, drive, result, {"friction": 0.8, "noise_seed": 4.0})
    names = [column.name for column in trace.columns]
    assert names[-2:] == ["condition_friction", "condition_noise_seed"]
    assert set(trace.column("condition_friction")) == {0.8}


def test_a_criterion_on_another_package_s_signal_has_a_column(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    signal = Signal(
        "twice", "m/s", "of the speed", 1.0, series=lambda located, _: 2.0 * located.path.speed
    )
    for module in ("criteria.criterion", "oracle.signals", "export.trace_columns"):
        monkeypatch.setattr(
            f"frenetic.{module}.signal_named",
            lambda name: signal if name == "twice" else signal_named(name),
        )
    road, drive, result = driven()
    rules = Rules(criteria=CriteriaSet.of("competition", {"twice": 9.0}))
    trace = trace_of(road, replace(drive, rules=rules), result)
    assert (trace.column("signal_twice") == 2.0 * trace.column("speed")).all()


def test_every_column_has_a_meaning_and_a_name_with_its_unit() -> None:
    fields = {column.name: field_name(column) for column in TRACE_COLUMNS}
    assert all(column.about for column in TRACE_COLUMNS)
    assert len(set(fields.values())) == len(fields)
    assert all(name.isascii() and name.isidentifier() for name in fields.values())
    assert fields["time"] == "time_s"
    assert fields["lateral_jerk"] == "lateral_jerk_m_per_s3"
    assert fields["road_curvature"] == "road_curvature_per_m"
    assert fields["steering_rate"] == "steering_rate_deg_per_s"
    assert fields["speed_limit"] == "speed_limit_km_per_h"
    assert fields["throttle"] == "throttle"


def test_lane_edges_lie_at_half_a_lane_beside_its_middle() -> None:
    road, drive = circle(0.02, 12.0, grade=[(0.0, 0.1)], widening=[(0.0, 1.0)])
    lane = trace_of(road, drive, judge(road, drive)).lane
    centre = np.array([0.0, 50.0])
    np.testing.assert_allclose(np.hypot(*(lane.left[:, :2] - centre).T), 50.0, atol=1e-6)
    np.testing.assert_allclose(np.hypot(*(lane.right[:, :2] - centre).T), 55.0, atol=1e-6)
    np.testing.assert_allclose(lane.right[:, 2], 0.1 * road.distances(1.0), atol=1e-9)


def test_odd_records_leave_a_trace_of_what_is_known() -> None:
    road, drive = circle(0.02, 12.0)
    result = judge(road, drive)
    rows = drive.trajectory.to_rows()
    rows[10, 4] = np.nan  # a speed
    rows[20, 1] = np.inf  # a place: the records from here on say nothing
    rows[5, 0] = rows[4, 0]  # a time that stands still
    trace = trace_of(road, replace(drive, trajectory=Trajectory.from_rows(rows)), result)
    assert len(trace) == 19
    assert np.isnan(trace.column("speed")[9])
    assert not np.isinf(trace.values).any()
    for bad in (rows[:0], rows[20:]):
        with pytest.raises(FreneticError, match="no records"):
            trace_of(road, replace(drive, trajectory=Trajectory.from_rows(bad)), result)


def test_a_test_s_trace_is_that_of_its_stored_drive(sample_campaign: object) -> None:
    with CampaignStore.open(str(sample_campaign)) as store:
        tests = list(store.tests(with_trajectory=True))
        traces: dict[int, DriveTrace] = {
            test.id: trace_of_test(test) for test in tests if test.trajectory
        }
        assert traces
        for test in tests:
            if test.trajectory:
                moobd = traces[test.id].column("oob_distance").min()
                assert moobd == pytest.approx(test.moobd, abs=1e-3)
                assert test.drive is not None
                assert (traces[test.id].column("x") == test.drive.trajectory.x).all()
            else:
                with pytest.raises(FreneticError, match=f"test {test.id} is {test.outcome} and"):
                    trace_of_test(test)


def test_a_test_has_the_conditions_of_its_campaign(sample_campaign: object) -> None:
    with CampaignStore.open(str(sample_campaign)) as store:
        test = next(test for test in store.tests(with_trajectory=True) if test.trajectory)
        assert test.setting is not None
        windy = replace(
            test,
            setting=replace(test.setting, conditions={"friction": 0.7, "delay": 0.1}),
            candidate=replace(test.candidate, conditions={"friction": 0.5}),
        )
    assert trace_of_test(windy).conditions == {"friction": 0.5, "delay": 0.1}
