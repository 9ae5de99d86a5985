"""Comparing two versions of a driver on the command line."""

from __future__ import annotations

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

OLD, NEW, WORSE = (f"planner,aggression={aggression}" for aggression in (1.25, 0.8, 2))
"""So different that few roads show which is better."""
FEW = ("--fresh", "20")


@pytest.fixture(scope="module")
def old_campaign(tmp_path_factory: pytest.TempPathFactory, prepare: Callable[..., None]) -> Path:
    folder = tmp_path_factory.mktemp("versions") / "night"
    search = ("run", "--driver", OLD, "--simulations", "12", "--seed", "3", "--workers", "1")
    prepare(*search, "--out", str(folder))
    return folder


@pytest.fixture(autouse=True)
def _night(frenetic: Frenetic, old_campaign: Path) -> None:
    """A copy of the old version's campaign in the folder of the command line."""
    shutil.copytree(old_campaign, "night")


def test_the_first_line_says_which_version_is_better(frenetic: Frenetic) -> None:
    answer = frenetic("compare", "night", "--driver", NEW, *FEW)
    assert answer.code == 0
    first, quality, old, new, *_ = answer.out.splitlines()
    assert first.startswith("new is better but ")
    assert "slower: of 20 fresh roads, it fails on " in first
    assert quality.startswith("quality: ")
    assert old.startswith(f"old: {OLD} (")
    assert new.startswith(f"new: {NEW} (")
    assert "old's failing roads" in answer.out
    comparison = frenetic("compare", "night", "--driver", NEW, *FEW, "--json").json
    assert (comparison["verdict"], comparison["fresh"]["judged"]) == ("new is better", 20)
    assert all(cause in answer.out for cause in comparison["causes"])
    worse = frenetic("compare", "night", "--driver", WORSE, *FEW)
    assert worse.code == 1
    assert worse.out.startswith("new is worse: of 20 fresh roads, it fails on ")


@pytest.mark.heavy
def test_a_driver_edited_in_place_is_compared_with_its_old_version(frenetic: Frenetic) -> None:
    text = "from frenetic import Planner\n\nclass Mine(Planner):\n    usual = {}\n\n"
    text += "    def __init__(self):\n        super().__init__(aggression=self.usual)\n"
    search = ("--driver", "mine.py:Mine", "--simulations", "60", "--seed", "3", "--workers", "1")

    def write(aggression: float, comment: str = "") -> None:
        Path("mine.py").write_text(text.format(aggression) + comment)
        # Python compares the times of source and bytecode in whole seconds.
        written = 1_700_000_000 + 100 * aggression  # s
        os.utime("mine.py", (written, written))

    comparison = ("compare", "v1", "--driver", "mine.py:Mine", *FEW)

    def first_line() -> tuple[str, int]:
        answer = frenetic(*comparison)
        return answer.out.partition(":")[0], answer.code

    write(1.25)
    assert frenetic("run", *search, "--out", "v1").code == 0
    assert frenetic(*comparison).refuses("both versions are the same")
    write(1.25, "# a remark\n")
    assert first_line() == ("no difference shown", 3)
    write(0.8)
    answer, code = first_line()
    assert (answer.startswith("new is better"), code) == (True, 0)
    write(2.0)
    assert first_line() == ("new is worse", 1)


def test_the_same_command_goes_on_after_ctrl_c(
    frenetic: Frenetic, stopping_driver: Callable[[int], str]
) -> None:
    left = []
    for stop in (3, 2):
        answer = frenetic("compare", "night", "--driver", stopping_driver(stop), *FEW)
        assert (answer.code, answer.out) == (130, "")
        left.append(int(answer.err.partition("Interrupted: ")[2].split()[0]))
        advice = "drives to go; the same command continues: frenetic compare night --driver"
        assert f"{advice} stopping.py:Stopping --fresh 20\n" in answer.err
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert left[1] == left[0] - 2
    whole = frenetic("compare", "night", "--driver", stopping_driver(0), *FEW)
    assert "of 20 fresh roads" in whole.out


