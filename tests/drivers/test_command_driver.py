"""Drivers that are programs: messages, records, faults and versions."""

from __future__ import annotations

import json
import pickle
import shlex
import sys
import time
from pathlib import Path

import pytest
import sample_programs

from frenetic import EmbeddedSimulator, Road
from frenetic.drivers import CommandDriver, Driver, Observation, SpeedOnly, SteeringOnly
from frenetic.errors import (
    ENDS_ITS_PROCESS,
    GIVES_NO_CONTROLS,
    HANGS,
    REPORTS,
    Fault,
    FreneticError,
)
from frenetic.oracle.drive import Drive
from frenetic.parts.versions import version_of
from frenetic.testing.driver_contract import DriverContract

ROAD = Road([0.0] * 4 + [0.02] * 6 + [-0.02] * 6, 10.0)
BINARY = """
    import struct, sys

    stdin, stdout = sys.stdin.buffer, sys.stdout.buffer
    stdin.readline()
    stdout.write(b'{"records": "binary"}\\n')
    stdout.flush()
    while record := stdin.read(8 * 174):
        numbers = struct.unpack("<174d", record)
        controls = 0.3 * numbers[14 + 9] / 8.0, 0.2, 0.0
        stdout.write(struct.pack("<3d", *(controls if numbers[0] else (0.0, 0.0, 0.0))))
        stdout.flush()
"""


class Same:
    """The same law in Python."""

    def reset(self, setup: object) -> None:
        """Do nothing."""

    def act(self, observation: object) -> object:
        """Steer towards a point 8 m ahead."""
        from frenetic import Controls, Observation

        assert isinstance(observation, Observation)
        return Controls(0.3 * float(observation.ahead[4, 1]) / 8.0, 0.2)


def drive(command: str, deadline: float = 5.0) -> Drive:
    return EmbeddedSimulator().drive(ROAD, CommandDriver(command, deadline=deadline))


@pytest.mark.parametrize("code", [sample_programs.DRIVER.replace("BAD", "pass"), BINARY])
def test_a_program_drives_as_the_same_law_in_python(tmp_path: Path, code: str) -> None:
    driven = drive(sample_programs.command(tmp_path, code))
    expected = EmbeddedSimulator().drive(ROAD, Same())  # type: ignore[arg-type]
    assert driven.trouble is None
    assert (driven.trajectory.to_rows() == expected.trajectory.to_rows()).all()


@pytest.mark.parametrize(
    ("bad", "kind", "text"),
    [
        ("print('rubbish', flush=True); continue", GIVES_NO_CONTROLS, "answered 'rubbish'"),
        ("sys.stdout.write('{\"steering\": 0.'); sys.exit()", ENDS_ITS_PROCESS, "within an answer"),
        ("time.sleep(60)", HANGS, "took more than 0.5 s"),
        ("sys.stdout.write('{}\\n{}\\n'); sys.stdout.flush()", GIVES_NO_CONTROLS, "one line"),
        ("sys.stdout.write('x' * 2**21)", GIVES_NO_CONTROLS, "more than 1,048,576 bytes"),
        ("answer = {}", GIVES_NO_CONTROLS, "without steering; one that only chooses its speed"),
        ("del answer['throttle']", GIVES_NO_CONTROLS, "without throttle, brake, acceleration or"),
        ("answer['speed'] = 3.0", GIVES_NO_CONTROLS, "more than one of pedals, acceleration and"),
        ("answer = {'steering': 0.1, 'speed': -1.0}", GIVES_NO_CONTROLS, ">= 0.0"),
        ("answer = {'stering': 0.1}", GIVES_NO_CONTROLS, "unknown field `stering`"),
        ("answer = {'steering': float('nan')}", GIVES_NO_CONTROLS, "malformed"),
        ("answer = {'error': 'no solution'}", REPORTS, "reports: no solution"),
        ("os.close(1); time.sleep(60)", ENDS_ITS_PROCESS, "closed its output"),
        (
            "print('no licence', file=sys.stderr, flush=True); os._exit(3)",
            ENDS_ITS_PROCESS,
            "ended with exit code 3: no licence",
        ),
    ],
)
def test_a_program_that_breaks_is_a_fault_and_the_next_drive_starts_it_again(
    tmp_path: Path, bad: str, kind: str, text: str
) -> None:
    simulator = EmbeddedSimulator()
    driver = CommandDriver(sample_programs.driver(tmp_path, bad), deadline=0.5)
    first, second = simulator.drive(ROAD, driver), simulator.drive(ROAD, driver)
    for driven in (first, second):
        assert driven.trouble is not None
        assert driven.trouble.fault == Fault("driver", kind)
        assert text in driven.trouble.reason
        assert "\n" not in driven.trouble.reason
        assert len(driven.trajectory) == 5  # the new program, too, broke at its fifth observation


@pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX")
def test_a_program_that_a_signal_ends_says_which(tmp_path: Path) -> None:
    driven = drive(sample_programs.driver(tmp_path, "os.abort()"))
    assert driven.trouble is not None
    assert "was killed by SIGABRT" in driven.trouble.reason


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of Windows cannot be asked")
def test_a_program_that_answers_twice_is_noticed_by_the_next_drive(tmp_path: Path) -> None:
    extra = "print(json.dumps(answer), flush=True); time.sleep(0.05)"
    simulator, driver = EmbeddedSimulator(), CommandDriver(sample_programs.driver(tmp_path, extra))
    troubles = [simulator.drive(ROAD, driver).trouble for _ in range(2)]
    faults = [trouble.fault for trouble in troubles if trouble is not None]
    assert Fault("driver", GIVES_NO_CONTROLS) in faults


def test_a_program_that_prints_first_is_told_where_to_print(tmp_path: Path) -> None:
    driven = drive(
        sample_programs.command(tmp_path, "print('Controller 1.2', flush=True)\ninput()")
    )
    assert driven.trouble is not None
    assert "'Controller 1.2'" in driven.trouble.reason
    assert "belongs on stderr" in driven.trouble.reason


def test_what_a_program_prints_for_people_is_passed_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    driven = drive(sample_programs.driver(tmp_path, "print('fifth', file=sys.stderr, flush=True)"))
    assert driven.trouble is None
    deadline = time.monotonic() + 60.0
    while not (printed := capsys.readouterr().err) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert printed == "fifth\n"


def test_pedals_beyond_their_range_are_cut_as_of_other_drivers(tmp_path: Path) -> None:
    driven = drive(sample_programs.driver(tmp_path, "answer['brake'] = 2.0"))
    assert driven.trouble is None
    assert driven.trajectory.brake.max() == 1.0


def test_a_program_chooses_its_period(tmp_path: Path) -> None:
    code = sample_programs.DRIVER.replace(
        "answer = {}", "answer = {'period': 0.1} if kind == 'hello' else {}"
    )
    driven = drive(sample_programs.command(tmp_path, code.replace("BAD", "pass")))
    assert driven.trouble is None
    throttle = driven.trajectory.steering_input
    assert (throttle[2:-1:2] == throttle[3::2][: len(throttle[2:-1:2])]).all()


HALF = """
    import json, sys

    hello, answer = map(json.loads, sys.argv[1:])
    for line in sys.stdin:
        [(kind, values)] = json.loads(line).items()
        reply = {"hello": hello, "act": answer}.get(kind, {})
        if "steering" in reply:
            reply = reply | {"steering": 0.3 * values["ahead"][4][1] / 8.0}
        print(json.dumps(reply), flush=True)
"""
BINARY_HALF = """
    import json, struct, sys

    hello, answer = map(json.loads, sys.argv[1:])
    stdin, stdout = sys.stdin.buffer, sys.stdout.buffer
    stdin.readline()
    stdout.write((json.dumps({"records": "binary"} | hello) + "\\n").encode())
    stdout.flush()
    while record := stdin.read(8 * 174):
        numbers = struct.unpack("<174d", record)
        controls = [answer.get(name, float("nan")) for name in ("steering", "throttle", "brake")]
        if "steering" in answer:
            controls[0] = 0.3 * numbers[14 + 9] / 8.0
        stdout.write(struct.pack("<3d", *controls))
        stdout.flush()
"""


class SameSteering(SteeringOnly):
    """The steering of the programs, in Python."""

    def steer(self, observation: Observation) -> float:
        return 0.3 * float(observation.ahead[4, 1]) / 8.0


class Wanted(SpeedOnly):
    """A wanted speed or acceleration, in Python."""

    def __init__(self, speed: float | None = None, acceleration: float = 0.0) -> None:
        self.wanted, self.rate = speed, acceleration

    def speed(self, observation: Observation) -> float:
        assert self.wanted is not None
        return self.wanted

    def acceleration(self, observation: Observation) -> float:
        return self.rate if self.wanted is None else super().acceleration(observation)


