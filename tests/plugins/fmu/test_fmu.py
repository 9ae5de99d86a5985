"""FMUs as drivers."""

from __future__ import annotations

import io
import math
import os
import pickle
import shutil
import stat
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from frenetic import CampaignStore, Controls, Driver, EmbeddedSimulator, Observation, Road
from frenetic.campaign.tester import RoadTester
from frenetic.campaign.workers.alone import DriveProcess
from frenetic.drivers import DriveSetup, Planner, SpeedPlan
from frenetic.drivers.loading import load_driver
from frenetic.drivers.noting import NotingDriver
from frenetic.errors import ENDS_ITS_PROCESS, HANGS, ControlsError, FreneticError
from frenetic.plugins.fmu import Fmu, FmuError
from frenetic.plugins.fmu.example import VARIABLES, ExampleVariable
from frenetic.plugins.fmu.folders import private_folder, remove_left_folders
from frenetic.testing import DriverContract

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line", "example_fmus"]
pytestmark = pytest.mark.heavy

Built = Callable[..., Path]
Observe = Callable[..., Observation]
ROAD = Road([0.0, 0.0, 0.02, 0.05, 0.03, -0.02, -0.05, -0.03, 0.0, 0.0])


def with_names(**changes: tuple[str, str]) -> tuple[ExampleVariable, ...]:
    """Return the example's variables, some with another name and unit."""
    return tuple(
        variable._replace(name=changes[variable.name][0], unit=changes[variable.name][1])
        if variable.name in changes
        else variable
        for variable in VARIABLES
    )


def write_table(folder: Path, text: str) -> str:
    file = folder / "table.toml"
    file.write_text(text)
    return str(file)


def rows_of(driver: Driver) -> np.ndarray[Any, Any]:
    return EmbeddedSimulator().drive(ROAD, driver).trajectory.to_rows()


# The law


class LaneKeeper:
    """The example's law, in Python."""

    def reset(self, setup: DriveSetup) -> None:
        self.plan = SpeedPlan(setup)
        self.steering = 0.0

    def act(self, observation: Observation) -> Controls:
        wanted = (
            math.atan(2.7 * observation.curvature_ahead[0])
            - 0.4 * observation.heading_error
            - math.atan(0.5 * observation.lateral_offset / (observation.speed + 2.0))
        )
        wanted = min(max(wanted, -math.radians(8.0)), math.radians(8.0))
        self.steering += (1.0 - math.exp(-0.05 / 0.05)) * (wanted - self.steering)
        return self.plan.controls(observation, self.steering)


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_drives_as_its_law_in_python(built: Built, fmi: int) -> None:
    fmu = rows_of(Fmu(str(built(fmi=fmi))))
    np.testing.assert_allclose(fmu, rows_of(LaneKeeper()), rtol=0, atol=1e-6)


def test_both_versions_of_fmi_drive_alike(built: Built) -> None:
    np.testing.assert_array_equal(rows_of(Fmu(str(built(fmi=2)))), rows_of(Fmu(str(built(fmi=3)))))


class TestFmu2(DriverContract):
    @pytest.fixture(autouse=True)
    def build(self, built: Built) -> None:
        self.file = str(built(fmi=2))

    def make(self) -> Driver:
        return Fmu(self.file)


class TestFmu3(DriverContract):
    @pytest.fixture(autouse=True)
    def build(self, built: Built) -> None:
        self.file = str(built(fmi=3))

    def make(self) -> Driver:
        return Fmu(self.file)


def test_a_new_drive_begins_anew_even_if_the_library_remembers(faulty: Path) -> None:
    driver = Fmu(str(faulty), gain=0.0)
    np.testing.assert_array_equal(rows_of(driver), rows_of(driver))


# Signals


LAWS = Path(__file__).with_name("laws.h")
SEEN = Observation(
    time=0.0,
    speed=10.0,
    yaw_rate=0.1,
    steering=0.05,
    lateral_offset=0.3,
    heading_error=0.02,
    ahead=np.column_stack((2.0 * np.arange(40), 0.1 * np.arange(40))),
    curvature_ahead=0.001 * np.arange(1.0, 41.0),
)


