"""The simulators' contract: who passes it, and that it finds out who should not."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from frenetic.simulators import EmbeddedSimulator, Rules, Simulator
from frenetic.testing import DummySimulator, SimulatorContract
from frenetic.testing.simulator_contract import gentle_road

PAGE = Path(__file__).parents[2] / "docs" / "simulators.md"


class TestEmbedded(SimulatorContract):
    def make(self, rules: Rules) -> Simulator:
        return EmbeddedSimulator(rules=rules)


class TestDummy(SimulatorContract):
    asks_driver = False
    start_speed = 10.0
    ends_within = 1.0

    def make(self, rules: Rules) -> Simulator:
        return DummySimulator(rules=rules)


class TestDocs(SimulatorContract):
    """The example of the docs."""

    def make(self, rules: Rules) -> Simulator:
        page = PAGE.read_text(encoding="utf-8")
        (code,) = re.findall(
            r"^```python\n# file: bicycle\.py\n(.*?)^```$", page, re.MULTILINE | re.DOTALL
        )
        assert len(code.splitlines()) < 25
        names: dict[str, Any] = {}
        exec(compile(code, "bicycle.py", "exec"), names)
        simulator: Simulator = names["Bicycle"](rules=rules)
        return simulator


# A simulator with a loop of its own, whole and with a piece that is wrong.


def bicycle(*changes: tuple[str, str]) -> Callable[..., Any]:
    """The simulator with pieces of its code replaced, each of which is there once."""
    code = Path(__file__).with_name("bicycle.py").read_text(encoding="utf-8")
    for old, new in changes:
        assert code.count(old) == 1, old
        code = code.replace(old, new)
    names: dict[str, Any] = {}
    exec(compile(code, "bicycle.py", "exec"), names)
    bicycle_class: Callable[..., Any] = names["Bicycle"]
    return bicycle_class


def contract(make: Callable[..., Any], **attributes: object) -> SimulatorContract:
    """The contract of a simulator that declares what the attributes say."""

    class Contract(SimulatorContract):
        def make(self, rules: Rules) -> Simulator:
            simulator: Simulator = make(rules=rules)
            return simulator

    for name, value in attributes.items():
        setattr(Contract, name, value)
    return Contract()


def failures(make: Callable[..., Any], **attributes: object) -> dict[str, str]:
    """What each test of the contract says that a simulator fails."""
    said = {}
    for name, test in inspect.getmembers(contract(make, **attributes), inspect.ismethod):
        if name.startswith("test_"):
            try:
                test(*[gentle_road()] * len(inspect.signature(test).parameters))
            except pytest.skip.Exception:
                pass
            except (Exception, pytest.fail.Exception) as error:
                said[name.removeprefix("test_")] = str(error)
    return said


RECORD = "rows.append([*motion, steering, steering, throttle, brake])"
CHOSEN = "rows[-1][8:] = [wanted, throttle, brake]"
END = "if not observer.see(i * PERIOD, x, y, heading):\n                        break"
SEES = "observer.observation(speed, yaw_rate, steering)"
MOTION = "motion = [i * PERIOD, x, y, heading, speed, 0.0, yaw_rate]"
RESET = "driver.reset(setup)"
IMPORTS = "import math\n"


def setup_edits(**wrong: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Tells the driver something else than the simulator goes by."""
    values = ", ".join(f"{name}={value}" for name, value in wrong.items())
    return (
        (IMPORTS, "import dataclasses\nimport math\n"),
        (RESET, f"driver.reset(dataclasses.replace(setup, {values}))"),
    )


