"""A driver that is a program in any language; docs/programs.md lists the messages."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, astuple
from struct import Struct
from typing import Any, ClassVar, Final, Literal, cast

import msgspec
import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, NotNegative, Positive, check
from frenetic._support.option_text import PROGRAM
from frenetic.drivers.builtin import SpeedPlan, SpeedPlanner
from frenetic.drivers.driver import AHEAD_POINTS, Controls, DriveSetup, Observation
from frenetic.drivers.half_drivers import LATERAL, acceleration_to, lane_keeper, speed_plan
from frenetic.errors import (
    ControlsError,
    DriverEndedError,
    DriverLateError,
    DriverReportError,
)
from frenetic.processes.programs import (
    Answer,
    AnswerError,
    Program,
    ProgramEnded,
    ProgramLate,
    ProgramReport,
    command_files,
    command_words,
)

PROTOCOL: Final = 1
"""Version of the messages."""
NUMBERS: Final = (
    "time",
    "speed",
    "yaw_rate",
    "steering",
    "lateral_offset",
    "heading_error",
    "distance",
    "x",
    "y",
    "heading",
    "lateral_speed",
    "speed_limit",
)
"""Attributes of an `Observation` that are one number, in the order of a binary record."""
_HEAD: Final = 2 + len(NUMBERS)  # numbers of a record before the points ahead
RECORD_NUMBERS: Final = _HEAD + 4 * AHEAD_POINTS
"""Numbers of a binary record, each 8 bytes."""
_RESET, _ACT = 0.0, 1.0
"""First number of a binary record: what it is."""
_HEAD_FORM: Final = Struct(f"<{_HEAD}d")
_CONTROLS_FORM: Final = Struct("<3d")


class DriverHello(Answer):
    """The answer of a driver's program to the first message."""

    records: Literal["json", "binary"] = "json"
    """Form of the messages that follow."""
    period: float | None = None
    """Time between two decisions, in s; None for the simulator's, usually 0.05."""
    steers: bool = True
    """Whether the program steers; otherwise the law of `Stanley` keeps the lane."""
    pedals: bool = True
    """Whether the program has the pedals; otherwise the car drives at the planned speed."""
    lateral: Positive | None = None
    """Lateral acceleration that the planned speed accepts in bends, in m/s^2; None for 4."""
    aggression: Positive | None = None
    """Factor of `lateral` and of the planned braking; None for 1."""

    def __post_init__(self) -> None:
        if not self.steers and not self.pedals:
            raise ValueError("a program that neither steers nor has the pedals drives nothing")
        if self.pedals and (self.lateral, self.aggression) != (None, None):
            raise ValueError('lateral and aggression need `"pedals": false`')


class WantedControls(Answer):
    """The answer to an observation: steering, and pedals, an acceleration or a speed."""

    steering: Finite | None = None
    """Wanted angle of the front wheels, in rad, positive to the left."""
    throttle: Finite | None = None
    """Throttle pedal, 0..1; values outside are cut."""
    brake: Finite | None = None
    """Brake pedal, 0..1; values outside are cut."""
    acceleration: Finite | None = None
    """Wanted acceleration, in m/s^2, in place of the pedals."""
    speed: NotNegative | None = None
    """Wanted speed, in m/s, in place of the pedals."""
    notes: dict[str, Finite] = msgspec.field(default_factory=dict)
    """Numbers that the program notes, for traces of drives."""
    plan: list[tuple[Finite, Finite]] | None = None
    """Points that it plans to drive through, in m in the car's frame, for traces."""

    def ways(self) -> int:
        """Return the number of ways in which the answer says how fast the car shall drive."""
        has_pedals = (self.throttle, self.brake) != (None, None)
        return has_pedals + (self.acceleration is not None) + (self.speed is not None)