def echo(file: Path, place: int, **options: Any) -> float:
    """Return the value that an FMU has at a place of its values, counted from 0, in `SEEN`."""
    driver = Fmu(str(file), gain=-1.0 - place, **options)
    driver.reset(EmbeddedSimulator().setup(Road([0.0] * 8)))
    return math.degrees(driver.act(SEEN).steering)


@pytest.mark.parametrize(
    ("old", "name", "unit", "place", "value"),
    [
        ("lateralDeviation", "lka.e_y", "m", 0, 0.3),
        ("lateralDeviation", "cte", "", 0, 0.3),
        ("e_psi", "Relative yaw angle", "deg", 1, math.degrees(0.02)),
        ("kappa", "Road/Curvature", "1/m", 2, 0.001),
        ("v", "vehicle_speed", "km/h", 3, 36.0),
        ("v", "speed_kmh", "", 3, 36.0),
        ("v", "v_ref", "m/s", 3, 70.0 / 3.6),
    ],
)
def test_an_input_gets_the_signal_of_its_name_in_its_unit(
    built: Built, old: str, name: str, unit: str, place: int, value: float
) -> None:
    file = built(variables=with_names(**{old: (name, unit)}), law=LAWS)
    assert echo(file, place) == pytest.approx(value)


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ('"speed"', 10.0),
        ('"yaw_rate"', 0.1),
        ('"steering"', 0.05),
        ('"time"', 0.0),
        ('"wheelbase"', EmbeddedSimulator().setup(Road([0.0] * 8)).wheelbase),
        ('{ signal = "lateral_offset", factor = -2 }', -0.6),
        ('{ signal = "speed", unit = "km/h" }', 36.0),
        ('{ signal = "heading_error", unit = "deg", factor = -1 }', -math.degrees(0.02)),
        ('{ signal = "curvature", distances = [9] }', 0.0055),
        ('{ signal = "path_y", distances = [5] }', 0.25),
        ('{ signal = "path_x", distances = [1000] }', 78.0),
        ("7", 7.0),
        ("true", 1.0),
        ('"start"', 0.0),
    ],
)
def test_a_table_says_what_an_input_gets(
    built: Built, entry: str, value: float, tmp_path: Path
) -> None:
    variables = with_names(v=("unheard_of", ""))
    table = write_table(tmp_path, f"[inputs]\nunheard_of = {entry}\n")
    file = built(variables=variables, law=LAWS)
    assert echo(file, 3, signals=table) == pytest.approx(value)


def test_an_array_gets_the_road_ahead(built: Built, tmp_path: Path) -> None:
    names = ["kappa[1]", "kappa[3]", "kappa[2]"]
    elements = [ExampleVariable(name, "input", "1/m", 0.0) for name in names]
    file = built(variables=(*elements, *VARIABLES[3:]), law=LAWS)
    assert [echo(file, place) for place in range(3)] == pytest.approx([0.001, 0.003, 0.002])
    table = write_table(
        tmp_path, '[inputs]\nkappa = { signal = "curvature", distances = [0, 10, 20] }\n'
    )
    heard = [echo(file, place, signals=table) for place in range(3)]
    assert heard == pytest.approx([0.001, 0.011, 0.006])


def test_an_array_of_fmi_3_gets_the_road_ahead(built: Built, tmp_path: Path) -> None:
    array = ExampleVariable("kappa", "input", "1/m", 0.0, size=4)
    file = built(fmi=3, variables=(array, *VARIABLES[4:]), law=LAWS)
    table = write_table(tmp_path, '[inputs]\nkappa = { signal = "curvature", factor = -1 }\n')
    heard = [echo(file, place, signals=table) for place in range(4)]
    assert heard == pytest.approx([-0.001, -0.002, -0.003, -0.004])


