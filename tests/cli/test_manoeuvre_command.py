"""`frenetic drive --manoeuvre` and `--strategy sweep` on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

SLOW_DRIVER = """
from frenetic import Controls

class Slow:
    def reset(self, setup):
        self.wheelbase = setup.wheelbase

    def act(self, observation):
        x, y = observation.ahead[4]
        steering = 2 * self.wheelbase * y / (x * x + y * y)
        return Controls(steering, throttle=0.3 if observation.speed < 12 else 0.0)
"""
OWN_MANOEUVRE = """
from dataclasses import dataclass
from typing import ClassVar

from frenetic import Road
from frenetic.manoeuvres import Measures, QuantityName

TOP_SPEED = QuantityName("top_speed", "car", "km/h")

@dataclass
class Straight:
    name: ClassVar[str] = "straight"
    QUANTITIES: ClassVar[tuple[QuantityName, ...]] = (TOP_SPEED,)
    length: float = 150.0

    def conditions(self, speed):
        return {}

    def road(self, speed, lane_width):
        return Road([0.0] * (int(self.length / 10.0) + 1), lane_width=lane_width)

    def measure(self, drive):
        return Measures((TOP_SPEED.measured(3.6 * drive.located.path.speed.max()),), ())
"""
STRAIGHT_DRIVER = """
from frenetic import Controls

class Straight:
    def reset(self, setup):
        pass

    def act(self, observation):
        return Controls(0.0, throttle=0.3)
"""


@pytest.mark.parametrize(
    ("word", "quantity"),
    [
        ("step,radius=200", "settling time"),
        ("lane-offset,offset=-0.4", "steady offset"),
        ("constant-radius", "understeer gradient"),
        ("sine,frequencies=4", "bandwidth"),
        ("slalom,period=5", "phase delay"),
    ],
)
def test_a_manoeuvre_prints_and_draws_what_it_measures(
    frenetic: Frenetic, word: str, quantity: str
) -> None:
    answer = frenetic("drive", "--manoeuvre", word, "--plot", "m.png")
    assert answer.code == 0, answer.err
    assert answer.out.startswith("PASS  Car reached the end of the road")
    assert f"manoeuvre  {word.partition(',')[0]}" in answer.out
    (line,) = (line for line in answer.out.splitlines() if line.startswith(f"{quantity} "))
    document = frenetic("drive", "--manoeuvre", word, "--json").json
    values = {row["name"].replace("_", " "): row["value"] for row in document["quantities"]}
    assert f"{round(values[quantity], 4) + 0.0:.3g}" in line.split()
    with Image.open("m.png") as picture:
        assert picture.size[0] > 1000


def test_speed_class_and_conditions_come_from_the_usual_options(frenetic: Frenetic) -> None:
    words = ("drive", "--manoeuvre", "step", "--json")
    fast = frenetic(*words, "--with", "speed=100", "--with", "delay=0.1").json
    assert fast["speed_limit"] == pytest.approx(100.0)
    assert fast["conditions"] == {"speed": 100.0, "delay": 0.1}
    rural = frenetic(*words, "--roads", "rural-80").json
    assert rural["speed_limit"] == pytest.approx(80.0)
    prompt = frenetic(*words, "--with", "speed=100").json
    late_by, prompt_by = (
        next(row["value"] for row in document["quantities"] if row["name"] == "delay")
        for document in (fast, prompt)
    )
    assert late_by > prompt_by + 0.05


def test_a_driver_of_the_users_own_drives_manoeuvres(frenetic: Frenetic) -> None:
    Path("slow.py").write_text(SLOW_DRIVER)
    answer = frenetic("drive", "--manoeuvre", "step,radius=100", "--driver", "slow.py:Slow")
    assert answer.code == 0, answer.err
    assert "slow.py:Slow in embedded" in answer.out
    assert "steady offset" in answer.out


def test_a_manoeuvre_of_the_users_own_is_driven(frenetic: Frenetic) -> None:
    Path("mine.py").write_text(OWN_MANOEUVRE)
    answer = frenetic("drive", "--manoeuvre", "mine.py:Straight,length=120", "--plot", "m.png")
    assert answer.code == 0, answer.err
    assert "top speed  car" in answer.out
    (quantity,) = frenetic("drive", "--manoeuvre", "mine.py:Straight", "--json").json["quantities"]
    assert quantity["name"] == "top_speed"
    assert 60.0 < quantity["value"] < 70.0
    (line,) = frenetic("drive", "--manoeuvre", "mine.py:Other").err.splitlines()
    assert "mine.py has no class 'Other'" in line


def test_what_cannot_be_measured_is_said(frenetic: Frenetic) -> None:
    Path("straight.py").write_text(STRAIGHT_DRIVER)
    words = ("drive", "--manoeuvre", "step", "--driver", "straight.py:Straight")
    answer = frenetic(*words, "--plot", "m.svg")
    assert answer.code == 0, answer.err
    assert answer.out.startswith("FAIL  Car drove out of the lane to the right")
    assert answer.out.count("not measured: the drive ended at ") == 7
    assert "not measured" in Path("m.svg").read_text()


def test_a_sweep_is_a_campaign_with_a_map(frenetic: Frenetic) -> None:
    words = ("run", "--strategy", "sweep,radii=3,speeds=2,turns=1", "--seed", "1", "--out", "c")
    ran = frenetic(*words, "--driver", "aggression=1.4", "--simulations", "9")
    assert ran.code == 0, ran.err
    assert "speed limit 30 to 80 km/h, swept" in ran.err
    resumed = frenetic("resume", "c", "--simulations", "100")
    assert "every bend was driven at every speed limit" in resumed.out
    document = frenetic("show", "c", "--json").json["sweep"]
    assert document["radii"] == [15.0, 38.7, 100.0]
    assert document["speeds"] == [30.0, 80.0]
    assert [cell["drives"] for cell in document["cells"]] == [2] * 6
    shown_map = frenetic("show", "c").out
    assert "speed limit 30 to 80 km/h, swept" in shown_map
    assert "Failures/drives and lowest MOOBD (m) by radius and speed limit" in shown_map
    last = document["cells"][-1]
    assert f"{last['failures']}/2  {last['moobd']:.2f}" in shown_map
    report = Path("c/report.html").read_text(encoding="utf-8")
    assert 'id="sweep"' in report
    assert f'href="#test-{last["worst_test"]}"' in report


def test_a_random_campaign_has_no_map_of_a_sweep(frenetic: Frenetic) -> None:
    frenetic("run", "--strategy", "random", "--simulations", "3", "--seed", "1", "--out", "c")
    assert frenetic("show", "c", "--json").json["sweep"] is None
    assert 'id="sweep"' not in Path("c/report.html").read_text(encoding="utf-8")
