"""Drives that were recorded elsewhere: their files, and how ours differ from them."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pytest

from frenetic import EmbeddedSimulator, Planner, Road, judge
from frenetic.errors import FreneticError
from frenetic.export import trace_of, write_trace
from frenetic.recordings import RecordingFile, compare_with_recording, read_recording
from frenetic.recordings.comparison import along_road

if TYPE_CHECKING:
    from command_line import Frenetic

    from frenetic._support.arrays import FloatArray

pytest_plugins = ["command_line"]

CURVATURES = [0.0, 0.0, 0.02, 0.03, 0.0, -0.03, -0.02, 0.0, 0.0]
Columns = Mapping[str, npt.NDArray[Any]]


def write_csv(path: Path, columns: Columns, delimiter: str = ",") -> Path:
    rows = np.column_stack(list(columns.values()))
    lines = [
        delimiter.join(columns),
        *(delimiter.join("" if v != v else repr(float(v)) for v in row) for row in rows),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def read(path: Path, **options: Any) -> Any:
    return read_recording(RecordingFile(path, options))


def straight(**more: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    return {"time": 0.1 * np.arange(50), "speed": np.full(50, 10.0), **more}


# Channels


@pytest.mark.parametrize(
    ("heading", "factor"),
    [
        ("speed", 1.0),
        ("Velocity [km/h]", 3.6),
        ("vehicle_speed (km/h)", 3.6),
        ("speed_kmh", 3.6),
        ("speed_km_per_h", 3.6),
        ("Bus.vx [m/s]", 1.0),
    ],
)
def test_a_column_is_recognised_by_name_and_unit(
    heading: str, factor: float, tmp_path: Path
) -> None:
    time = 0.1 * np.arange(50)
    file = write_csv(tmp_path / "a.csv", {"t [s]": time, heading: np.full(50, factor * 10.0)})
    recording = read(file)
    assert recording.signals["speed"] == pytest.approx(np.full(50, 10.0))
    assert recording.time == pytest.approx(time)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_times_begin_at_0_and_grow(delimiter: str, tmp_path: Path) -> None:
    time = np.array([5.0, 5.1, 5.1, 5.05, 5.2, math.nan, 5.3])
    speed = np.array([1.0, 2.0, 9.0, 9.0, 3.0, 9.0, math.nan])
    recording = read(write_csv(tmp_path / "a.csv", {"t": time, "v": speed}, delimiter))
    assert recording.time == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert recording.signals["speed"][:3] == pytest.approx([1.0, 2.0, 3.0])
    assert math.isnan(recording.signals["speed"][3])


def test_blanks_around_a_name_do_not_count(tmp_path: Path) -> None:
    columns = {
        "time [s]": np.arange(9.0),
        " wheel speed [km/h] ": np.full(9, 36.0),
        " r": np.ones(9),
    }
    file = write_csv(tmp_path / "a.csv", columns)
    (tmp_path / "t.toml").write_text("[channels]\n'wheel speed' = 'speed'\nr = 'yaw_rate'\n")
    recording = read(file, signals=str(tmp_path / "t.toml"))
    assert recording.signals["speed"] == pytest.approx(np.full(9, 10.0))
    assert recording.channels["speed"] == "wheel speed in km/h"


def test_a_missing_heading_leaves_the_later_ones_known(tmp_path: Path) -> None:
    heading = np.linspace(3.0, 4.0, 50)
    wrapped = np.where(heading > math.pi, heading - math.tau, heading)
    wrapped[20] = math.nan
    recording = read(write_csv(tmp_path / "a.csv", straight(heading=wrapped)))
    assert recording.signals["heading"] == pytest.approx(heading)


def test_a_table_says_which_channel_is_which_signal(tmp_path: Path) -> None:
    wheel = np.full(50, -90.0)
    columns = straight(handwheel=wheel, yaw_rate=wheel, offset=wheel)
    table = tmp_path / "table.toml"
    table.write_text(
        "[channels]\n"
        'handwheel = { signal = "steering", factor = -15, unit = "deg" }\n'
        'yaw_rate = { signal = "yaw_rate", unit = "deg/s" }\n'
        "offset = false\n"
    )
    signals = read(write_csv(tmp_path / "a.csv", columns), signals=str(table)).signals
    assert signals["steering"] == pytest.approx(math.radians(6.0))
    assert signals["yaw_rate"] == pytest.approx(math.radians(-90.0))
    assert "lateral_offset" not in signals


def test_a_channel_that_a_table_names_has_the_unit_at_the_end_of_its_name(tmp_path: Path) -> None:
    columns = {"clock_ms": 100.0 * np.arange(50), "pace_mph": np.full(50, 10.0), "s": np.arange(50)}
    (tmp_path / "t.toml").write_text(
        "[channels]\nclock_ms = 'time'\npace_mph = 'speed'\ns = 'distance'\n"
    )
    recording = read(write_csv(tmp_path / "a.csv", columns), signals=str(tmp_path / "t.toml"))
    assert recording.time == pytest.approx(0.1 * np.arange(50))
    assert recording.signals["speed"] == pytest.approx(np.full(50, 4.4704))
    assert recording.signals["distance"] == pytest.approx(np.arange(50.0))


def test_the_most_usual_name_counts_and_equal_names_are_refused(tmp_path: Path) -> None:
    columns = straight(v=np.full(50, 99.0))
    assert read(write_csv(tmp_path / "a.csv", columns)).signals["speed"][0] == 10.0
    columns = straight(Speed=np.full(50, 99.0))
    with pytest.raises(FreneticError, match="channels speed and Speed may each be the speed"):
        read(write_csv(tmp_path / "a.csv", columns))


def test_a_channel_of_another_unit_is_another_signal(tmp_path: Path) -> None:
    columns = straight(**{"r [bar]": np.ones(50)})
    assert "yaw_rate" not in read(write_csv(tmp_path / "a.csv", columns)).signals


@pytest.mark.parametrize(
    ("content", "table", "message"),
    [
        (None, "", "there is no file"),
        ("", "", "is no CSV file with a row of names"),
        (b"\xff\xfe", "", "it is no UTF-8"),
        ("time,torque\n0,1\n1,1\n", "", "no channel is known for x and y, lateral_offset,"),
        ("speed\n1\n2\n", "", "no channel is known for the time"),
        ("time,speed\n1,2\n", "", "it has 1 times that grow: two or more are needed"),
        ("time,speed\n1,fast\n", "", "its channel speed: could not convert string to float"),
        ("time,speed\n1,2\n", "[channels]\nv = 'speed'", "it has no channel 'v'"),
        ("time,speed\n1,2\n", "[channels]\nspeed = 'sped'", "no signal 'sped'; did you mean"),
        ("time,speed\n1,2\n", "[channels]\nspeed = true", "the channel speed is true"),
        ("time,speed [m]\n1,2\n", "[channels]\n'speed' = 'speed'", "which is none of speed"),
        ("time,speed_ms\n1,2\n", "[channels]\nspeed_ms = 'speed'", "has the unit 'ms', which is"),
        ("time,speed\n1,2\n", "[channel]", "there is no entry 'channel'"),
    ],
)
def test_an_unsuitable_recording_is_refused_in_one_line(
    content: str | bytes | None, table: str, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "a.csv"
    if content is not None:
        file.write_bytes(content.encode() if isinstance(content, str) else content)
    options = {}
    if table:
        (tmp_path / "t.toml").write_text(table)
        options["signals"] = str(tmp_path / "t.toml")
    with pytest.raises(FreneticError) as caught:
        read(file, **options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_follow_the_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert RecordingFile.of("a.mf4,signals=t.toml") == (Path("a.mf4"), {"signals": "t.toml"})
    Path("a,b=1.csv").touch()
    assert RecordingFile.of("a,b=1.csv") == (Path("a,b=1.csv"), {})
    with pytest.raises(FreneticError, match="has no option 'signal'; did you mean 'signals'"):
        RecordingFile.of("a.mf4,signal=t.toml")
    with pytest.raises(FreneticError, match="names no file"):
        RecordingFile.of("signals=t.toml")
    with pytest.raises(FreneticError, match=r"must end with \.csv or \.mf4"):
        read(Path("a.xlsx"))


# MDF


def write_mdf(path: Path, columns: Columns, units: Mapping[str, str], period: float = 0.1) -> Path:
    from asammdf import MDF, Signal

    with MDF(version="3.30" if path.suffix == ".mdf" else "4.10") as file:
        for name, values in columns.items():
            times = period * np.arange(len(values))
            file.append(
                [Signal(samples=values, timestamps=times, name=name, unit=units.get(name, ""))]
            )
        file.save(path, overwrite=True)
    return path


@pytest.mark.heavy
@pytest.mark.parametrize("suffix", [".mf4", ".mdf"])
def test_mdf_channels_of_several_rates_come_on_one_clock(suffix: str, tmp_path: Path) -> None:
    speeds, rates = np.linspace(0.0, 36.0, 41), np.linspace(0.0, 9.0, 10)
    units = {"VehSpd": "km/h", "YawRate": "deg/s"}
    file = write_mdf(tmp_path / f"run{suffix}", {"VehSpd": speeds, "YawRate": rates}, units)
    recording = read(file)
    assert recording.signals["speed"] == pytest.approx(np.linspace(0.0, 10.0, 41))
    rate = recording.signals["yaw_rate"]
    assert rate[:10] == pytest.approx(np.radians(rates))
    assert np.isnan(rate[10:]).all()
    assert recording.channels == {"speed": "VehSpd in km/h", "yaw_rate": "YawRate in deg/s"}


@pytest.mark.heavy
def test_a_damaged_mdf_file_is_refused_in_one_line(tmp_path: Path) -> None:
    file = write_mdf(tmp_path / "run.mf4", {"speed": np.ones(9)}, {})
    for content in (b"garbage" * 100, file.read_bytes()[:500], b""):
        file.write_bytes(content)
        with pytest.raises(FreneticError, match=r"run\.mf4 is no MDF file that can be read") as e:
            read(file)
        assert "\n" not in str(e.value)


def test_an_error_names_the_missing_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "run.mf4").touch()
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(FreneticError, match=r'an MDF file needs asammdf: pip install "\.\[mdf\]"'):
        read(tmp_path / "run.mf4")


# Comparisons


@pytest.fixture(scope="module")
def drives() -> dict[str, Any]:
    """The same road, driven twice: by a slow and a fast driver."""
    road = Road(CURVATURES).placed()[0]
    assert road is not None
    traces = {}
    for name, lateral in (("slow", 4.0), ("fast", 6.0)):
        drive = EmbeddedSimulator().drive(road, Planner(lateral_acceleration=lateral))
        traces[name] = trace_of(road, drive, judge(road, drive))
    return {"road": road, **traces}


def columns_of(trace: Any, *names: str) -> dict[str, FloatArray]:
    return {name: trace.column(name) for name in names}


def test_a_trace_of_ours_does_not_differ_from_itself(
    drives: dict[str, Any], tmp_path: Path
) -> None:
    write_trace(drives["fast"], tmp_path / "a.csv")
    comparison = compare_with_recording([drives["road"]], drives["fast"], read(tmp_path / "a.csv"))
    differences = {item.signal: item for item in comparison.differences}
    assert {"lateral_offset", "speed", "steering", "time", "brake"} <= differences.keys()
    assert all(abs(item.largest) < 1e-4 for item in comparison.differences)


@pytest.mark.parametrize(
    ("names", "source"),
    [
        (("distance", "lateral_offset"), "distance"),
        (("x", "y"), "x and y"),
        (("lateral_offset",), "speed"),
    ],
)
def test_the_place_on_the_road_follows_from_what_there_is(
    drives: dict[str, Any], names: tuple[str, ...], source: str, tmp_path: Path
) -> None:
    file = write_csv(tmp_path / "a.csv", columns_of(drives["slow"], "time", "speed", *names))
    comparison = compare_with_recording([drives["road"]], drives["fast"], read(file))
    assert comparison.place_source == source
    slow, fast = drives["slow"], drives["fast"]
    for signal, scale in (("speed", 3.6), ("lateral_offset", 1.0)):
        for trace, values in ((slow, comparison.recorded), (fast, comparison.driven)):
            expected = scale * np.interp(
                comparison.distances, trace.column("distance"), trace.column(signal)
            )
            # The speed along the car is a little less than along the road.
            assert values[signal] == pytest.approx(expected, abs=1.0 if source == "speed" else 0.02)
    (speed,) = (item for item in comparison.differences if item.signal == "speed")
    assert speed.driven - speed.recorded == pytest.approx(speed.largest)
    assert speed.largest > 3.0
    (time,) = (item for item in comparison.differences if item.signal == "time")
    assert time.largest < 0.0


@pytest.mark.parametrize(("first", "last"), [(0, 50), (1, 50), (0, 30)])
def test_an_unknown_speed_does_not_stand_still(first: int, last: int, tmp_path: Path) -> None:
    columns = straight(offset=np.zeros(50))
    columns["speed"][:first] = columns["speed"][last:] = math.nan
    _, signals = along_road(read(write_csv(tmp_path / "a.csv", columns)), [Road(CURVATURES)])
    assert signals["distance"][:last] == pytest.approx(np.arange(last))
    assert np.isnan(signals["distance"][last:]).all()


def test_places_without_a_speed_at_the_beginning_are_refused(tmp_path: Path) -> None:
    columns = straight(offset=np.zeros(50))
    columns["speed"][:10] = math.nan
    with pytest.raises(FreneticError, match=r"has no speed in its first 0\.2 s") as caught:
        along_road(read(write_csv(tmp_path / "a.csv", columns)), [Road(CURVATURES)])
    assert "\n" not in str(caught.value)


def test_a_recording_on_the_files_own_map_is_followed_there(
    drives: dict[str, Any], tmp_path: Path
) -> None:
    elsewhere = Road(CURVATURES, pose=(5000.0, -3000.0, 1.0))
    slow, road = drives["slow"], drives["road"]
    turn = 1.0 - road.pose[2]
    x, y = (slow.column(name) - road.pose[i] for i, name in enumerate(("x", "y")))
    columns = {
        **columns_of(slow, "time", "speed"),
        "x": 5000.0 + math.cos(turn) * x - math.sin(turn) * y,
        "y": -3000.0 + math.sin(turn) * x + math.cos(turn) * y,
    }
    recording = read(write_csv(tmp_path / "a.csv", columns))
    _, signals = along_road(recording, [road, elsewhere])
    assert signals["lateral_offset"] == pytest.approx(slow.column("lateral_offset"), abs=1e-3)
    with pytest.raises(FreneticError, match="m beside the road: is it of another road"):
        along_road(recording, [road])


def test_a_recording_of_another_stretch_is_refused(drives: dict[str, Any], tmp_path: Path) -> None:
    columns = straight(distance=500.0 + np.arange(50.0), offset=np.zeros(50))
    with pytest.raises(FreneticError, match="is from 500 m of the road on"):
        compare_with_recording(
            [drives["road"]], drives["fast"], read(write_csv(tmp_path / "a.csv", columns))
        )
    file = write_csv(tmp_path / "b.csv", {"time": np.arange(9.0), "e_y": np.zeros(9)})
    with pytest.raises(FreneticError, match="does not say where the car was"):
        compare_with_recording([drives["road"]], drives["fast"], read(file))


# The command line


def test_drive_compares_with_a_recording(frenetic: Frenetic, drawn: None) -> None:
    Path("road.json").write_text(json.dumps({"curvatures": CURVATURES}))
    assert frenetic("drive", "road.json", "--driver", "stanley", "--trace", "a.csv").code == 0
    answer = frenetic("drive", "road.json", "--compare", "a.csv", "--plot", "both.png", "--json")
    compared = answer.json["compared"]
    assert compared["recording"] == "a.csv"
    signals = {item["signal"]: item for item in compared["signals"]}
    assert abs(signals["lateral_offset"]["largest_difference"]) > 0.05
    assert Path("both.png").read_bytes().startswith(b"\x89PNG")
    answer = frenetic("drive", "road.json", "--driver", "stanley", "--compare", "a.csv")
    assert "compared with a.csv, 0 to" in answer.out
    assert "lateral offset                   0.00     0.00  m" in answer.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["road.json", "--compare", "missing.csv"], "there is no file missing.csv"),
        (["road.json", "--compare", "a.csv", "--dry"], "--compare is about one drive"),
        (["--manoeuvre", "step", "--compare", "a.csv"], "--manoeuvre has a road of its own"),
    ],
)
def test_an_unsuitable_comparison_is_refused(
    frenetic: Frenetic, arguments: list[str], message: str
) -> None:
    Path("road.json").write_text(json.dumps({"curvatures": CURVATURES}))
    assert message in frenetic("drive", *arguments).err


def test_calibrate_reads_recordings(frenetic: Frenetic, drives: dict[str, Any]) -> None:
    from frenetic.plugins.twin.recordings import read_recordings

    Path("road.json").write_text(json.dumps({"curvatures": CURVATURES}))
    write_trace(drives["fast"], Path("a.csv"))
    recordings = read_recordings(["a.csv,road=road.json", "a.csv,road=road.json,outcome=fail"])
    passed, failed = recordings.drives
    assert (passed.failed, failed.failed) == (False, True)
    fast = drives["fast"]
    positions = 2.0 * np.arange(passed.states.shape[1])
    for row, name in enumerate(("lateral_offset", "speed")):
        expected = np.interp(positions, fast.column("distance"), fast.column(name))
        assert passed.states[row] == pytest.approx(expected, abs=1e-6)


def test_the_road_of_a_recording_may_lie_at_home(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from frenetic.plugins.twin.recordings import read_recordings

    home = tmp_path / "home"
    home.mkdir()
    for variable in ("HOME", "USERPROFILE"):
        monkeypatch.setenv(variable, str(home))
    (home / "road.json").write_text(json.dumps({"curvatures": [0.0] * 9}))
    columns = straight(distance=2.0 * np.arange(50.0), offset=np.zeros(50))
    write_csv(Path("a.csv"), columns)
    assert len(read_recordings(["a.csv,road=~/road.json"]).drives) == 1


def test_a_recording_outside_its_lane_failed(frenetic: Frenetic) -> None:
    from frenetic.plugins.twin.recordings import read_recordings

    Path("road.json").write_text(json.dumps({"curvatures": [0.0] * 9}))
    for offset, failed in ((1.9, False), (-2.1, True)):
        columns = straight(distance=2.0 * np.arange(50.0), offset=np.full(50, offset))
        write_csv(Path("a.csv"), columns)
        (drive,) = read_recordings(["a.csv,road=road.json"]).drives
        assert drive.failed is failed


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a.csv", "a.csv does not say its road: name it, a.csv,road=road.json"),
        ("a.csv,road=road.json,outcome=maybe", "outcome is 'maybe': PASS or FAIL is needed"),
        ("late.csv,road=road.json", "has no record with place, offset and speed in the first 10 m"),
        ("folder,road=road.json", "options are for recordings in CSV or MDF"),
    ],
)
def test_calibrate_refuses_unsuitable_recordings(
    frenetic: Frenetic, text: str, message: str
) -> None:
    Path("road.json").write_text(json.dumps({"curvatures": CURVATURES}))
    columns = straight(distance=np.arange(50.0), offset=np.zeros(50))
    write_csv(Path("a.csv"), columns)
    write_csv(Path("late.csv"), {**columns, "distance": 20.0 + np.arange(50.0)})
    assert frenetic("calibrate", text, "--driver", "stanley").refuses(message)