@pytest.mark.parametrize(
    ("entry", "unit", "value", "steering"),
    [
        ('"steering"', "rad", 0.1, 0.1),
        ('"steering"', "deg", 10.0, math.radians(10.0)),
        ('{ signal = "steering", factor = -15 }', "rad", 1.5, -0.1),
        ('{ signal = "steering", unit = "deg" }', "", 10.0, math.radians(10.0)),
        ('"steering_share"', "", 0.5, 0.5 * EmbeddedSimulator().setup(ROAD).max_steering),
        ('"curvature"', "1/m", 0.05, math.atan(0.05 * EmbeddedSimulator().setup(ROAD).wheelbase)),
    ],
)
def test_a_table_says_what_an_output_is(
    built: Built, entry: str, unit: str, value: float, steering: float, tmp_path: Path
) -> None:
    file = built(variables=with_names(steeringAngle=("out1", unit)), law=LAWS)
    table = write_table(tmp_path, f"[outputs]\nout1 = {entry}\n[inputs]\nv = {value}\n")
    driver = Fmu(str(file), gain=-4.0, signals=table)
    driver.reset(EmbeddedSimulator().setup(ROAD))
    assert driver.act(SEEN).steering == pytest.approx(steering)


def with_two_outputs(name: str, unit: str) -> tuple[ExampleVariable, ...]:
    return tuple(
        ExampleVariable(name, "output", unit) if variable.name == "lag" else variable
        for variable in VARIABLES
    )


@pytest.mark.parametrize(
    ("name", "unit", "controls"),
    [
        ("throttle", "", Controls(0.0, throttle=0.05)),
        ("brakeCmd", "", Controls(0.0, brake=0.05)),
    ],
)
def test_pedals_are_the_fmus_own(
    built: Built, setup: DriveSetup, name: str, unit: str, controls: Controls
) -> None:
    driver = Fmu(str(built(variables=with_two_outputs(name, unit), law=LAWS)), gain=-5.0)
    driver.reset(setup)
    answer = driver.act(SEEN)
    assert (answer.throttle, answer.brake) == (controls.throttle, controls.brake)


def test_an_acceleration_becomes_pedals(built: Built, setup: DriveSetup) -> None:
    driver = Fmu(str(built(variables=with_two_outputs("ax", ""), law=LAWS)), gain=-5.0)
    driver.reset(setup)
    expected = Controls.from_acceleration(0.05, 0.0, speed=10.0, setup=setup)
    assert driver.act(SEEN).throttle == pytest.approx(expected.throttle)


def test_without_pedals_the_planner_sets_the_speed(
    built: Built, setup: DriveSetup, tmp_path: Path
) -> None:
    table = write_table(tmp_path, "[speed]\nlateral_acceleration = 3.0\n")
    for options, planner in (
        ({}, Planner()),
        ({"signals": table}, Planner(lateral_acceleration=3)),
    ):
        driver = Fmu(str(built(fmi=2)), **options)
        driver.reset(setup)
        answer = driver.act(SEEN)
        assert answer == SpeedPlan(setup, planner).controls(SEEN, answer.steering)


def test_a_parameter_has_a_value_or_a_signal_of_the_car(
    built: Built, setup: DriveSetup, tmp_path: Path
) -> None:
    table = write_table(tmp_path, '[parameters]\nwheelbase = "wheelbase"\nlimit = 4\n')
    file = built(fmi=2, law=LAWS)
    assert echo(file, 6, signals=table) == pytest.approx(setup.wheelbase)
    assert echo(file, 7, signals=table) == pytest.approx(4.0)
    assert echo(file, 7, signals=table, limit=5) == pytest.approx(5.0)
    assert echo(file, 6) == pytest.approx(2.7)


def test_a_trace_has_the_outputs(frenetic: Frenetic, built: Built) -> None:
    file = built(variables=with_two_outputs("lka.confidence [1]", ""))
    Path("road.json").write_text('{"curvatures": [0, 0, 0.01, 0.02, 0, 0, 0, 0]}')
    assert frenetic("drive", "road.json", "--driver", str(file), "--trace", "a.csv").code == 0
    trace = np.genfromtxt("a.csv", delimiter=",", names=True)
    assert np.abs(trace["note_steeringAngle"]).max() > 1.0
    assert trace["note_lka_confidence__1_"][1] == 0.05