def recorded_progress(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Pairs of numbers that a command's progress bar gets: drives done and drives in all."""
    shown: list[tuple[int, int]] = []

    @contextmanager
    def record(*_: object) -> Iterator[Callable[[int, int], None]]:
        yield lambda done, total: shown.append((done, total))

    monkeypatch.setattr("frenetic.cli.rerun_options.counted_progress", record)
    return shown


def test_progress_never_exceeds_its_total(
    frenetic: Frenetic,
    stopping_driver: Callable[[int], str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The comparison is fresh, goes on after Ctrl-C, has stored roads to spare, or is complete."""
    failing = frenetic("show", "night", "--json").json["failed"]
    shown = recorded_progress(monkeypatch)
    for fresh, stop in ((20, 3), (20, 2), (20, 0), (8, 0), (8, 0)):
        shown.clear()
        frenetic("compare", "night", "--driver", stopping_driver(stop), "--fresh", str(fresh))
        total = 3 * 2 * fresh + failing  # undisturbed, with noise, with gusts
        assert {whole for _, whole in shown} == {total}
        done = [drives for drives, _ in shown]
        assert done == sorted(done)
        assert (done[-1] == total) == (not stop)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[with]\ndelay = 0.1\n", "new.toml names no driver: name one there, or give --driver"),
        (
            'driver = "stanley"\nspeed_limit = 60\n[with]\ndelay = 0.1\n',
            "new.toml and night differ in 'with', 'speed_limit', but both versions drive as the",
        ),
    ],
)
def test_a_file_that_changes_more_than_the_driver_is_refused(
    frenetic: Frenetic, text: str, problem: str
) -> None:
    Path("new.toml").write_text(text)
    before = sorted(Path("night").rglob("*"))
    answer = frenetic("compare", "night", "--as", "new.toml", *FEW)
    assert answer.code == 2
    assert problem in answer.err
    assert sorted(Path("night").rglob("*")) == before


def test_the_file_of_the_new_version_may_be_a_campaigns_file(frenetic: Frenetic) -> None:
    text = Path("night/campaign.toml").read_text()
    Path("new.toml").write_text(text.replace(OLD, NEW))
    answers = [
        frenetic("compare", "night", *new, *FEW).out
        for new in (("--driver", NEW), ("--as", "new.toml"))
    ]
    assert answers[0] == answers[1]
    assert f"new: {NEW} (" in answers[0]


SLACK = "stanley,offset_gain=0.3,yaw_damping=0"
"""A driver that passes as Stanley's law does, and sways as soon as noise disturbs it."""


@pytest.fixture
def rural(frenetic: Frenetic) -> str:
    """A campaign of Stanley's law on country roads."""
    search = ("--strategy", "random", "--roads", "rural-80", "--simulations", "1", "--seed", "1")
    assert frenetic("run", "--driver", "stanley", *search, "--out", "rural").code == 0
    return "rural"


def test_the_first_line_says_which_version_drives_better_where_both_pass(
    frenetic: Frenetic, rural: str
) -> None:
    command = ("compare", rural, "--driver", SLACK, "--fresh", "24", "--disturb", "noise=0.1")
    answer = frenetic(*command, "--out", "quality.html")
    assert answer.code == 1
    first, second, *_ = answer.out.splitlines()
    assert first.startswith("with noise 0.1 m, new crosses the edge of its lane on ")
    assert second.startswith("failures: no difference shown: of 24 fresh roads, ")
    assert "Quality, on roads that both pass" in answer.out
    assert answer.out.splitlines()[-1] == "quality.html"
    page = Path("quality.html").read_text(encoding="utf-8")
    assert first.removeprefix("with") in page
    document = frenetic(*command, "--json").json
    assert document["sentences"] == [first, second]
    assert document["overall"] == "new is worse"
    quiet = frenetic(*command[:-1], "none", "--json")
    assert quiet.code == 3
    assert [drives["conditions"] for drives in quiet.json["quality"]["drives"]] == [""]


def test_several_conditions_may_disturb_at_once(frenetic: Frenetic) -> None:
    comparison = ("compare", "night", "--driver", NEW, "--fresh", "4", "--json")
    disturbed = frenetic(*comparison, "--disturb", "noise=0.1,gust=-5", "--disturb", "load=200")
    assert [drives["conditions"] for drives in disturbed.json["quality"]["drives"]] == [
        "",
        "noise 0.1 m, gust -5 m/s",
        "load 200 kg",
    ]


# Several road classes


@pytest.fixture
def two_classes(frenetic: Frenetic) -> tuple[str, str]:
    """Campaigns of a swaying driver in town and on country roads."""
    for roads in ("urban-50,length=300", "rural-80,length=600"):
        search = ("--roads", roads, "--simulations", "1", "--seed", "1", "--strategy", "random")
        folder = f"sway/{roads.partition(',')[0]}"
        assert frenetic("run", "--driver", SLACK, *search, "--out", folder).code == 0
    return "sway/urban-50", "sway/rural-80"


TAUT = ("--driver", "offset_gain=1.5,yaw_damping=0.05", "--fresh", "14", "--disturb", "noise=0.1")


def test_several_campaigns_show_on_which_roads_a_version_is_better(
    frenetic: Frenetic, two_classes: tuple[str, str]
) -> None:
    answer = frenetic("compare", *two_classes, *TAUT, "--out", "classes.html")
    assert answer.code in (0, 3)
    first, second, *lines = answer.out.splitlines()
    assert first.startswith("on urban-50, ")
    assert "; on rural-80, with noise 0.1 m, new keeps 0." in first
    assert second.startswith("failures: no difference shown on urban-50 and rural-80 (fails on 0")
    titles = [line.strip() for line in lines if line.startswith("Quality on")]
    assert titles == [
        "Quality on urban-50, on roads that both pass",
        "Quality on rural-80, on roads that both pass",
    ]
    assert any(line.startswith("rural-80, fresh ") for line in lines)
    assert lines[-1] == "classes.html"
    assert "Rural-80" in Path("classes.html").read_text(encoding="utf-8")
    again = frenetic("compare", "sway", *TAUT, "--json")  # a folder that holds both
    assert again.code == answer.code
    assert [*again.json["classes"]] == ["rural-80", "urban-50"]
    assert again.json["overall"] in ("new is better", "new is better and worse")
    alone = frenetic("compare", "sway/rural-80", *TAUT, "--json").json["quality"]
    of_class = again.json["classes"]["rural-80"]["quality"]
    assert [d["p"] for d in of_class["differences"]] == [d["p"] for d in alone["differences"]]
    assert all(
        d["p_corrected"] >= other["p_corrected"]
        for d, other in zip(of_class["differences"], alone["differences"], strict=True)
    )


def test_ctrl_c_on_one_class_leaves_the_drives_of_the_others(
    frenetic: Frenetic,
    stopping_driver: Callable[[int], str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = ("--driver", OLD, "--simulations", "2", "--seed", "3", "--with", "friction=0.9")
    assert frenetic("run", *search, "--out", "wet").code == 0
    failing = sum(frenetic("show", name, "--json").json["failed"] for name in ("night", "wet"))
    command = ("compare", "night", "wet", "--fresh", "4", "--disturb", "none", "--driver")
    stopped = frenetic(*command, stopping_driver(3))
    assert (stopped.code, stopped.out) == (130, "")
    remaining = int(stopped.err.partition("Interrupted: ")[2].split()[0])
    shown = recorded_progress(monkeypatch)
    whole = frenetic(*command, stopping_driver(0), "--json")
    assert [*whole.json["classes"]] == ["competition (night)", "competition (wet)"]
    assert shown[-1] == (16 + failing, 16 + failing)
    assert 8 <= remaining < 16 + failing
