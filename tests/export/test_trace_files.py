"""Files of traces: what other programs read in them, and that they are whole or not there."""

from __future__ import annotations

import csv
import errno
import gc
import json
import math
import subprocess
import sys
import weakref
from collections import defaultdict
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from mcap.reader import make_reader
from test_traces import driven

from frenetic.campaign import CampaignStore
from frenetic.errors import FreneticError
from frenetic.export import (
    DriveTrace,
    export_traces,
    trace_files,
    trace_folder,
    trace_mcap,
    trace_of,
    trace_of_test,
    write_layouts,
    write_trace,
)
from frenetic.export.trace_columns import field_name
from frenetic.export.trace_layouts import FOXGLOVE, PLOTJUGGLER
from frenetic.oracle.notes import OBSERVED, DriverNotes

pytest_plugins = ["sample_campaign"]

FOXGLOVE_FIELDS = {
    "foxglove.Log": {"timestamp", "level", "message", "name", "file", "line"},
    "foxglove.SceneUpdate": {"deletions", "entities"},
    "foxglove.FrameTransform": {
        *("timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"),
    },
}
"""Schema -> its fields in Foxglove's documentation."""
ENTITY_FIELDS = {
    *("timestamp", "frame_id", "id", "lifetime", "frame_locked", "metadata", "arrows", "cubes"),
    *("spheres", "cylinders", "lines", "triangles", "texts", "models"),
}
LINE_FIELDS = {
    *("type", "pose", "thickness", "scale_invariant", "points", "color", "colors", "indices"),
}


@cache
def sample_trace() -> DriveTrace:
    return trace_of(*driven(), {"friction": 0.9})


Messages = dict[str, list[tuple[float, Any]]]


def read_mcap(path: Path) -> tuple[Messages, dict[str, Any], dict[str, str]]:
    """Read messages with their times, schemas and metadata of a file, by mcap's own reader."""
    messages: Messages = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        schemas = {}
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            schemas[channel.topic] = json.loads(schema.data)
            assert schemas[channel.topic]["title"] == schema.name
            assert message.log_time == message.publish_time
            messages[channel.topic].append((message.log_time / 1e9, json.loads(message.data)))
        (metadata,) = reader.iter_metadata()
    return messages, schemas, metadata.metadata


def conforms(value: Any, schema: dict[str, Any]) -> bool:
    """Return whether a value is as a JSON schema says, which names all its fields."""
    kinds: dict[str, Any] = {
        "number": (int, float),
        "integer": int,
        "string": str,
        "boolean": bool,
        "object": dict,
        "array": list,
    }
    if not isinstance(value, kinds[schema["type"]]):
        return False
    if isinstance(value, dict):
        fields = schema["properties"]
        return all(name in fields and conforms(item, fields[name]) for name, item in value.items())
    return not isinstance(value, list) or all(conforms(item, schema["items"]) for item in value)


# CSV


def test_csv_holds_the_columns_for_numpy(tmp_path: Path) -> None:
    trace, path = sample_trace(), tmp_path / "run.csv"
    write_trace(trace, path)
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert table.dtype.names == tuple(map(field_name, trace.columns))
    for column, values in zip(trace.columns, trace.values, strict=True):
        np.testing.assert_allclose(table[field_name(column)], values, rtol=1e-8, atol=1e-300)
    text = path.read_bytes()
    assert text.isascii()
    assert b"nan" not in text
    assert b"\r" not in text