def test_outputs_of_like_names_have_notes_of_their_own(built: Built) -> None:
    long = "1" + "x" * 80
    outputs = {"limit": "lka.confidence", "lag": "lka_confidence", "wheelbase": f"{long}a"}
    variables = tuple(
        ExampleVariable(outputs.get(variable.name, f"{long}b"), "output", "")
        if variable.name in (*outputs, "heading_gain")
        else variable
        for variable in VARIABLES
    )
    driver = Fmu(str(built(variables=variables)))
    driver.reset(EmbeddedSimulator().setup(ROAD))
    driver.act(SEEN)
    assert driver.trace_notes == {
        "steeringAngle": pytest.approx(driver.trace_notes["steeringAngle"]),
        f"_1{'x' * 58}": 2.7,
        "lka_confidence": 8.0,
        "lka_confidence_2": 0.05,
        f"_1{'x' * 56}_2": 0.4,
    }
    noting = NotingDriver(driver)
    noting.reset(EmbeddedSimulator().setup(ROAD))
    noting.act(SEEN)
    assert set(noting.last_notes.names) == set(driver.trace_notes)


# Steps


@pytest.mark.parametrize(
    ("step", "stated", "period", "times"),
    [
        (None, None, 0.05, [0, 50, 100, 150]),
        (0.1, None, 0.1, [0, 100, 200, 300]),
        (0.02, None, 0.02, [0, 20, 40, 60]),
        (0.001, None, 0.05, [0, 50, 100, 150]),
        (0.1, 0.05, 0.05, [0, 0, 100, 100, 200]),
        (0.3, None, 0.05, [0, 0, 0, 0, 0, 0, 300]),
        (0.02, 0.1, 0.1, [0, 100, 200]),
    ],
)
def test_steps_follow_the_fmu(
    built: Built,
    setup: DriveSetup,
    observe: Observe,
    tmp_path: Path,
    step: float | None,
    stated: float | None,
    period: float,
    times: list[int],
) -> None:
    options = {}
    if stated is not None:
        options["signals"] = write_table(tmp_path, f"period = {stated}\n")
    driver = Fmu(str(built(step=step, law=LAWS)), gain=7.0, **options)
    assert driver.period == period
    driver.reset(setup)
    answers = [driver.act(observe(i * period)).steering for i in range(len(times))]
    assert [int(math.degrees(answer) + 1e-6) for answer in answers] == times


def test_an_fmu_catches_up_after_a_call_that_was_left_out(
    built: Built, setup: DriveSetup, observe: Observe
) -> None:
    driver = Fmu(str(built(law=LAWS)), gain=7.0)
    driver.reset(setup)
    driver.act(observe(0.0))
    assert int(math.degrees(driver.act(observe(0.15)).steering)) == 150


# Faults


@pytest.mark.parametrize(
    ("gain", "message"),
    [
        (
            1,
            "its step at 0 s failed: fmi2DoStep failed with status 3 (error); its last message:"
            " the matrix is singular",
        ),
        (5, "its step at 0 s failed: fmi2DoStep failed with status 2 (discard)"),
        (6, "its step at 0 s failed: fmi2DoStep failed with status 4 (fatal)"),
    ],
)
def test_a_failed_step_is_the_drivers_fault(
    faulty: Path, setup: DriveSetup, gain: int, message: str
) -> None:
    driver = Fmu(str(faulty), gain=gain)
    for _ in range(2):  # and the next drive is not worse
        driver.reset(setup)
        with pytest.raises(FmuError) as caught:
            driver.act(SEEN)
        assert str(caught.value) == f"{faulty}: {message}"