class CommandDriver:
    """A program in any language that reads observations and writes controls.

    The program runs from the first drive on, for all drives, and is started again after it was
    lost. It runs in the current folder, without a shell.

    Args:
        program: the program with its arguments, split as a shell does.
        deadline: wall time that the program has for each answer, in s; a later one is a fault of
            the driver. For its first answer it has at least 60 s.
    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the messages' meaning; campaigns record it."""

    def __init__(self, program: str, *, deadline: Positive = 5.0) -> None:
        check({"deadline": deadline}, CommandDriver.__init__)
        self._command, self._deadline = program, deadline
        self._words = command_words(program)
        self._start()

    @property
    def options(self) -> dict[str, Any]:
        """Options with which the driver was made."""
        return {PROGRAM: self._command, "deadline": self._deadline}

    def __getstate__(self) -> dict[str, Any]:
        """Return the options: a copy in another process starts a program of its own."""
        return self.options

    def __setstate__(self, options: dict[str, Any]) -> None:
        self.__init__(**options)  # type: ignore[misc]  # as the pickled driver was made

    def _start(self) -> None:
        self._program = Program(self._words, self._deadline, self._greet)
        self._hello = DriverHello()
        self.trace_notes: Mapping[str, float] = {}
        """Numbers that the program noted at its last decision."""
        self.trace_plan: Sequence[tuple[float, float]] | None = None
        """Points of its plan then; None if it shows none."""
        self._record = np.full(RECORD_NUMBERS, np.nan)
        self._bytes = memoryview(self._record.data).cast("B")
        points = self._record[_HEAD:]
        self._ahead = points[: 2 * AHEAD_POINTS].reshape(-1, 2)
        self._curvature, self._limits = points[2 * AHEAD_POINTS :].reshape(2, -1)

    @property
    def version_files(self) -> tuple[str, ...]:
        """Files that belong to the driver's version: the program, and arguments that are files."""
        return command_files(self._words)

    @property
    def period(self) -> float | None:
        """Time between two decisions, in s, as the program asks; None for the simulator's."""
        with self._blaming():
            self._program.start()
        return self._hello.period

    def reset(self, setup: DriveSetup) -> None:
        """Send the setup of the next drive."""
        with self._blaming():
            self._program.start()
            if self._hello.records == "binary":
                self._record[:] = np.nan
                numbers = [math.nan if value is None else value for value in astuple(setup)]
                self._record[: 1 + len(numbers)] = [_RESET, *numbers]
                self._program.exchange(self._bytes, _CONTROLS_FORM.size)
            else:
                numbers_by_name = {name: _plain(value) for name, value in asdict(setup).items()}
                self._program.ask({"reset": numbers_by_name}, Answer)
        hello, self._setup = self._hello, setup
        self._keeper: SpeedPlanner | None = None if hello.steers else lane_keeper(setup)
        self._plan: SpeedPlan | None = None
        if not hello.pedals:
            self._plan = speed_plan(setup, hello.lateral or LATERAL, hello.aggression or 1.0)

    def act(self, observation: Observation) -> Controls:
        """Send an observation, and return the program's controls."""
        with self._blaming():
            hello = self._hello
            if hello.records == "binary":
                steering, throttle, brake = self._exchange(observation)
                if hello.steers and hello.pedals:
                    return Controls(steering, throttle, brake)
                answer = WantedControls(
                    steering=_unless_left_out(steering, hello.steers),
                    throttle=_unless_left_out(throttle, hello.pedals),
                    brake=_unless_left_out(brake, hello.pedals),
                )
            else:
                answer = self._program.ask({"act": as_message(observation)}, WantedControls)
                self.trace_notes, self.trace_plan = answer.notes, answer.plan
            return self._controls(answer, observation)

    def _controls(self, answer: WantedControls, observation: Observation) -> Controls:
        """Return controls from an answer, with the half that the program leaves to Frenetic."""
        self._check_halves(answer)
        if self._keeper is None:
            steering = cast(float, answer.steering)
        else:
            steering = self._keeper.act(observation).steering
        if self._plan is not None:
            return self._plan.controls(observation, steering)
        speed, acceleration = observation.speed, answer.acceleration
        if answer.speed is not None:
            acceleration = acceleration_to(answer.speed, speed)
        if acceleration is not None:
            return Controls.from_acceleration(
                acceleration, steering, speed=speed, setup=self._setup
            )
        return Controls(steering, answer.throttle or 0.0, answer.brake or 0.0)

    def _check_halves(self, answer: WantedControls) -> None:
        """Raise an error unless an answer has the half, or halves, that the greeting promises."""
        hello, ways = self._hello, answer.ways()
        text = ""
        if hello.steers and answer.steering is None:
            text = 'without steering; one that only chooses its speed greets with "steers": false'
        elif not hello.steers and answer.steering is not None:
            text = 'with steering, though it greeted with "steers": false'
        elif hello.pedals and ways == 0:
            text = (
                "without throttle, brake, acceleration or speed; one that only steers greets with"
                ' "pedals": false'
            )
        elif not hello.pedals and ways:
            text = 'with a speed or pedals, though it greeted with "pedals": false'
        elif ways > 1:
            text = "with more than one of pedals, acceleration and speed"
        if text:
            self._program.close()
            raise ControlsError(f"the driver's program answered an observation {text}")

    def _exchange(self, observation: Observation) -> tuple[float, float, float]:
        """Send an observation as a binary record, and return steering, throttle and brake."""
        ahead = observation.ahead
        n = len(ahead)
        _HEAD_FORM.pack_into(
            self._bytes,
            0,
            _ACT,
            observation.time,
            observation.speed,
            observation.yaw_rate,
            observation.steering,
            observation.lateral_offset,
            observation.heading_error,
            observation.distance,
            observation.x,
            observation.y,
            observation.heading,
            observation.lateral_speed,
            observation.speed_limit,
            n,
        )
        if n < AHEAD_POINTS:
            self._record[_HEAD:] = np.nan
        self._ahead[:n] = ahead
        self._curvature[:n] = observation.curvature_ahead
        limits = observation.speed_limit_ahead
        self._limits[: len(limits)] = limits
        answer = self._program.exchange(self._bytes, _CONTROLS_FORM.size)
        numbers: tuple[float, float, float] = _CONTROLS_FORM.unpack(answer)
        return numbers

    def _greet(self) -> None:
        """Ask a new program how it wants its messages."""
        message = {"hello": {"part": "driver", "protocol": PROTOCOL}}
        self._hello = self._program.ask(message, DriverHello)

    @contextmanager
    def _blaming(self) -> Iterator[None]:
        """Turn an error of the program into a `DriverError` of its kind."""
        try:
            yield
        except ProgramLate as error:
            raise DriverLateError(f"the driver's program {error}") from None
        except ProgramEnded as error:
            raise DriverEndedError(f"the driver's program {error}") from None
        except ProgramReport as error:
            raise DriverReportError(f"the driver's program {error}") from None
        except AnswerError as error:
            raise ControlsError(f"the driver's program {error}") from None


def _unless_left_out(number: float, is_wanted: bool) -> float | None:
    """Return a number of a binary answer; None for NaN in a half that is Frenetic's."""
    return number if is_wanted or not math.isnan(number) else None


def as_message(observation: Observation) -> dict[str, Any]:
    """Return an observation for JSON: numbers, lists of numbers, and None for infinity."""
    message: dict[str, Any] = {name: _plain(getattr(observation, name)) for name in NUMBERS}
    message["ahead"] = observation.ahead.tolist()
    message["curvature_ahead"] = observation.curvature_ahead.tolist()
    message["speed_limit_ahead"] = _finite_list(observation.speed_limit_ahead)
    return message


def _plain(value: float | None) -> float | None:
    """Return a number for JSON, which has no infinity."""
    return None if value is None or not math.isfinite(value) else float(value)


def _finite_list(values: FloatArray) -> list[float | None]:
    """Return numbers for JSON, which has no infinity."""
    numbers: list[float | None] = values.tolist()
    return numbers if np.isfinite(values).all() else [_plain(number) for number in numbers]
