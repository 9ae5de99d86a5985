"""Pictures: every road and drive gives a valid file with the right texts."""

from __future__ import annotations

import struct
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from frenetic import Budget, EmbeddedSimulator, Planner, RandomSearch
from frenetic.campaign import Campaign, CampaignStore
from frenetic.errors import FreneticError, Trouble
from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import judge
from frenetic.report import draw_drive, draw_gallery, draw_road
from frenetic.report.judged_drive import judge_drive
from frenetic.report.orientation import edges_of
from frenetic.report.picture import draw_test
from frenetic.road import Pose, Road

RATE = 20.0  # records per s


def bends(*curvatures: float, step: float = 10.0, lane_width: float = 4.0) -> Road:
    """Return a road of these curvatures, in 1/m."""
    return Road(np.array(curvatures), step, lane_width=lane_width)


def drive_along(
    road: Road,
    *,
    speed: float = 12.0,
    until: float | None = None,
    drift: float = 0.0,
    rules: Rules | None = None,
    trouble: Trouble | None = None,
    stand: float = 0.0,
) -> Drive:
    """Return a drive from the lane's centre at `speed` that drifts `drift` m to the left.

    The car drives `until` m, by default the whole road, and then stands for `stand` s.
    """
    end = road.length if until is None else until
    s = np.arange(0.0, end, speed / RATE) if end > 0.0 else np.zeros(1)
    s = np.concatenate([s, np.full(round(stand * RATE), s[-1])])
    poses = np.array([road.pose_at(float(v)) for v in s])
    offset = -0.5 * road.lane_width + drift * (s / road.length) ** 3
    rows = np.zeros((len(s), len(Trajectory.names())))
    rows[:, 0] = np.arange(len(s)) / RATE
    rows[:, 1] = poses[:, 0] - offset * np.sin(poses[:, 2])
    rows[:, 2] = poses[:, 1] + offset * np.cos(poses[:, 2])
    rows[:, 3] = poses[:, 2]
    rows[:, 4] = speed
    return Drive(Trajectory.from_rows(rows), CarBody(), rules or Rules(), trouble=trouble)


SHORT = bends(0.0, 0.02, 0.0, step=10.5)
HAIRPIN = bends(0, 0, 0, 0, 0.02, 0.06, 0.065, 0.06, 0.065, 0.03, 0, 0, 0, 0)
RAISED = Trouble("It raised ValueError: $x_1")
WINDING = Road(0.06 * np.sin(np.arange(26)), pose=Pose(60.0, 40.0, 0.4))
LOOP = bends(*[0.1] * 30)  # goes around several times
ROADS = {
    "short": SHORT,
    "straight": bends(*[0.0] * 26),
    "hairpin": HAIRPIN,
    "winding": WINDING,
    "loop": LOOP,
    "narrow": bends(0.01, -0.03, 0.02, 0.0, lane_width=2.5),
    "spiral": Road(np.linspace(0.0, 8.0, 40), 2.0),
    "tiny": bends(0.0, 0.0, step=0.5),
    "long": Road(0.002 * np.sin(np.arange(4000) / 50.0)),
}