@pytest.mark.parametrize(
    "function",
    [
        "fmpy.fmi2.FMU2Slave.instantiate",
        "fmpy.fmi2.FMU2Slave.setupExperiment",
        "frenetic.plugins.fmu.instance.Values.set",
    ],
)
def test_an_fmu_that_fails_before_a_drive_is_freed(
    faulty: Path, setup: DriveSetup, monkeypatch: pytest.MonkeyPatch, function: str
) -> None:
    from fmpy.fmi2 import FMU2Slave

    freed = []
    free_library = FMU2Slave.freeLibrary

    def fail(*_: Any, **options: Any) -> None:
        raise OSError("there is no licence")

    def note_freed(component: Any) -> None:
        freed.append(component)
        free_library(component)

    monkeypatch.setattr(function, fail)
    monkeypatch.setattr(FMU2Slave, "freeLibrary", note_freed)
    driver = Fmu(str(faulty), gain=1)
    with pytest.raises(FmuError, match="there is no licence"):
        driver.reset(setup)
    assert len(freed) == 1


def test_a_failed_step_of_fmi_3_has_its_message(built: Built, setup: DriveSetup) -> None:
    driver = Fmu(str(built(fmi=3, law=LAWS)), gain=1)
    driver.reset(setup)
    with pytest.raises(FmuError, match="its last message: the matrix is singular"):
        driver.act(SEEN)


@pytest.mark.parametrize(("gain", "number"), [(2, "nan"), (8, "inf")])
def test_an_output_without_a_number_is_the_drivers_fault(
    faulty: Path, setup: DriveSetup, gain: int, number: str
) -> None:
    driver = Fmu(str(faulty), gain=gain)
    driver.reset(setup)
    with pytest.raises(ControlsError, match=f"its output steeringAngle is {number}") as caught:
        driver.act(SEEN)
    if gain == 2:
        assert str(caught.value).endswith("its last message: the filter diverges")


@pytest.mark.parametrize(("gain", "kind"), [(3, ENDS_ITS_PROCESS), (4, HANGS)])
def test_foreign_code_that_crashes_or_hangs_costs_one_drive(
    faulty: Path, gain: int, kind: str
) -> None:
    tester = RoadTester(EmbeddedSimulator(), Fmu(str(faulty), gain=gain))
    with DriveProcess(tester, drive_limit=5.0) as process:
        for _ in range(2):
            trouble = process.drive(ROAD).trouble
            assert trouble is not None
            assert trouble.fault is not None
            assert (trouble.fault.part, trouble.fault.kind) == ("driver", kind)


# As a driver of the command line


SEARCH = ("--strategy", "random", "--simulations", "4", "--seed", "1", "--workers", "1")


def test_an_fmu_names_a_driver(frenetic: Frenetic, built: Built) -> None:
    shutil.copy(built(fmi=2), "controller.fmu")
    driver = "controller.fmu,gain=0.5"
    answer = frenetic("run", "--driver", driver, *SEARCH, "--out", "c", "--json")
    assert answer.code == 0, answer.err
    config = frenetic("show", "c", "--json").json["config"]
    assert config["spec"]["driver"] == driver
    assert "fmpy" in config["driver"]["version"]
    assert frenetic("resume", "c", "--simulations", "5", "--json").code == 0
    assert frenetic("check", "c").code == 0
    shutil.copy(built(fmi=3), "controller.fmu")
    answer = frenetic("resume", "c", "--simulations", "6")
    assert answer.refuses("c was made with another driver", "start a new campaign from this one")


def test_workers_do_not_change_the_drives(frenetic: Frenetic, built: Built) -> None:
    shutil.copy(built(fmi=2), "controller.fmu")
    results = []
    for count in ("1", "2"):
        options = [*SEARCH[:-1], count, "--out", f"c{count}"]
        assert frenetic("run", "--driver", "controller.fmu", *options).code == 0
        with CampaignStore.open(f"c{count}") as store:
            results.append({test.id: test.result.moobd for test in store.tests()})
    assert results[0] == results[1]


