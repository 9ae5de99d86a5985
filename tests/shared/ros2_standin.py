"""A stand-in of ROS 2's Python packages: topics and services within one process."""

from __future__ import annotations

import textwrap
from pathlib import Path

RCLPY = """
    import importlib
    import sys
    from collections import deque
    from types import SimpleNamespace

    queue, nodes, services = deque(), [], {}

    def init(args=None):
        arguments = list(args or [])
        pairs = [argument.split(":=") for argument in arguments if ":=" in argument]
        Node.parameters = Node.parameters | dict(pairs)

    def create_node(name):
        node = Node(name)
        nodes.append(node)
        if len(nodes) == 1:  # the node under test runs in this process, too
            importlib.import_module("node_under_test")
        return node

    def spin(node):
        pass  # the bridge delivers

    def spin_once(node, timeout_sec=None):
        if not queue:
            raise RuntimeError("no message is on its way")
        topic, message = queue.popleft()
        for node in nodes:
            for subscription in node.subscriptions:
                if subscription.topic_name == topic:
                    assert type(message) is subscription.kind
                    subscription.callback(message)

    def spin_until_future_complete(node, future):
        assert future.done

    def absolute(topic):
        return "/" + topic.lstrip("/")

    class Node:
        parameters = {}

        def __init__(self, name):
            self.subscriptions, self.publishers = [], []

        def declare_parameter(self, name, default):
            text = self.parameters.get(name)
            return SimpleNamespace(value=default if text is None else type(default)(text))

        def create_publisher(self, kind, topic, depth):
            publisher = Publisher(kind, absolute(topic))
            self.publishers.append(publisher)
            return publisher

        def create_subscription(self, kind, topic, callback, depth):
            subscription = SimpleNamespace(
                kind=kind, topic_name=absolute(topic), callback=callback
            )
            self.subscriptions.append(subscription)
            return subscription

        def count_publishers(self, topic):
            return sum(p.topic == topic for node in nodes for p in node.publishers)

        def create_service(self, kind, name, callback):
            services[absolute(name)] = callback

        def create_client(self, kind, name):
            return Client(kind, absolute(name))

        def destroy_client(self, client):
            pass

    class Publisher:
        def __init__(self, kind, topic):
            self.kind, self.topic = kind, topic

        def publish(self, message):
            assert type(message) is self.kind
            queue.append((self.topic, message))

        def get_subscription_count(self):
            return sum(s.topic_name == self.topic for node in nodes for s in node.subscriptions)

    class Client:
        def __init__(self, kind, name):
            self.name = name

        def wait_for_service(self):
            assert self.name in services

        def call_async(self, request):
            services[self.name](request, None)
            return SimpleNamespace(done=True)
"""
UTILITIES = """
    def remove_ros_args(args):
        return args[: args.index("--ros-args")] if "--ros-args" in args else list(args)
"""
MESSAGES = """
    class Message:
        def __init__(self, **values):
            for name, make in self.fields.items():
                setattr(self, name, values.pop(name) if name in values else make())
            assert not values, values

        def __setattr__(self, name, value):
            assert name in self.fields, name
            kind = self.fields[name]
            assert not (kind is float and type(value) is int), f"{name} needs a float"
            object.__setattr__(self, name, value)

    def kind(name, **fields):
        return type(name, (Message,), {"fields": fields})

    Time = kind("Time", sec=int, nanosec=int)
    Header = kind("Header", stamp=Time, frame_id=str)
    Point = kind("Point", x=float, y=float, z=float)
    Quaternion = kind("Quaternion", x=float, y=float, z=float, w=float)
    Pose = kind("Pose", position=Point, orientation=Quaternion)
    PoseStamped = kind("PoseStamped", header=Header, pose=Pose)
    PoseWithCovariance = kind("PoseWithCovariance", pose=Pose)
    Twist = kind("Twist", linear=Point, angular=Point)
    TwistStamped = kind("TwistStamped", header=Header, twist=Twist)
    TwistWithCovariance = kind("TwistWithCovariance", twist=Twist)
    Odometry = kind(
        "Odometry",
        header=Header,
        child_frame_id=str,
        pose=PoseWithCovariance,
        twist=TwistWithCovariance,
    )
    Path = kind("Path", header=Header, poses=list)
    Clock = kind("Clock", clock=Time)
    AckermannDrive = kind("AckermannDrive", steering_angle=float, speed=float)
    AckermannDriveStamped = kind("AckermannDriveStamped", header=Header, drive=AckermannDrive)

    class Empty:
        class Request:
            pass
"""
FILES = {
    "rclpy/__init__.py": RCLPY,
    "rclpy/utilities.py": UTILITIES,
    "standin_messages.py": MESSAGES,
    **{
        f"{package}/{module}.py": "from standin_messages import *\n"
        for package, module in (
            ("builtin_interfaces", "msg"),
            ("geometry_msgs", "msg"),
            ("nav_msgs", "msg"),
            ("rosgraph_msgs", "msg"),
            ("ackermann_msgs", "msg"),
            ("std_srvs", "srv"),
        )
    },
}
"""Path of a module -> its text."""
NODE = """
    import math
    import sys

    import rclpy
    from standin_messages import (
        AckermannDriveStamped, Clock, Empty, Header, Odometry, Path, Time, TwistStamped
    )

    class Node:
        def __init__(self):
            node = rclpy.create_node("pursuit")
            self.path, self.clock, self.order = None, (0, 0), None
            node.create_subscription(Clock, "clock", self.hear_clock, 10)
            node.create_subscription(Path, "path", self.hear_path, 10)
            node.create_subscription(Odometry, "odom", self.hear_odometry, 10)
            node.create_service(Empty, "forget", self.forget)
            self.drive = node.create_publisher(AckermannDriveStamped, "drive", 10)
            self.twist = node.create_publisher(TwistStamped, "cmd_vel", 10)

        def forget(self, request, response):
            print("forgotten", file=sys.stderr, flush=True)

        def hear_clock(self, message):
            clock = message.clock.sec, message.clock.nanosec
            assert clock > self.clock, "the clock goes back"
            self.clock = clock

        def hear_path(self, message):
            self.path = message

        def hear_odometry(self, message):
            stamp = message.header.stamp
            assert stamp is self.path.header.stamp
            if self.order is None:
                self.order = "first" if (stamp.sec, stamp.nanosec) == self.clock else "last"
                print("the clock comes", self.order, file=sys.stderr, flush=True)
            pose, speed = message.pose.pose, message.twist.twist.linear.x
            heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
            for place in self.path.poses:
                dx = place.pose.position.x - pose.position.x
                dy = place.pose.position.y - pose.position.y
                if math.hypot(dx, dy) > 6.0:
                    break
            left = math.cos(heading) * dy - math.sin(heading) * dx
            curvature = 2.0 * left / (dx * dx + dy * dy)
            header = Header(stamp=stamp)
            for command_header, gain in ((Header(stamp=Time(nanosec=1)), -1.0), (header, 1.0)):
                twist = TwistStamped(header=command_header)  # the first one is an old one
                twist.twist.linear.x, twist.twist.angular.z = 8.0, 8.0 * gain * curvature
                self.twist.publish(twist)
                drive = AckermannDriveStamped(header=command_header)
                drive.drive.steering_angle = math.atan(2.578 * gain * curvature)
                drive.drive.speed = 8.0
                self.drive.publish(drive)

    Node()
"""
"""A node that first sends a wrong command with an old stamp, and checks what it hears."""


def write_standin(folder: Path, node: str = NODE) -> None:
    """Write the stand-in's modules, and the text of the node under test, into a folder."""
    for path, text in {**FILES, "node_under_test.py": node}.items():
        file = folder / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(textwrap.dedent(text), encoding="utf-8")