def observation_edits(**wrong: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Shows the driver something else than what there is, ``o``."""
    values = ", ".join(f"{name}={value}" for name, value in wrong.items())
    return (
        (IMPORTS, "import dataclasses\nimport math\n"),
        (SEES, f"(lambda o: dataclasses.replace(o, {values}))({SEES})"),
    )


MUTANTS: dict[str, tuple[tuple[tuple[str, str], ...], Mapping[str, str]]] = {
    "starts at 8 m/s": (
        (("road.pose.heading, 0.0", "road.pose.heading, 8.0"),),
        {"starts_at_rest_in_the_ego_lane": r"starts at 8\.0 m/s instead of 0"},
    ),
    "starts on the centre line": (
        (("-road.lane_width / 2", "0.0"),),
        {"starts_at_rest_in_the_ego_lane": r"starts 2\.00 m left of the ego lane's centre"},
    ),
    "yaw rate is recorded as 0": (
        ((MOTION, MOTION.replace("yaw_rate", "0.0")),),
        {
            "heading_changes_as_the_yaw_rate_says": r"yaw_rate differs by up to 0\.\d+ rad/s",
            "driver_sees_its_car_on_the_road": r"the driver sees yaw_rate = .*, but by the record",
        },
    ),
    "speed is recorded in km/h": (
        ((MOTION, MOTION.replace("speed", "3.6 * speed")),),
        {
            "places_change_as_speed_and_heading_say": r"differs by up to \d\.\d+ m from what",
            "driver_sees_its_car_on_the_road": r"the driver sees speed = .*, but by the record",
        },
    ),
    "controls are not recorded": (
        ((RECORD, "rows.append([*motion, steering, 0.0, 0.0, 0.0])"), (CHOSEN, "")),
        {"records_hold_what_the_driver_asked_for": r"= 0\.000 is recorded, but the driver ans"},
    ),
    "steering is recorded in degrees": (
        ((RECORD, RECORD.replace("steering, steering", "math.degrees(steering), steering")),),
        {
            "driver_sees_its_car_on_the_road": r"the driver sees steering = ",
            "controls_beyond_the_limits_are_cut": r"farther than max_steering = 0\.60",
            "car_turns_as_its_wheels_and_axles_say": "drives a curvature of",
        },
    ),
    "pedals are not cut": (
        (("throttle, brake]\n", "controls.throttle, controls.brake]\n"),),
        {"controls_beyond_the_limits_are_cut": "throttle is recorded beyond 0 to 1"},
    ),
    "wheels turn farther than said": (
        (
            (
                "steering = min(max(wanted, -setup.max_steering), setup.max_steering)",
                "steering = min(max(wanted, -0.9), 0.9)",
            ),
        ),
        {"controls_beyond_the_limits_are_cut": r"turn by 0\.90 rad, farther than max_steering"},
    ),
    "driver is told another lane": (
        setup_edits(lane_width="1.0"),
        {"driver_is_told_the_car_the_lane_and_the_limits": r"= 1\.00, but it is 4\.00"},
    ),
    "driver is told another car": (
        setup_edits(car_width="2.5"),
        {"driver_is_told_the_car_the_lane_and_the_limits": r"car_width = 2\.50, but it is 1\.61"},
    ),
    "driver is told another period": (
        setup_edits(period="0.1"),
        {"driver_sees_its_car_on_the_road": r"not asked every 0\.1 s"},
    ),
    "driver is told another wheelbase": (
        setup_edits(front_axle="0.5"),
        {"car_turns_as_its_wheels_and_axles_say": r"the wheelbase of 1\.90 m"},
    ),
    "driver sees another lane": (
        observation_edits(ahead="o.ahead + [0.0, 0.5]"),
        {"driver_sees_its_car_on_the_road": "the driver sees ahead = "},
    ),
    "driver is off its lane's centre without seeing it": (
        observation_edits(lateral_offset="o.lateral_offset + 0.3"),
        {"driver_sees_its_car_on_the_road": "the driver sees lateral_offset = "},
    ),
    "driver is told another place on the map": (
        observation_edits(x="o.x + 0.3"),
        {"driver_sees_its_car_on_the_road": "the driver sees x = "},
    ),
    "drivers that raise leave no trouble": (
        (("trouble = Trouble.of(error)", "pass"),),
        {"broken_driver_leaves_the_next_drive_clean": "raised, but the drive has no trouble"},
    ),
    "drives never end by the rules": (
        ((END, END.replace("if not ", "").replace(":\n                        break", "")),),
        {
            "ends_at_the_roads_end": r"another \d+\.\d s after the car reached the road's end",
            "ends_outside_the_lane": r"another \d+\.\d s after the car left the lane",
            "ends_when_the_car_is_stuck": r"another \d+\.\d s after the car was stuck",
        },
    ),
    "drives end too soon": (
        ((END, f"{END}\n                    if i * PERIOD > 2.5:\n                        break"),),
        {
            "gentle_road_is_passed": "stopped after 2.6 s, before the drive had ended",
            "ends_at_the_roads_end": "stopped before a rule ended it; a drive that reached",
            "ends_outside_the_lane": "stopped before a rule ended it; a drive that left",
            "ends_at_the_timeout": "stopped before a rule ended it; a drive that took too long",
            "car_turns_as_its_wheels_and_axles_say": r"gets only \d\.\d m far",
        },
    ),
}


def test_a_simulator_with_a_loop_of_its_own_passes() -> None:
    assert failures(bicycle()) == {}


@pytest.mark.parametrize("name", MUTANTS)
def test_what_is_wrong_is_found_by_its_test_alone(name: str) -> None:
    changes, expected = MUTANTS[name]
    said = failures(bicycle(*changes))
    assert said.keys() == expected.keys(), said
    for test, reason in expected.items():
        assert re.search(reason, said[test]), said[test]


def test_a_wheelbase_may_be_as_long_as_the_car() -> None:
    """A kinematic model may know one length alone."""
    half = "0.5 * setup.car_length"
    said = failures(bicycle(*setup_edits(front_axle=half, rear_axle=half)))
    assert said.keys() == {"car_turns_as_its_wheels_and_axles_say"}  # the bicycle has its own
    longer = bicycle(*setup_edits(front_axle="2.6", rear_axle="2.0"))
    assert "farther apart than the bumpers" in "".join(failures(longer).values())


# Simulators that have their reasons


def late(by: int) -> Callable[..., Any]:
    """The simulator with sensors that are late by a number of periods."""
    return bicycle(
        (RESET, f"{RESET}\n                views = []"),
        (f"driver.act({SEES})", f"driver.act((views.append({SEES}), views[-{1 + by}:][0])[1])"),
    )


def test_what_a_driver_sees_may_be_a_little_late() -> None:
    assert failures(late(1)) == {}
    noticed = {"driver_sees_its_car_on_the_road", "records_hold_what_the_driver_asked_for"}
    assert failures(late(1), latency=0.0).keys() == noticed
    assert failures(late(4)).keys() >= noticed


def test_drives_may_differ_where_that_is_declared() -> None:
    start = "steering = throttle = brake = 0.0"
    differs = bicycle(
        (IMPORTS, "import itertools\nimport math\nDRIVES = itertools.count()\n"),
        (start, f"{start}\n        x += 0.01 * (next(DRIVES) % 3)"),
    )
    repeated = {
        "same_road_same_drive",
        "rules_may_be_set_between_drives",
        "broken_driver_leaves_the_next_drive_clean",
    }
    said = failures(differs)
    assert said.keys() <= repeated
    assert "did not give the same drive bit for bit" in said["same_road_same_drive"]
    assert failures(differs, repeats_within=0.1) == {}
    said = failures(differs, repeats_within=0.005)
    assert re.search(r"are 0\.0\d m apart", said["same_road_same_drive"])


def test_a_drive_that_does_not_come_back_is_given_up() -> None:
    hangs = bicycle(
        ("observer = Observer(", "while True:\n            pass\n        observer = Observer(")
    )
    suite = contract(hangs, wall_limit=0.1)
    with pytest.raises(pytest.fail.Exception, match=r"did not end within 0\.1 s of wall time"):
        suite.test_gentle_road_is_passed(gentle_road())


def test_a_simulator_that_claims_slopes_and_lays_none_is_found() -> None:
    def claims(**options: Any) -> Any:
        simulator = bicycle()(**options)
        simulator.lays_slopes = True
        return simulator

    said = failures(claims)
    assert said.keys() == {"rolls_down_a_slope"}
    assert "down a slope of 10 % the car does 0.0 m/s after 3.0 s, where" in "".join(said.values())


def test_only_a_declared_start_is_at_speed() -> None:
    rolls = bicycle(("road.pose.heading, 0.0", "road.pose.heading, 8.0"))
    assert failures(rolls, start_speed=8.0) == {}
    assert failures(bicycle(), start_speed=8.0).keys() == {"starts_at_rest_in_the_ego_lane"}