def png_size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels; assert that the file is a whole PNG."""
    data = path.read_bytes()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    assert data.endswith(b"IEND\xaeB`\x82")
    width, height, _, colours = struct.unpack(">IIBB", data[16:26])
    assert colours == 2  # red, green, blue, and no transparency
    return int(width), int(height)


def svg_texts(path: Path) -> list[str]:
    """Return the texts of an SVG file."""
    root = ET.fromstring(path.read_text(encoding="utf-8"))
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    return ["".join(e.itertext()) for e in root.iter("{http://www.w3.org/2000/svg}text")]


def file_names(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def test_a_failure_has_labels_figures_and_its_reason(tmp_path: Path) -> None:
    drive = drive_along(HAIRPIN, drift=5.0)
    result = judge(HAIRPIN, drive)
    assert result.outcome is Outcome.FAIL
    draw_drive(HAIRPIN, drive, tmp_path / "a.svg", title="Test 123: FAIL")
    texts = svg_texts(tmp_path / "a.svg")
    labels = {"distance along the road (m)", "oob distance (m)", "curvature (1/m)", "start", "end"}
    labels |= {"speed (km/h)", "departure", "departure to the left"}
    figures = {f"{result.duration:.1f} s", f"{HAIRPIN.length:.0f} m"}
    figures.add(f"{result.moobd:.2f} m".replace("-", "−"))
    assert labels | figures | {"Test 123: FAIL", result.reason} <= set(texts)
    assert any(text.startswith("MOOBD −") for text in texts)


def test_slopes_are_shown_where_a_road_has_them(tmp_path: Path) -> None:
    grade = np.array([[0.0, 0.06], [130.0, -0.03]])
    lean = np.array([[0.0, 0.0], [60.0, -0.07]])
    slopes = {"height (m), with the grade", "superelevation (%), + falls to the right"}
    wanted: set[str]
    for road, wanted in (
        (HAIRPIN, set()),
        (replace(HAIRPIN, grade=grade, superelevation=lean), slopes | {"+5.4 %", "−2.4 %"}),
        (replace(HAIRPIN, grade=grade), slopes - {"superelevation (%), + falls to the right"}),
    ):
        draw_drive(road, drive_along(road, drift=5.0), tmp_path / "a.svg")
        draw_road(road, tmp_path / "b.svg")
        for name in ("a.svg", "b.svg"):
            texts = {*svg_texts(tmp_path / name)}
            assert wanted <= texts
            assert not (slopes - wanted) & texts


def test_drawn_lanes_widen() -> None:
    road = Road([0.0] * 11, pose=Pose(0.0, 0.0, 0.0), widening=[[0.0, 0.0], [100.0, 1.0]])
    left, right = np.split(edges_of(road, 10.0), 2)
    wanted = 4.0 + np.arange(11) / 10.0
    assert left[:, 1] == pytest.approx(wanted)
    assert right[:, 1] == pytest.approx(-wanted)
    assert left[:, 0] == pytest.approx(np.arange(11) * 10.0)


@pytest.mark.parametrize(
    ("name", "drift"),
    [
        ("winding", 5.0),
        ("tiny", 5.0),
        ("loop", -5.0),
        *(
            pytest.param(name, 5.0, marks=pytest.mark.heavy)
            for name in ROADS
            if name not in ("winding", "tiny")
        ),
        pytest.param("hairpin", 0.0, marks=pytest.mark.heavy),
    ],
)
def test_every_road_can_be_drawn(name: str, drift: float, tmp_path: Path) -> None:
    road = ROADS[name]
    speed = max(0.2, road.length / 20.0)
    path = tmp_path / "a.png"
    draw_drive(road, drive_along(road, speed=speed, drift=drift), path)
    width, height = png_size(path)
    assert width == 1210
    assert 600 <= height <= 1900
    draw_road(road, tmp_path / "a.svg", reason="The road is too sharp")
    texts = svg_texts(tmp_path / "a.svg")
    assert {"Road", "The road is too sharp", "curvature (1/m)"} <= set(texts)
    assert texts.count("start") == texts.count("end") == 1
    assert "oob distance (m)" not in texts
    assert file_names(tmp_path) == ["a.png", "a.svg"]


def unrecorded(trouble: Trouble | None) -> Drive:
    """Return a drive without records."""
    empty = np.empty((0, len(Trajectory.names())))
    return Drive(Trajectory.from_rows(empty), trouble=trouble)


def derailed(k: int, x: float, y: float) -> Drive:
    """Return a drive whose records from `k` on lie at (x, y)."""
    table = drive_along(WINDING).trajectory.to_rows()
    table[k:, 1:3] = x, y
    return Drive(Trajectory.from_rows(table), trouble=Trouble("The simulator crashed"))


TIMEOUT = Rules(timeout_base=1.0, timeout_speed=10.0)
ENDS: dict[str, tuple[Drive, str]] = {
    "nothing": (unrecorded(None), "Drive: ERROR"),
    "no start": (unrecorded(Trouble("The simulator did not start")), "Drive: ERROR"),
    "one record": (drive_along(WINDING, until=0.0), "Drive: ERROR"),
    "stopped": (drive_along(WINDING, until=60.0), "Drive: ERROR"),
    "error": (drive_along(WINDING, until=60.0, trouble=RAISED), "Drive: ERROR"),
    "astray": (derailed(100, 1e5, -1e5), "Drive: ERROR"),
    "far": (derailed(100, 1e30, 1e30), "Drive: ERROR"),
    "not a number": (derailed(100, np.nan, np.inf), "Drive: ERROR"),
    "no number": (derailed(0, np.nan, 0.0), "Drive: ERROR"),
    "stuck": (drive_along(WINDING, until=80.0, stand=12.0), "ended at "),
    "timeout": (drive_along(WINDING, speed=3.0, rules=TIMEOUT), "ended at "),
}


LIGHT_ENDS = {"nothing", "stopped", "not a number", "timeout"}
"""Ends that light tests draw."""


@pytest.mark.parametrize(
    "name",
    [name if name in LIGHT_ENDS else pytest.param(name, marks=pytest.mark.heavy) for name in ENDS],
)
def test_an_unfinished_drive_is_drawn_up_to_its_end(name: str, tmp_path: Path) -> None:
    drive, start = ENDS[name]
    for file in ("a.svg", "a.png"):
        draw_drive(WINDING, drive, tmp_path / file)
    texts = svg_texts(tmp_path / "a.svg")
    assert any(text.startswith(start) for text in texts)
    assert judge(WINDING, drive).reason in texts


def test_any_title_and_reason_can_be_written(tmp_path: Path) -> None:
    title = "a & <b> $x_1$ $ \x00\x1b[0m\n" + "道路 " + "long " * 40
    reason = "why & <why> $y$ \x07" + "because " * 100
    for name in ("a.svg", "a.png", "a.pdf"):
        draw_road(WINDING, tmp_path / name, title=title, reason=reason)
    texts = svg_texts(tmp_path / "a.svg")
    assert any(t.startswith("a & <b> $x_1$ $ [0m 道路 long") and t.endswith("…") for t in texts)
    assert any(t.startswith("why & <why> $y$ because") for t in texts)


@pytest.mark.parametrize(
    ("name", "start"),
    [
        ("a.png", b"\x89PNG"),
        pytest.param("A.PNG", b"\x89PNG", marks=pytest.mark.heavy),
        ("a.svg", b"<?xml"),
        pytest.param("a.pdf", b"%PDF-", marks=pytest.mark.heavy),
    ],
)
def test_the_same_drive_gives_the_same_bytes_with_any_settings(
    name: str, start: bytes, tmp_path: Path
) -> None:
    drive, path = drive_along(HAIRPIN, drift=5.0), tmp_path / name
    path.write_bytes(b"old")
    pictures = set()
    for settings in ({}, {"font.size": 30.0, "svg.fonttype": "path", "savefig.bbox": "tight"}):
        with mpl.rc_context(settings):
            before = dict(mpl.rcParams)
            draw_drive(HAIRPIN, drive, path)
            assert dict(mpl.rcParams) == before
        pictures.add(path.read_bytes())
    assert len(pictures) == 1
    assert pictures.pop().startswith(start)


def test_a_picture_that_cannot_be_written_is_a_one_line_error(tmp_path: Path) -> None:
    drive = drive_along(SHORT)
    draws: list[Callable[[Path], None]] = [
        lambda path: draw_road(SHORT, path),
        lambda path: draw_drive(SHORT, drive, path),
        lambda path: draw_gallery([("a", SHORT, drive)], path),
    ]
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_text("in the way")
    suffix, place = r"must end with \.png, \.svg or \.pdf", "cannot write the picture"
    mistakes = dict.fromkeys(("a.jpeg", "a", "a.png.txt"), suffix)
    mistakes |= dict.fromkeys(("folder.png", "missing/a.png", "file/a.png"), place)
    for name, pattern in mistakes.items():
        for draw in draws:
            with pytest.raises(FreneticError, match=pattern) as caught:
                draw(tmp_path / name)
            assert "\n" not in str(caught.value)
    for count in (0, 401):
        with pytest.raises(FreneticError, match="1 to 400 are allowed"):
            draw_gallery([("a", SHORT, drive)] * count, tmp_path / "a.png")
    assert file_names(tmp_path) == ["file", "folder.png"]


@pytest.mark.parametrize("count", [1, 7, 20])
def test_a_gallery_shows_every_caption(count: int, tmp_path: Path) -> None:
    drives = [
        drive_along(WINDING),
        drive_along(HAIRPIN, drift=-5.0),
        unrecorded(Trouble("It broke")),
    ]
    roads = [WINDING, HAIRPIN, WINDING]
    items = [(f"Test {k}", roads[k % 3], drives[k % 3]) for k in range(count)]
    draw_gallery(items, tmp_path / "a.svg", title="Failures")
    draw_gallery(items, tmp_path / "a.png")
    texts = svg_texts(tmp_path / "a.svg")
    assert "Failures" in texts
    assert [text for text in texts if text.startswith("Test ")] == [c for c, _, _ in items]
    png_size(tmp_path / "a.png")


def test_drawing_imports_matplotlib_late_and_leaves_pyplot_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    code = (
        "import sys, pathlib, frenetic.report\n"
        "assert 'matplotlib' not in sys.modules\n"
        "from frenetic.report import draw_road\n"
        "from frenetic.road import Road\n"
        f"draw_road(Road([0.0, 0.01, 0.0]), pathlib.Path({str(path)!r}))\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    png_size(path)


def test_a_test_is_drawn_with_the_verdict_of_its_campaign(tmp_path: Path) -> None:
    search = Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(aggression=1.6),
        budget=Budget(failures=1),
        folder=tmp_path / "c",
    )
    search.run()
    with CampaignStore.open(search.folder) as store:
        test = store.test(next(store.tests(Outcome.FAIL)).id)
    # A rounded last record may be within the tolerance, so the stored verdict counts.
    assert test.trajectory is not None
    shorter = Trajectory.from_rows(test.trajectory.to_rows()[:-1])
    test = replace(test, trajectory=shorter)
    assert test.drive is not None
    assert judge_drive(test.road, test.drive).result.outcome is Outcome.ERROR
    assert judge_drive(test.road, test).result == test.result
    draw_test(test, tmp_path / "a.svg", "Test 1")
    draw_gallery([("Test 1", test.road, test)], tmp_path / "b.svg")
    assert any(text.startswith("departure to the") for text in svg_texts(tmp_path / "a.svg"))
    assert any("MOOBD −" in text for text in svg_texts(tmp_path / "b.svg"))
