"""The contract of simulators: sound ones pass, and each fault fails the test that covers it."""

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


# A simulator with its own loop: sound, and with one fault.


def bicycle(*changes: tuple[str, str]) -> Callable[..., Any]:
    """Return the class of `bicycle.py` after changes to its code; each old text occurs once."""
    code = Path(__file__).with_name("bicycle.py").read_text(encoding="utf-8")
    for old, new in changes:
        assert code.count(old) == 1, old
        code = code.replace(old, new)
    names: dict[str, Any] = {}
    exec(compile(code, "bicycle.py", "exec"), names)
    bicycle_class: Callable[..., Any] = names["Bicycle"]
    return bicycle_class


def contract(make: Callable[..., Any], **attributes: object) -> SimulatorContract:
    """Return the contract of a simulator, with attributes of the contract set."""

    class Contract(SimulatorContract):
        def make(self, rules: Rules) -> Simulator:
            simulator: Simulator = make(rules=rules)
            return simulator

    for name, value in attributes.items():
        setattr(Contract, name, value)
    return Contract()


def failures(make: Callable[..., Any], **attributes: object) -> dict[str, str]:
    """Run the contract; return the message of each test that fails, by the test's name."""
    messages = {}
    for name, test in inspect.getmembers(contract(make, **attributes), inspect.ismethod):
        if name.startswith("test_"):
            try:
                test(*[gentle_road()] * len(inspect.signature(test).parameters))
            except pytest.skip.Exception:
                pass
            except (Exception, pytest.fail.Exception) as error:
                messages[name.removeprefix("test_")] = str(error)
    return messages


RECORD = "rows.append([*motion, steering, steering, throttle, brake])"
CHOSEN = "rows[-1][8:] = [wanted, throttle, brake]"
END = "if not observer.see(i * PERIOD, x, y, heading):\n                        break"
SEES = "observer.observation(speed, yaw_rate, steering)"
MOTION = "motion = [i * PERIOD, x, y, heading, speed, 0.0, yaw_rate]"
RESET = "driver.reset(setup)"
IMPORTS = "import math\n"


def setup_edits(**replacements: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return changes that give the driver a setup with other values."""
    values = ", ".join(f"{name}={value}" for name, value in replacements.items())
    return (
        (IMPORTS, "import dataclasses\nimport math\n"),
        (RESET, f"driver.reset(dataclasses.replace(setup, {values}))"),
    )


def observation_edits(**replacements: str) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return changes that show the driver other values; ``o`` is the true observation."""
    values = ", ".join(f"{name}={value}" for name, value in replacements.items())
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
            "positions_change_as_speed_and_heading_say": r"differs by up to \d\.\d+ m from what",
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
    "wheels turn farther than the setup says": (
        (
            (
                "steering = min(max(wanted, -setup.max_steering), setup.max_steering)",
                "steering = min(max(wanted, -0.9), 0.9)",
            ),
        ),
        {"controls_beyond_the_limits_are_cut": r"turn by 0\.90 rad, farther than max_steering"},
    ),
    "driver gets another lane width": (
        setup_edits(lane_width="1.0"),
        {"driver_is_told_the_car_the_lane_and_the_limits": r"= 1\.00, but it is 4\.00"},
    ),
    "driver gets another car width": (
        setup_edits(car_width="2.5"),
        {"driver_is_told_the_car_the_lane_and_the_limits": r"car_width = 2\.50, but it is 1\.61"},
    ),
    "driver gets another period": (
        setup_edits(period="0.1"),
        {"driver_sees_its_car_on_the_road": r"not asked every 0\.1 s"},
    ),
    "driver gets another wheelbase": (
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
    "driver sees another place on the map": (
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


def test_a_simulator_with_its_own_loop_passes() -> None:
    assert failures(bicycle()) == {}


@pytest.mark.parametrize("name", MUTANTS)
def test_each_fault_fails_only_the_tests_that_cover_it(name: str) -> None:
    changes, expected = MUTANTS[name]
    messages = failures(bicycle(*changes))
    assert messages.keys() == expected.keys(), messages
    for test, reason in expected.items():
        assert re.search(reason, messages[test]), messages[test]


def test_a_wheelbase_may_be_as_long_as_the_car() -> None:
    """A kinematic model may have a single length."""
    half = "0.5 * setup.car_length"
    messages = failures(bicycle(*setup_edits(front_axle=half, rear_axle=half)))
    assert messages.keys() == {
        "car_turns_as_its_wheels_and_axles_say"
    }  # the bicycle turns by another one
    longer = bicycle(*setup_edits(front_axle="2.6", rear_axle="2.0"))
    assert "farther apart than the bumpers" in "".join(failures(longer).values())


# Deviations that a simulator may declare


def late(by: int) -> Callable[..., Any]:
    """Return the simulator with observations that are so many periods old."""
    return bicycle(
        (RESET, f"{RESET}\n                views = []"),
        (f"driver.act({SEES})", f"driver.act((views.append({SEES}), views[-{1 + by}:][0])[1])"),
    )


def test_observations_may_be_a_little_late() -> None:
    assert failures(late(1)) == {}
    failing = {"driver_sees_its_car_on_the_road", "records_hold_what_the_driver_asked_for"}
    assert failures(late(1), latency=0.0).keys() == failing
    assert failures(late(4)).keys() >= failing


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
    messages = failures(differs)
    assert messages.keys() <= repeated
    assert "did not give the same drive bit for bit" in messages["same_road_same_drive"]
    assert failures(differs, repeats_within=0.1) == {}
    messages = failures(differs, repeats_within=0.005)
    assert re.search(r"are 0\.0\d m apart", messages["same_road_same_drive"])


def test_a_drive_that_hangs_fails_its_test_after_the_wall_limit() -> None:
    hangs = bicycle(
        ("observer = Observer(", "while True:\n            pass\n        observer = Observer(")
    )
    suite = contract(hangs, wall_limit=0.1)
    with pytest.raises(pytest.fail.Exception, match=r"did not end within 0\.1 s of wall time"):
        suite.test_gentle_road_is_passed(gentle_road())


def test_a_simulator_that_claims_slopes_and_has_none_fails() -> None:
    def claims(**options: Any) -> Any:
        simulator = bicycle()(**options)
        simulator.lays_slopes = True
        return simulator

    messages = failures(claims)
    assert messages.keys() == {"rolls_down_a_slope"}
    assert "down a slope of 10 % the car does 0.0 m/s after 3.0 s, where" in "".join(
        messages.values()
    )


def test_a_start_at_speed_must_be_declared() -> None:
    rolls = bicycle(("road.pose.heading, 0.0", "road.pose.heading, 8.0"))
    assert failures(rolls, start_speed=8.0) == {}
    assert failures(bicycle(), start_speed=8.0).keys() == {"starts_at_rest_in_the_ego_lane"}