@pytest.mark.parametrize(
    ("code", "hello", "answer", "same"),
    [
        (HALF, {"pedals": False}, {"steering": 0.0}, SameSteering()),
        (BINARY_HALF, {"pedals": False}, {"steering": 0.0}, SameSteering()),
        (
            HALF,
            {"pedals": False, "lateral": 2.0, "aggression": 1.1},
            {"steering": 0.0},
            SameSteering(lateral=2.0, aggression=1.1),
        ),
        (HALF, {"steers": False}, {"speed": 7.0}, Wanted(speed=7.0)),
        (HALF, {"steers": False}, {"acceleration": 0.5}, Wanted(acceleration=0.5)),
    ],
)
def test_a_program_may_leave_one_half_to_frenetic(
    tmp_path: Path, code: str, hello: dict[str, object], answer: dict[str, float], same: Driver
) -> None:
    driven = drive(sample_programs.command(tmp_path, code, json.dumps(hello), json.dumps(answer)))
    assert driven.trouble is None, driven.trouble
    expected = EmbeddedSimulator().drive(ROAD, same)
    assert (driven.trajectory.to_rows() == expected.trajectory.to_rows()).all()


def test_a_binary_program_may_leave_the_steering_to_frenetic(tmp_path: Path) -> None:
    words = json.dumps({"steers": False}), json.dumps({"throttle": 0.2, "brake": 0.0})
    rows = [
        drive(sample_programs.command(tmp_path, code, *words)).trajectory.to_rows()
        for code in (HALF, BINARY_HALF)
    ]
    assert len(rows[0]) > 100
    assert (rows[0] == rows[1]).all()


@pytest.mark.parametrize("code", [HALF, BINARY_HALF])
@pytest.mark.parametrize(
    ("hello", "answer", "text"),
    [
        (
            {"steers": False},
            {"steering": 0.0, "throttle": 0.1, "brake": 0.0},
            'with steering, though it greeted with "steers": false',
        ),
        (
            {"pedals": False},
            {"steering": 0.0, "throttle": 0.1},
            'with a speed or pedals, though it greeted with "pedals": false',
        ),
        ({"steers": False, "pedals": False}, {}, "drives nothing"),
        ({"lateral": 2.0}, {}, 'lateral and aggression need `"pedals": false`'),
        ({"pedals": False, "lateral": 0.0}, {}, "> 0.0"),
    ],
)
def test_halves_that_do_not_fit_the_greeting_are_a_fault(
    tmp_path: Path, code: str, hello: dict[str, object], answer: dict[str, float], text: str
) -> None:
    driven = drive(sample_programs.command(tmp_path, code, json.dumps(hello), json.dumps(answer)))
    assert driven.trouble is not None
    assert driven.trouble.fault == Fault("driver", GIVES_NO_CONTROLS)
    assert text in driven.trouble.reason


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("", "the command is empty"),
        ("./no-such-program --gain 2", "'./no-such-program' is missing, or is not executable"),
        ('controller "--gain', "cannot be split: No closing quotation"),
    ],
)
def test_a_command_that_cannot_run_is_refused(command: str, text: str) -> None:
    with pytest.raises(FreneticError, match=text):
        CommandDriver(command)


def test_a_copy_has_a_program_of_its_own(tmp_path: Path) -> None:
    driver = CommandDriver(sample_programs.driver(tmp_path), deadline=2.0)
    copied = pickle.loads(pickle.dumps(driver))
    assert copied.options == driver.options
    simulator = EmbeddedSimulator()
    rows = [simulator.drive(ROAD, one).trajectory.to_rows() for one in (driver, copied)]
    assert (rows[0] == rows[1]).all()


def test_the_version_covers_program_and_files_among_the_arguments(tmp_path: Path) -> None:
    command = sample_programs.driver(tmp_path)
    data = tmp_path / "gains.txt"
    data.write_text("1")
    driver = CommandDriver(f"{command} {shlex.quote(str(data))}")
    texts = [version_of(driver, driver.options).text]
    for file in (data, tmp_path / "program.py"):
        file.write_text(file.read_text() + "# another\n")
        texts.append(version_of(driver, driver.options).text)
    assert len(set(texts)) == 3
    assert all(text.startswith("version 1, files ") for text in texts)


class TestCommandDriver(DriverContract):
    @pytest.fixture(autouse=True)
    def _program(self, tmp_path: Path) -> None:
        self._command = sample_programs.driver(tmp_path)

    def make(self) -> Driver:
        return CommandDriver(self._command)
