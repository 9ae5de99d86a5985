"""The bridge and the node that `docs/ros2.md` shows, over a stand-in of ROS 2's packages."""

from __future__ import annotations

import shlex
import sys
import time
from pathlib import Path

import pytest
from page_files import page_file
from ros2_standin import write_standin

from frenetic import Driver
from frenetic.drivers import CommandDriver
from frenetic.oracle.drive import Drive, Rules
from frenetic.simulators import EmbeddedSimulator
from frenetic.testing import TrackerContract
from frenetic.testing.tracker_contract import ROADS

BRIDGE = "ros2_bridge.py"


def bridge(folder: Path, *arguments: str) -> str:
    """Return the command of the bridge in a folder with a stand-in."""
    (folder / BRIDGE).write_text(page_file("ros2.md", BRIDGE), encoding="utf-8")
    return shlex.join([sys.executable, str(folder / BRIDGE), *arguments])


def drive(driver: Driver) -> Drive:
    return EmbeddedSimulator(rules=Rules(speed_limit=36.0)).drive(ROADS["left-hand circle"], driver)


class TestNodeOfThePage(TrackerContract):
    """The page's node, by speeds and yaw rates."""

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        node = page_file("ros2.md", "pursuit_node.py").replace("14.0", "8.0")
        write_standin(tmp_path, node)
        self._command = bridge(tmp_path, "--ros-args", "-p", "command:=twist")

    def make(self) -> Driver:
        return CommandDriver(self._command)


class TestNodeWithOldCommands(TrackerContract):
    """A node that sends a wrong command with an old stamp before each right one."""

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        write_standin(tmp_path)
        self._command = bridge(tmp_path)

    def make(self) -> Driver:
        return CommandDriver(self._command)


@pytest.mark.parametrize("arguments", [[], ["-p", "clock:=first"]])
def test_each_drive_begins_with_the_reset_of_the_node(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    """The clock comes last unless the user asks for another order."""
    write_standin(tmp_path)
    arguments = ["--ros-args", "-p", "reset_service:=forget", "-p", "period:=0.1", *arguments]
    driver = CommandDriver(bridge(tmp_path, *arguments))
    assert driver.period == 0.1
    for _ in range(3):
        driven = drive(driver)
        assert driven.trouble is None, driven.trouble
    deadline = time.monotonic() + 60.0
    printed = ""
    while printed.count("\n") < 4 and time.monotonic() < deadline:
        printed += capsys.readouterr().err
        time.sleep(0.01)
    order = "first" if "clock:=first" in arguments else "last"
    assert printed.split("\n")[:2] == ["forgotten", f"the clock comes {order}"]
    assert printed.count("forgotten") == 3


def test_a_node_that_does_not_answer_is_a_fault(tmp_path: Path) -> None:
    silent = """
        import rclpy
        from standin_messages import AckermannDriveStamped, Odometry
        node = rclpy.create_node("silent")
        node.create_subscription(Odometry, "odom", str, 10)
        node.create_publisher(AckermannDriveStamped, "drive", 10)
    """
    write_standin(tmp_path, silent)
    driven = drive(CommandDriver(bridge(tmp_path)))
    assert driven.trouble is not None
    assert "no message is on its way" in driven.trouble.reason


@pytest.mark.skipif(sys.platform == "win32", reason="the bridge is for POSIX")
def test_the_bridge_starts_nodes_in_domains_of_their_own(tmp_path: Path) -> None:
    write_standin(tmp_path)
    file = tmp_path / "started.py"
    file.write_text(
        "import os, time\n"
        f"name = r'{tmp_path}/domain-' + os.environ['ROS_DOMAIN_ID']\n"
        "open(name, 'w').close()\n"
        "print('printed by the node')\n"
        "time.sleep(600)\n"
    )
    command = bridge(tmp_path, shlex.join([sys.executable, str(file)]))
    drivers = [CommandDriver(command) for _ in range(2)]
    for driver in drivers:
        driven = drive(driver)
        assert driven.trouble is None, driven.trouble
    deadline = time.monotonic() + 60.0
    while len(list(tmp_path.glob("domain-*"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(list(tmp_path.glob("domain-*"))) == 2
