"""A simulator that is a program in any language; docs/programs.md lists the messages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from struct import Struct
from types import TracebackType
from typing import Any, ClassVar, Final, Literal, Self, TypeVar

from frenetic._support.bounds import Finite, Positive, check
from frenetic._support.option_text import PROGRAM
from frenetic.drivers.driver import DriveSetup
from frenetic.oracle.drive import CarBody, Rules
from frenetic.processes.programs import Answer, Program, ProgramError, command_files, command_words
from frenetic.road import Pose, Road
from frenetic.road.files import entries_of
from frenetic.simulators.stepped import Motion, SteppedSimulator

T = TypeVar("T")
PROTOCOL: Final = 1
"""Version of the messages."""
_STEP_FORM: Final = Struct("<4d")
_MOTION_FORM: Final = Struct("<7d")


class SimulatorHello(Answer):
    """The answer of a simulator's program to the first message: its car, and its form of steps."""

    records: Literal["json", "binary"] = "json"
    """Form of the messages and answers of steps."""
    length: Positive = CarBody.length
    """Length of the car's box, in m."""
    width: Positive = CarBody.width
    """Width of the car's box, in m."""
    centre_ahead: Finite = CarBody.centre_ahead
    """Distance from the centre of mass to the box's centre, in m, positive ahead."""
    front_axle: Positive = SteppedSimulator.front_axle
    """Distance from the centre of mass to the front axle, in m."""
    rear_axle: Positive = SteppedSimulator.rear_axle
    """Distance from the centre of mass to the rear axle, in m."""
    max_steering: Positive = SteppedSimulator.max_steering
    """Largest angle of the front wheels, in rad."""
    max_acceleration: Positive = SteppedSimulator.max_acceleration
    """Acceleration at full throttle and low speed, in m/s^2."""
    max_deceleration: Positive = SteppedSimulator.max_deceleration
    """Deceleration at full brake, in m/s^2."""


class MotionAnswer(Answer):
    """The answer to a start or a step: the motion of the car, as `Motion` has it."""

    x: Finite | None = None
    y: Finite | None = None
    heading: Finite | None = None
    speed: Finite = 0.0
    lateral_speed: Finite = 0.0
    yaw_rate: Finite = 0.0
    steering: Finite = 0.0


class SimulatorProgramError(RuntimeError):
    """A simulator's program that gave no usable answer."""


class CommandSimulator(SteppedSimulator):
    """A program in any language that moves a car.

    The program runs in the current folder, without a shell, for all drives, and is started again
    after it was lost.

    Args:
        program: the program with its arguments, split as a shell does.
        deadline: wall time that the program has for each answer, in s; at least 60 for the first.
        rules: Speed limit, oob tolerance and when a drive ends.
        wall_limit: Wall time that a drive may take, in s; a longer one is an ERROR.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the messages' meaning; campaigns record it."""

    def __init__(
        self,
        program: str,
        *,
        deadline: Positive = 5.0,
        rules: Rules | None = None,
        wall_limit: Positive = 60.0,
    ) -> None:
        super().__init__(rules=rules, wall_limit=wall_limit)
        check({"deadline": deadline}, CommandSimulator.__init__)
        self.options = {PROGRAM: program, "deadline": deadline, "wall_limit": wall_limit}
        self._words = command_words(program)
        self._deadline = deadline
        self._car: CarBody | None = None
        self._is_entered = False
        self._make_program()

    def _make_program(self) -> None:
        self._program = Program(self._words, self._deadline, self._greet)
        self._hello = SimulatorHello()

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes without the program: a copy in another process starts its own."""
        left_out = ("_program", "_hello")
        attributes = {name: value for name, value in vars(self).items() if name not in left_out}
        return attributes | {"_is_entered": False}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        vars(self).update(attributes)
        self._make_program()

    @property
    def version_files(self) -> tuple[str, ...]:
        """Files that belong to the simulator's version: the program, and its arguments' files."""
        return command_files(self._words)

    @property
    def car(self) -> CarBody:
        """The box that the car covers, which the program says.

        Outside of a ``with`` block a program is started for the answer, and ended again.
        """
        if self._car is None:
            self._call(self._program.start)
            if not self._is_entered:
                self._program.close()
        assert self._car is not None
        return self._car

    @car.setter
    def car(self, body: CarBody) -> None:
        self._car = body

    def __enter__(self) -> Self:
        """Start the program, which describes its car."""
        self._call(self._program.start)
        self._is_entered = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the program."""
        self._is_entered = False
        self._program.close()

    def start(self, road: Road, pose: Pose, setup: DriveSetup) -> Motion:
        """Send road, pose and setup of the next drive; return the motion of the car."""
        message = {
            "road": {**entries_of(road), "points": road.road_points.tolist()},
            "pose": list(pose),
            "setup": asdict(setup),
        }
        return self._moved({"start": message})

    def step(self, steering: float, throttle: float, brake: float, seconds: float) -> Motion:
        """Send the controls of a step; return the motion of the car after it."""
        if self._hello.records == "binary":
            record = _STEP_FORM.pack(steering, throttle, brake, seconds)
            size = _MOTION_FORM.size
            answer = self._call(lambda: self._program.exchange(record, size))
            return Motion(*_MOTION_FORM.unpack(answer))
        controls = {"steering": steering, "throttle": throttle, "brake": brake, "seconds": seconds}
        return self._moved({"step": controls})

    def _moved(self, message: dict[str, Any]) -> Motion:
        """Return the motion with which the program answers a message."""
        answer = self._call(lambda: self._program.ask(message, MotionAnswer))
        missing = [name for name in Motion._fields if getattr(answer, name) is None]
        if missing:
            self._program.close()
            raise SimulatorProgramError(
                f"the simulator's program answered without {' and '.join(missing)} of the car"
            )
        return Motion(*(getattr(answer, name) for name in Motion._fields))

    def _call(self, call: Callable[[], T]) -> T:
        """Return what a call of the program returns; its errors become the simulator's."""
        try:
            return call()
        except ProgramError as error:
            raise SimulatorProgramError(f"the simulator's program {error}") from None

    def _greet(self) -> None:
        """Ask a new program for its car, and how it wants the messages of steps."""
        hello = {"hello": {"part": "simulator", "protocol": PROTOCOL}}
        self._hello = answer = self._program.ask(hello, SimulatorHello)
        self._car = CarBody(answer.length, answer.width, answer.centre_ahead)
        for name in (
            "front_axle",
            "rear_axle",
            "max_steering",
            "max_acceleration",
            "max_deceleration",
        ):
            setattr(self, name, getattr(answer, name))