def test_a_damaged_fmu_is_one_line_and_nothing_is_lost(frenetic: Frenetic, built: Built) -> None:
    shutil.copy(built(fmi=2), "controller.fmu")
    assert frenetic("run", "--driver", "controller.fmu", *SEARCH, "--out", "c").code == 0
    before = Path("c/campaign.sqlite").read_bytes()
    content = Path("controller.fmu").read_bytes()
    Path("controller.fmu").write_bytes(content[: len(content) // 2])
    for command in (["resume", "c", "--simulations", "9"], ["rerun", "c", "--all"]):
        assert frenetic(*command).refuses("controller.fmu", "it is no zip that can be read")
    assert Path("c/campaign.sqlite").read_bytes() == before
    assert frenetic("check", "c").code == 0


def test_another_persons_campaign_names_code(
    frenetic: Frenetic, built: Built, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    shutil.copy(built(fmi=2), "controller.fmu")
    assert frenetic("run", "--driver", "controller.fmu", *SEARCH, "--out", "c").code == 0
    monkeypatch.setenv("FRENETIC_HOME", str(tmp_path / "stranger"))
    answer = frenetic("rerun", "c", "--all")
    assert answer.refuses("the driver 'controller.fmu', code that you have not trusted")


def test_making_a_driver_loads_no_foreign_code(built: Built, tmp_path: Path) -> None:
    code = f"""
from frenetic.plugins.fmu import Fmu
driver = Fmu({str(built(fmi=2))!r})
assert "lane_keeper" not in open("/proc/self/maps").read()
"""
    if sys.platform == "linux":
        subprocess.run([sys.executable, "-c", code], check=True)


def test_a_pickled_driver_needs_no_file(built: Built, tmp_path: Path) -> None:
    file = tmp_path / "controller.fmu"
    shutil.copy(built(fmi=2), file)
    driver = load_driver(str(file), {"gain": 0.7})
    rows = rows_of(driver)
    data = pickle.dumps(driver)
    file.unlink()
    copy = pickle.loads(data)
    np.testing.assert_array_equal(rows_of(copy), rows)
    assert copy.options == {"fmu": str(file), "gain": 0.7}


def test_unpacked_files_go_with_their_process(built: Built, tmp_path: Path) -> None:
    code = f"""
import os, sys
from frenetic import EmbeddedSimulator, Road
from frenetic.plugins.fmu import Fmu
driver = Fmu({str(built(fmi=2))!r})
driver.reset(EmbeddedSimulator().setup(Road([0.0] * 8)))
assert len(os.listdir({str(tmp_path)!r})) == 1
if sys.argv[1] == "killed":
    os.kill(os.getpid(), 9)
"""
    env = {**os.environ, "TMPDIR": str(tmp_path)}
    for end in ("ended", "killed"):
        subprocess.run([sys.executable, "-c", code, end], env=env, check=end == "ended")
        assert len(list(tmp_path.iterdir())) == (end == "killed")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps loaded libraries")
def test_folders_of_killed_processes_are_removed_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    left, new, other = (tmp_path / f"{name}" for name in ("frenetic-fmu-1", "frenetic-fmu-2", "x"))
    for folder in (left, new, other):
        folder.mkdir()
        (folder / "file").touch()
    for folder in (left, other):
        os.utime(folder, (0, time.time() - 1000.0))
    (tmp_path / "frenetic-fmu-link").symlink_to(other)
    remove_left_folders()
    assert (left.exists(), new.exists(), (other / "file").exists()) == (False, True, True)


def test_a_failed_unpacking_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def fill(folder: Path) -> None:
        (folder / "half").touch()
        raise OSError("no space is left")

    with pytest.raises(OSError, match="no space is left"):
        private_folder("digest of a failed unpacking", fill)
    assert not list(tmp_path.iterdir())
    folder = private_folder("digest of a failed unpacking", lambda folder: (folder / "all").touch())
    assert (folder / "all").exists()


# Refused files


def zipped(*members: tuple[str | zipfile.ZipInfo, bytes | str]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return buffer.getvalue()


def link_member() -> zipfile.ZipInfo:
    member = zipfile.ZipInfo("resources/data")
    member.external_attr = (stat.S_IFLNK | 0o777) << 16
    return member


def bomb() -> bytes:
    zeros = bytes(2**20)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", XML)
        archive.writestr(BINARY, "")
        with archive.open("resources/bomb", "w") as member:
            for _ in range(1025):
                member.write(zeros)
    return buffer.getvalue()


XML = (
    '<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription fmiVersion="2.0" guid="1"'
    ' modelName="m"><CoSimulation modelIdentifier="m"/><ModelVariables><ScalarVariable'
    ' name="delta" valueReference="0" causality="output" initial="exact"><Real start="0"/>'
    "</ScalarVariable></ModelVariables>"
    '<ModelStructure><Outputs><Unknown index="1"/></Outputs></ModelStructure>'
    "</fmiModelDescription>"
)
BINARY = "binaries/linux64/m.so"
NAME = "modelDescription.xml"


def corrupted() -> bytes:
    content = bytearray(zipped((NAME, XML), (BINARY, bytes(range(256)) * 40)))
    place = content.index(BINARY.encode()) + len(BINARY) + 4
    content[place : place + 8] = bytes(8)
    return bytes(content)


def described(old: str, new: str) -> bytes:
    assert old in XML
    return zipped((NAME, XML.replace(old, new)), (BINARY, "x"))


REFUSED = [
    (b"", "it is no FMU: it is no zip that can be read"),
    (b"garbage" * 100, "it is no FMU: it is no zip that can be read"),
    (zipped(("other.txt", "x")), "it is no FMU: it holds no modelDescription.xml"),
    (zipped((NAME, XML), ("../../evil.so", "x")), "names the path '../../evil.so', outside"),
    (zipped((NAME, XML), ("/etc/evil", "x")), "names the path '/etc/evil', outside"),
    (zipped((NAME, XML), ("C:\\evil", "x")), "outside its folder"),
    (zipped((NAME, XML), (link_member(), "/etc")), "'resources/data' is a link"),
    (corrupted(), "it is damaged: 'binaries/linux64/m.so'"),
    (bomb(), "it is too large: 1025 MiB unpacked"),
    (zipped((NAME, "<a"), (BINARY, "x")), "it has FMI ?: 2.0 or 3.0 is needed"),
    (zipped((NAME, b"\xff"), (BINARY, "x")), "its modelDescription.xml is damaged: it is no UTF-8"),
    (described('"2.0"', '"1.0"'), "it has FMI 1.0: 2.0 or 3.0 is needed"),
    (described(' guid="1"', ""), "its modelDescription.xml is damaged: "),
    (described("</ModelStructure>", ""), "its modelDescription.xml is damaged: "),
    (described('index="1"', 'index="7"'), "its modelDescription.xml is damaged: "),
    (
        described("?><fmi", '?><!DOCTYPE a [<!ENTITY b SYSTEM "/etc/passwd">]><fmi'),
        "has a document type",
    ),
    (described("UTF-8", "UTF-7"), "says that it is UTF-7: FMI needs UTF-8"),
    (described("CoSimulation", "ModelExchange"), "it is an FMU for model exchange: export it for"),
    (described('modelIdentifier="m"', 'modelIdentifier="../m"'), "it has no binaries/"),
    (zipped((NAME, XML), ("binaries/amiga/m.so", "x")), "its platforms are amiga"),
    (zipped((NAME, XML), ("sources/m.c", "x")), "it has sources, which 'fmpy compile' compiles"),
    (described('"delta"', '"torque"'), "none of its outputs (torque) is known to steer"),
]


@pytest.mark.skipif(sys.platform != "linux", reason="the binaries are named as on Linux")
@pytest.mark.parametrize(("content", "message"), REFUSED, ids=range(len(REFUSED)))
def test_an_unsuitable_file_is_refused_in_one_line(
    content: bytes,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    unpacked = tmp_path / "unpacked"
    unpacked.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(unpacked))
    file = tmp_path / "m.fmu"
    file.write_bytes(content)
    with pytest.raises(FreneticError, match=r"driver '.*m\.fmu'") as caught:
        load_driver(str(file))
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 900
    assert capfd.readouterr() == ("", "")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["m.fmu", "unpacked"]


@pytest.mark.skipif(sys.platform != "linux", reason="the binaries are named as on Linux")
def test_a_broken_rule_that_does_no_harm_is_allowed(tmp_path: Path) -> None:
    file = tmp_path / "m.fmu"
    # FMI asks for a definition of each unit.
    file.write_bytes(described('<Real start="0"/>', '<Real start="0" unit="deg"/>'))
    assert Fmu(str(file)).period == 0.05


@pytest.mark.skipif(sys.platform != "linux", reason="the binaries are named as on Linux")
def test_a_binary_that_cannot_be_loaded_is_the_drivers_fault(
    tmp_path: Path, setup: DriveSetup
) -> None:
    file = tmp_path / "m.fmu"
    file.write_bytes(zipped((NAME, XML), (BINARY, "no library")))
    driver = Fmu(str(file))
    folder = Path.cwd()
    with pytest.raises(FmuError, match=r"m\.fmu: it cannot be loaded: "):
        driver.reset(setup)
    assert Path.cwd() == folder


@pytest.mark.parametrize(
    ("options", "table", "message"),
    [
        ({"gian": 1}, "", "it has no parameter 'gian'; did you mean 'gain'?"),
        ({"gain": "much"}, "", "its parameter gain is 'much': a number, or period, wheelbase,"),
        ({"signals": "missing.toml"}, "", "there is no file missing.toml"),
        ({}, "inputs = 1", "table.toml does not say a table of signals: inputs is 1:"),
        ({}, "[input]", "there is no entry 'input'; did you mean 'inputs'?"),
        ({}, "[inputs]\nw = 1", "it has no input 'w'"),
        ({}, '[inputs]\nv = "sped"', "there is no signal 'sped'; did you mean 'speed'?"),
        ({}, '[inputs]\nv = {signal = "speed", factor = 0}', "the factor is 0"),
        ({}, '[inputs]\nv = {signal = "speed", unit = "furlong"}', "the unit 'furlong' is not"),
        ({}, '[inputs]\nv = "time"', "its input v has the unit 'm/s', which is none of time"),
        ({}, '[inputs]\nv = {signal = "speed", distances = [1]}', "is one number, without dist"),
        ({}, '[inputs]\nkappa = {signal = "curvature", distances = [1, 2]}', "as many are needed"),
        ({}, '[outputs]\nsteeringAngle = "speed"', "there is no control 'speed'"),
        ({}, '[outputs]\nx = "steering"', "it has no output 'x'"),
        ({}, "[parameters]\nx = 1", "it has no parameter 'x'"),
        ({}, "period = 0.5", "the table's period is 0.5 s: 0.01 to 0.2 in steps of 0.01"),
        ({}, "[speed]\naggresion = 1", "the table's speed: "),
        ({}, "[speed]\naggression = -1", "speed is {'aggression': -1}: a number > 0 is needed"),
    ],
)
def test_unsuitable_options_are_refused_in_one_line(
    frenetic: Frenetic, built: Built, options: dict[str, Any], table: str, message: str
) -> None:
    Path("table.toml").write_text(table)
    if table:
        options = {"signals": "table.toml"}
    words = ",".join(f"{name}={value}" for name, value in options.items())
    Path("road.json").write_text('{"curvatures": [0, 0, 0.01, 0.02, 0, 0, 0, 0]}')
    answer = frenetic("drive", "road.json", "--driver", f"{built(fmi=2)},{words}")
    assert answer.refuses(message), answer.err


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        (with_names(v=("voltage", "")), "no signal is known for its input voltage: name it in a"),
        (with_names(v=("v", "kg")), "its input v has the unit 'kg', which is not known"),
        (with_names(v=("v", "m")), "its input v has the unit 'm', which is none of speed"),
        (with_two_outputs("delta", "deg"), "steeringAngle and delta may both be the steering"),
    ],
)
def test_an_fmu_that_cannot_be_linked_is_refused(
    built: Built, variables: tuple[ExampleVariable, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Fmu(str(built(variables=variables)))


def test_an_error_names_the_missing_extra(
    frenetic: Frenetic, built: Built, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmpy", None)
    answer = frenetic("run", "--driver", str(built(fmi=2)), "--simulations", "2", "--out", "c")
    assert answer.refuses('an FMU needs fmpy: pip install ".[fmu]"')
    assert not Path("c").exists()
