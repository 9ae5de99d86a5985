"""Programs for tests: Python files that answer messages, well or badly."""

from __future__ import annotations

import shlex
import sys
import textwrap
from pathlib import Path

DRIVER = """
    import json, os, sys, time

    mode, acts = [*sys.argv[1:], ""][0], 0
    for line in sys.stdin:
        [(kind, values)] = json.loads(line).items()
        answer = {}
        if kind == "act":
            acts += 1
            answer = {"steering": 0.3 * values["ahead"][4][1] / 8.0, "throttle": 0.2}
            if acts == 5:
                BAD
        print(json.dumps(answer), flush=True)
"""


def command(folder: Path, code: str, *arguments: str, name: str = "program.py") -> str:
    """Write a program into a folder; return the command that runs it."""
    file = folder / name
    file.write_text(textwrap.dedent(code), encoding="utf-8")
    return shlex.join([sys.executable, str(file), *arguments])


def driver(folder: Path, bad: str = "pass") -> str:
    """Return the command of a driver that does something at its fifth observation of all drives."""
    return command(folder, DRIVER.replace("BAD", bad))


SEARCH = """
    import json, random, sys

    mode, told = [*sys.argv[1:], ""][0], 0
    for line in sys.stdin:
        [(kind, values)] = json.loads(line).items()
        answer = {}
        if kind == "hello":
            draw = random.Random(values["seed"]).uniform
            answer = {"trace": mode == "trace"}
        elif kind == "ask":
            curvatures = [0.0] + [round(draw(-0.04, 0.04), 4) for _ in range(12)]
            answer = {"candidate": {"curvatures": curvatures, "operator": "drawn"}}
            BAD
        else:
            told += 1
        print(json.dumps(answer), flush=True)
"""


def search(folder: Path, bad: str = "pass", *arguments: str) -> str:
    """Return the command of a random search that does something when it is asked."""
    return command(folder, SEARCH.replace("BAD", bad), *arguments, name="search.py")


SIMULATOR = """
    import json, math, sys

    for line in sys.stdin:
        [(kind, values)] = json.loads(line).items()
        if kind == "hello":
            answer = {"length": 4.0, "max_steering": 0.5}
        else:
            if kind == "start":
                x, y, heading = values["pose"]
                speed = yaw_rate = steering = 0.0
            else:
                seconds = values["seconds"]
                steering = max(-0.5, min(0.5, values["steering"]))
                speed += seconds * (4.0 * values["throttle"] - 8.0 * values["brake"])
                speed = max(speed, 0.0)
                yaw_rate = speed * math.tan(steering) / 2.58
                heading += yaw_rate * seconds
                x += speed * math.cos(heading) * seconds
                y += speed * math.sin(heading) * seconds
            answer = {"x": x, "y": y, "heading": heading, "speed": speed, "yaw_rate": yaw_rate}
            answer["steering"] = steering
            BAD
        print(json.dumps(answer), flush=True)
"""


def simulator(folder: Path, bad: str = "pass") -> str:
    """Return the command of a simulator that does something at each start and step."""
    return command(folder, SIMULATOR.replace("BAD", bad), name="simulator.py")