def test_csv_has_its_events_beside_it(tmp_path: Path) -> None:
    write_trace(sample_trace(), tmp_path / "run.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.csv", "run.events.csv"]
    with (tmp_path / "run.events.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["event"] for row in rows] == ["mistake", "lane", "end"]
    for row, event in zip(rows, sample_trace().events, strict=True):
        assert float(row["time_s"]) == pytest.approx(event.time)
        assert float(row["distance_m"]) == pytest.approx(event.distance)
        assert row["text"] == event.text


# MCAP


def test_mcap_messages_are_as_their_schemas_say(tmp_path: Path) -> None:
    write_trace(sample_trace(), tmp_path / "run.mcap")
    messages, schemas, _ = read_mcap(tmp_path / "run.mcap")
    for topic, items in messages.items():
        assert all(conforms(message, schemas[topic]) for _, message in items), topic
    for schema in schemas.values():
        if schema["title"] != "frenetic.Drive":
            assert schema["properties"].keys() <= FOXGLOVE_FIELDS[schema["title"]]
    entity = schemas["/scene"]["properties"]["entities"]["items"]["properties"]
    assert entity.keys() <= ENTITY_FIELDS
    assert entity["lines"]["items"]["properties"].keys() <= LINE_FIELDS


def test_mcap_holds_the_numbers_of_the_csv(tmp_path: Path) -> None:
    trace = sample_trace()
    write_trace(trace, tmp_path / "run.csv")
    write_trace(trace, tmp_path / "run.mcap")
    messages, schemas, metadata = read_mcap(tmp_path / "run.mcap")
    with (tmp_path / "run.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [{name: float(text) for name, text in row.items() if text} for row in rows] == [
        message for _, message in messages["/drive"]
    ]
    for time, message in messages["/drive"]:
        assert time == pytest.approx(message["time_s"], abs=1e-9)
    fields = schemas["/drive"]["properties"]
    assert list(fields) == list(map(field_name, trace.columns))
    assert fields["speed_m_per_s"]["description"] == "speed along the car, in m/s"
    assert json.loads(metadata["units"])["speed_m_per_s"] == "m/s"
    assert metadata["outcome"] == "FAIL"
    assert json.loads(metadata["conditions"]) == {"friction": 0.9}


def test_what_a_driver_was_told_noted_and_planned_is_in_both_files(tmp_path: Path) -> None:
    road, drive, result = driven()
    times = drive.trajectory.time[:-1]
    observed = np.column_stack([times, *(np.full((len(OBSERVED) - 1, len(times)), 0.25))])
    plan = np.array([[2.0, 0.5], [4.0, 1.0]])
    notes = DriverNotes(
        observed, ("y",), times[:, None], (2,) * len(times), np.tile(plan, (len(times), 1))
    )
    trace = trace_of(road, replace(drive, notes=notes), result)
    for name in ("run.csv", "run.mcap"):
        write_trace(trace, tmp_path / name)
    table = np.genfromtxt(tmp_path / "run.csv", delimiter=",", names=True)
    assert (table["told_speed_m_per_s"] == 0.25).all()
    np.testing.assert_allclose(table["note_y"][: len(times)], times, atol=1e-9)
    messages, schemas, _ = read_mcap(tmp_path / "run.mcap")
    assert messages["/drive"][9][1]["note_y"] == pytest.approx(times[9])
    assert schemas["/plan"]["title"] == "foxglove.SceneUpdate"
    assert len(messages["/plan"]) == len(times)
    (entity,) = messages["/plan"][0][1]["entities"]
    assert entity["frame_id"] == "car"
    points = [[point["x"], point["y"]] for point in entity["lines"][0]["points"]]
    assert points == plan.tolist()
    assert all(conforms(message, schemas["/plan"]) for _, message in messages["/plan"])


def test_mcap_holds_the_events_as_a_log(tmp_path: Path) -> None:
    write_trace(sample_trace(), tmp_path / "run.mcap")
    messages, _, _ = read_mcap(tmp_path / "run.mcap")
    log = messages["/events"]
    assert [(message["name"], message["level"]) for _, message in log] == [
        ("mistake", 3),
        ("lane", 4),
        ("end", 2),
    ]
    for (time, message), event in zip(log, sample_trace().events, strict=True):
        assert time == pytest.approx(event.time)
        stamp = message["timestamp"]
        assert stamp["sec"] + stamp["nsec"] / 1e9 == pytest.approx(event.time)
        assert message["message"].startswith(event.text)


def test_the_scene_holds_lane_path_and_a_box_that_moves_with_the_car(tmp_path: Path) -> None:
    trace = sample_trace()
    write_trace(trace, tmp_path / "run.mcap")
    messages, _, _ = read_mcap(tmp_path / "run.mcap")
    ((_, scene),) = messages["/scene"]
    lane, path, car = scene["entities"]
    assert [entity["frame_id"] for entity in scene["entities"]] == ["map", "map", "car"]
    edges = [[list(point.values()) for point in line["points"]] for line in lane["lines"]]
    np.testing.assert_allclose(edges[0], trace.lane.left)
    np.testing.assert_allclose(edges[1], trace.lane.right)
    assert len(path["lines"][0]["points"]) == len(trace)
    (box,) = car["cubes"]
    assert (box["size"]["x"], box["size"]["y"]) == (trace.car.length, trace.car.width)
    assert car["frame_locked"]
    for k, (time, message) in enumerate(messages["/tf"]):
        assert (message["parent_frame_id"], message["child_frame_id"]) == ("map", "car")
        assert time == pytest.approx(trace.column("time")[k])
        place = message["translation"]
        assert (place["x"], place["y"]) == (trace.column("x")[k], trace.column("y")[k])
        turn = message["rotation"]
        heading = 2.0 * math.atan2(turn["z"], turn["w"])
        assert math.cos(heading - trace.column("heading")[k]) == pytest.approx(1.0)


def test_equal_traces_are_equal_files(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_trace(sample_trace(), tmp_path / f"{name}.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


# Layouts


def test_layouts_name_what_traces_hold(tmp_path: Path) -> None:
    write_trace(sample_trace(), tmp_path / "run.mcap")
    messages, _, _ = read_mcap(tmp_path / "run.mcap")
    fields = messages["/drive"][-1][1]
    assert {path.name for path in write_layouts(tmp_path, "mcap")} == {FOXGLOVE, PLOTJUGGLER}
    layout = json.loads((tmp_path / FOXGLOVE).read_text())
    paths = [
        path["value"] for panel in layout["configById"].values() for path in panel.get("paths", ())
    ]
    assert len(paths) > 8
    assert all(path.removeprefix("/drive.") in fields for path in paths)
    panels: list[str] = []

    def collect(node: Any) -> None:
        if isinstance(node, str):
            panels.append(node)
        else:
            collect(node["first"])
            collect(node["second"])

    collect(layout["layout"])
    assert sorted(panels) == sorted(layout["configById"])
    assert layout["configById"]["RosOut!events"]["topicToRender"] in messages
    curves = [curve.get("name", "") for curve in ET.parse(tmp_path / PLOTJUGGLER).iter("curve")]
    assert [f"/drive/{path.removeprefix('/drive.')}" for path in paths] == curves
    assert write_layouts(tmp_path / ".", "csv") == (tmp_path / PLOTJUGGLER,)
    curves = [curve.get("name", "") for curve in ET.parse(tmp_path / PLOTJUGGLER).iter("curve")]
    assert all(name in fields for name in curves)


# Mistakes and disks


@pytest.mark.parametrize("name", ["run.txt", "run", "run.csv.gz"])
def test_another_suffix_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(FreneticError, match=r"must end with \.csv or \.mcap"):
        write_trace(sample_trace(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_without_the_extra_mcap_is_refused_and_csv_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sample_campaign: Path
) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(FreneticError, match=r'needs mcap, which is not installed: pip.*\[mcap\]"'):
        write_trace(sample_trace(), tmp_path / "run.mcap")
    with pytest.raises(FreneticError, match="needs mcap"):
        export_traces(sample_campaign, tmp_path / "out", form="mcap")
    assert list(tmp_path.iterdir()) == []
    write_trace(sample_trace(), tmp_path / "run.csv")


def test_csv_needs_no_other_package(tmp_path: Path, sample_campaign: Path) -> None:
    code = (
        "import sys\n"
        "for name in ('pandas', 'pyarrow', 'mcap'): sys.modules[name] = None\n"
        "from frenetic.export import export_traces\n"
        f"export_traces({str(sample_campaign)!r}, {str(tmp_path / 'out')!r}, tests=[1])\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    assert (tmp_path / "out" / "test-00001.csv").exists()


@pytest.mark.parametrize("name", ["run.csv", "run.mcap"])
def test_a_full_disk_leaves_the_old_file(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / name
    write_trace(sample_trace(), path)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    full = OSError(errno.ENOSPC, "No space left on device")

    def raise_full(*_: Any) -> Any:
        raise full

    monkeypatch.setattr(trace_mcap, "_log", raise_full)
    monkeypatch.setattr(trace_files, "_events_text", raise_full)
    with pytest.raises(FreneticError, match=f"{name} cannot be written: No space left on device"):
        write_trace(sample_trace(), path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.skipif(sys.platform == "win32", reason="limits of processes are POSIX")
@pytest.mark.parametrize("named", ["", "1"])
def test_a_disk_that_fills_up_is_one_line_and_leaves_nothing_half_written(
    named: str, tmp_path: Path, sample_campaign: Path
) -> None:
    code = (
        "import resource, signal\n"
        "from frenetic.cli import main\n"
        "from frenetic.export import trace_folder\n"
        "write = trace_folder.write_form\n"
        "def write_with_little_room(*trace):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (9000, resource.RLIM_INFINITY))\n"
        "    try: write(*trace)\n"
        "    finally: resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)\n"
        "trace_folder.write_form = write_with_little_room\n"
        f"main(['export', {str(sample_campaign)!r}, *{named.split()!r}, '--format',\n"
        f"      'trace,file=mcap', '--out', {str(tmp_path / 'out')!r}])\n"
    )
    # -B: Python would also cut off the compiled modules that it writes in this time.
    command = [sys.executable, "-B", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = [line for line in done.stderr.splitlines() if line.startswith("frenetic: ")]
    assert (done.returncode, done.stdout, len(lines)) == (2, "", 1), done
    assert f"{tmp_path / 'out'} cannot be written: File too large" in lines[0]
    assert list(tmp_path.rglob("*")) == ([tmp_path / "out"] if named else [])


# Campaigns


@pytest.mark.parametrize("form", ["csv", "mcap"])
def test_each_driven_test_has_a_file(form: str, tmp_path: Path, sample_campaign: Path) -> None:
    shown: list[tuple[int, int]] = []
    out = export_traces(
        sample_campaign, tmp_path / "t", form=form, on_progress=lambda *done: shown.append(done)
    )
    with CampaignStore.open(sample_campaign) as store:
        driven_ids = [test.id for test in store.tests() if test.records]
        first = trace_of_test(store.test(driven_ids[0]))
    names = {f"test-{test_id:05d}.{form}" for test_id in driven_ids}
    others = {PLOTJUGGLER}
    others |= {FOXGLOVE} if form == "mcap" else {f"{name[:-4]}.events.csv" for name in names}
    assert {path.name for path in out.iterdir()} == names | others
    assert shown == [(k + 1, len(driven_ids)) for k in range(len(driven_ids))]
    write_trace(first, tmp_path / f"single.{form}")
    written = out / f"test-{driven_ids[0]:05d}.{form}"
    assert written.read_bytes() == (tmp_path / f"single.{form}").read_bytes()


def test_outcomes_choose_tests(tmp_path: Path, sample_campaign: Path) -> None:
    out = export_traces(sample_campaign, tmp_path / "t", outcomes="FAIL")
    with CampaignStore.open(sample_campaign) as store:
        failed = sorted(test.id for test in store.tests() if test.outcome == "FAIL")
    assert sorted(out.glob("*[0-9].csv")) == [out / f"test-{n:05d}.csv" for n in failed]


def test_named_tests_are_added_and_replaced(tmp_path: Path, sample_campaign: Path) -> None:
    with CampaignStore.open(sample_campaign) as store:
        tests = list(store.tests())
        first, second = [test.id for test in tests if test.records][:2]
        undriven = next(test for test in tests if not test.records)
    out = export_traces(sample_campaign, tmp_path / "t", form="mcap", tests=[first])
    (out / f"test-{first:05d}.mcap").write_text("old")
    export_traces(sample_campaign, out, form="mcap", tests=[second, first, second])
    assert len(list(out.glob("*.mcap"))) == 2
    read_mcap(out / f"test-{first:05d}.mcap")
    before = sorted(out.iterdir())
    with pytest.raises(FreneticError, match=f"test {undriven.id} is {undriven.outcome} and has no"):
        export_traces(sample_campaign, out, tests=[first, undriven.id])
    with pytest.raises(FreneticError, match="holds no test of candidate 9999"):
        export_traces(sample_campaign, out, tests=[first, 9999])
    assert sorted(out.iterdir()) == before
    with pytest.raises(FreneticError, match="exists already"):
        export_traces(sample_campaign, out)
    with pytest.raises(ValueError, match="leave out one of them"):
        export_traces(sample_campaign, out, tests=[first], outcomes="FAIL")


def test_ctrl_c_leaves_no_folder(tmp_path: Path, sample_campaign: Path) -> None:
    def press(done: int, _: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_traces(sample_campaign, tmp_path / "t", on_progress=press)
    assert list(tmp_path.iterdir()) == []


def test_memory_holds_one_drive_at_a_time(
    tmp_path: Path, sample_campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alive: weakref.WeakSet[Any] = weakref.WeakSet()
    counts = []

    def counted(test: Any) -> DriveTrace:
        trace = trace_of_test(test)
        alive.add(test)
        alive.add(trace)
        gc.collect()
        counts.append(len(alive))
        return trace

    monkeypatch.setattr(trace_folder, "trace_of_test", counted)
    export_traces(sample_campaign, tmp_path / "t")
    assert len(counts) > 20
    assert max(counts) <= 4
