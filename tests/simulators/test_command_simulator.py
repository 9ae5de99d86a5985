"""Simulators that are programs: the contract, the car, binary steps, and faults."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import sample_programs

from frenetic import Planner, Road, Rules
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.simulators import CommandSimulator, Simulator
from frenetic.simulators.command import SimulatorProgramError
from frenetic.testing.simulator_contract import SimulatorContract

ROAD = Road([0.0] * 4 + [0.02] * 6, 10.0)


class TestCommandSimulator(SimulatorContract):
    @pytest.fixture(autouse=True)
    def _program(self, tmp_path: Path) -> None:
        self._command = sample_programs.simulator(tmp_path)

    def make(self, rules: Rules) -> Simulator:
        return CommandSimulator(self._command, rules=rules)


def test_the_program_says_its_car_and_a_copy_has_its_own(tmp_path: Path) -> None:
    simulator = CommandSimulator(sample_programs.simulator(tmp_path))
    assert (simulator.car.length, simulator.car.width) == (4.0, 1.61)
    copied = pickle.loads(pickle.dumps(simulator))
    rows = []
    for started in (simulator, copied):
        with started:
            drive = started.drive(ROAD, Planner())
        assert drive.trouble is None
        assert judge(ROAD, drive).outcome is Outcome.PASS
        rows.append(drive.trajectory.to_rows())
    assert (rows[0] == rows[1]).all()


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ("answer = {'x': 'far'}", "Expected `float "),
        ("answer = {'error': 'no map'}", "reports: no map"),
        ("sys.exit(4)", "ended with exit code 4"),
    ],
)
def test_a_program_that_breaks_is_told(tmp_path: Path, bad: str, text: str) -> None:
    simulator = CommandSimulator(sample_programs.simulator(tmp_path, bad))
    with simulator, pytest.raises(SimulatorProgramError, match=text):
        simulator.drive(ROAD, Planner())


def test_steps_may_be_binary(tmp_path: Path) -> None:
    code = """
        import json, struct, sys

        stdin, stdout = sys.stdin.buffer, sys.stdout.buffer
        stdin.readline()
        stdout.write(b'{"records": "binary"}\\n')
        stdout.flush()
        while line := stdin.readline():
            x, y, heading = json.loads(line)["start"]["pose"]
            stdout.write(json.dumps({"x": x, "y": y, "heading": heading}).encode() + b"\\n")
            stdout.flush()
            while record := stdin.read(32):
                steering, throttle, brake, seconds = struct.unpack("<4d", record)
                x += 10.0 * seconds
                stdout.write(struct.pack("<7d", x, y, heading, 10.0, 0.0, 0.0, steering))
                stdout.flush()
    """
    simulator = CommandSimulator(sample_programs.command(tmp_path, code))
    with simulator:
        drive = simulator.drive(Road([0.0] * 6, 10.0), Planner())
    assert drive.trouble is None
    assert drive.trajectory.speed[1:].tolist() == [10.0] * (len(drive.trajectory) - 1)


@pytest.mark.parametrize(
    ("bad", "missing"),
    [("answer = {}", "x and y and heading"), ("answer.pop('heading')", "heading")],
)
def test_a_motion_without_a_place_is_refused(tmp_path: Path, bad: str, missing: str) -> None:
    simulator = CommandSimulator(sample_programs.simulator(tmp_path, bad))
    text = f"answered without {missing} of the car"
    with simulator, pytest.raises(SimulatorProgramError, match=text):
        simulator.drive(ROAD, Planner())


def test_asking_for_the_car_leaves_no_program_behind(tmp_path: Path) -> None:
    log = tmp_path / "log"
    start = f"log = open({str(log)!r}, 'a'); log.write('start '); log.flush()"
    code = sample_programs.SIMULATOR.replace(
        "import json, math, sys", f"import json, math, sys; {start}"
    ).replace("BAD", "pass")
    code += "\n    log.write('end '); log.close()\n"
    simulator = CommandSimulator(sample_programs.command(tmp_path, code))
    assert simulator.car.length == 4.0
    assert simulator.car.length == 4.0
    assert log.read_text() == "start end "
    with simulator:
        assert simulator.drive(ROAD, Planner()).trouble is None
        assert log.read_text() == "start end start "
    assert log.read_text() == "start end start end "  # its input was closed, and it was not killed
