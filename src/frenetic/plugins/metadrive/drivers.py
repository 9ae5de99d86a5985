"""MetaDrive's own drivers as systems under test.

In MetaDrive they look at MetaDrive's world instead of an `Observation`: `MetaDriveSimulator`
recognises them and lets MetaDrive's policies act (`frenetic.plugins.metadrive.policies`). The
drivers that are networks also drive in other simulators, because an `Observation` has all that they
see on an empty road (`frenetic.plugins.metadrive.expert`).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar, NoReturn

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Positive, check
from frenetic._support.onnx_model import OnnxModel, read_model, shown_shape
from frenetic.drivers import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.stack import unwrapped
from frenetic.errors import DriverError
from frenetic.plugins.metadrive.car import VEHICLE, Decision
from frenetic.plugins.metadrive.expert import (
    ACTION_SIZES,
    SIZE,
    expert_action,
    mean_action,
    read_weights,
    state_of,
    weights,
)
from frenetic.simulators.simulator import Simulator


class PolicySimulator:
    """Base of a simulator that knows MetaDrive's drivers and lets MetaDrive's policies act."""


class MetaDriveDriver:
    """Base of MetaDrive's drivers, which can drive in MetaDrive only."""

    name: ClassVar[str]
    """Name in the registry."""
    BEHAVIOUR: ClassVar[int] = 1
    """Version of the driver's controls: to be increased when they change; campaigns record it."""
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("metadrive-simulator",)
    """Distributions on whose versions the controls depend, too."""

    def check_simulator(self, simulator: Simulator) -> None:
        """Refuse simulators that do not know MetaDrive's drivers.

        Raises:
            DriverError: the simulator does not know them.
        """
        if not isinstance(simulator, PolicySimulator):
            self._refuse()

    def reset(self, setup: DriveSetup) -> None:  # noqa: ARG002 - asked by a foreign simulator
        """Refuse, as `act` does.

        Raises:
            DriverError: always.
        """
        self._refuse()

    def act(self, observation: Observation) -> Controls:  # noqa: ARG002
        """Refuse, because a simulator that asks for controls is not MetaDrive.

        Raises:
            DriverError: always.
        """
        self._refuse()

    def _refuse(self) -> NoReturn:
        """Raise the `DriverError` that says where the driver can drive."""
        raise DriverError(f"{self.name} drives in MetaDrive only: choose the simulator metadrive")


class MetaDriveIdm(MetaDriveDriver):
    """MetaDrive's rule-based driver: PID steering to the lane's centre, constant target speed.

    It does not slow down for curves, so its target speed decides which roads it can take.

    Args:
        target_speed: Target speed in km/h, as far as the speed limit allows it; MetaDrive's traffic
            has 30.
    """

    name = "metadrive-idm"

    def __init__(self, *, target_speed: Positive = 30.0) -> None:
        check(locals(), MetaDriveIdm.__init__)
        self.target_speed = float(target_speed)

    @property
    def options(self) -> dict[str, float]:
        """Options of the driver."""
        return {"target_speed": self.target_speed}


class ObservingDriver(MetaDriveDriver, ABC):
    """Base of drivers that act by MetaDrive's observation.

    In another simulator such a driver asks the car for the steering angle and the acceleration that
    MetaDrive's car would have.
    """

    period: ClassVar[float] = 0.1
    """Time between two decisions in s, as in MetaDrive."""

    @abstractmethod
    def mean_action(self, state: FloatArray) -> tuple[float, float]:
        """Return steering, positive to the left, and throttle or brake, not cut to -1..1.

        Args:
            state: (275,) observation, as MetaDrive's `LidarStateObservation` returns it.
        """

    def check_simulator(self, simulator: Simulator) -> None:
        """Accept every simulator."""

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive."""
        self._setup, self._action, self._heading = setup, (0.0, 0.0), math.nan

    def act(self, observation: Observation) -> Controls:
        """Return the mean action as controls of this car."""
        turned = observation.heading - self._heading  # NaN at the first decision
        turned = 0.0 if math.isnan(turned) else turned
        state = state_of(observation, self._setup, self._action, turned)
        steering, pedal = (min(max(value, -1.0), 1.0) for value in self.mean_action(state))
        self._action, self._heading = (steering, pedal), observation.heading
        decision = Decision.of_action(steering, pedal)
        acceleration = (
            decision.throttle * VEHICLE.engine_acceleration
            - decision.brake * VEHICLE.brake_deceleration
        )
        return Controls.from_acceleration(
            acceleration, decision.steering, speed=observation.speed, setup=self._setup
        )


class MetaDriveExpert(ObservingDriver):
    """The neural network that comes with MetaDrive, trained there by PPO."""

    name = "metadrive-expert"

    def reset(self, setup: DriveSetup) -> None:
        """Forget the last drive.

        Raises:
            FreneticError: MetaDrive is not installed.
        """
        weights()
        super().reset(setup)

    def mean_action(self, state: FloatArray) -> tuple[float, float]:
        """See `ObservingDriver`."""
        return expert_action(state)


class MetaDrivePolicy(ObservingDriver):
    """The user's own policy, which was trained with MetaDrive's observation.

    Args:
        weights: Path of a ``.npz`` file with the layout of the expert's file, of which nothing is
            executed, or of an ``.onnx`` file of a network from (1, 275) numbers to 2.

    Raises:
        FreneticError: The file is an ``.onnx`` file, and onnxruntime is not installed.
        ValueError: The file holds no such network, or the network's outputs are not finite.
    """

    name = "metadrive-policy"
    BEHAVIOUR_PACKAGES: ClassVar[tuple[str, ...]] = ("onnxruntime",)

    def __init__(self, *, weights: str) -> None:
        self._path = str(weights)
        self._data = read_model(self._path)
        self._load()

    @property
    def options(self) -> dict[str, str]:
        """Options of the driver: the path of its file."""
        return {"weights": self._path}

    def __getstate__(self) -> dict[str, Any]:
        """Return path and content of the file, which another machine may lack."""
        return {name: getattr(self, name) for name in ("_path", "_data")}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        self.__dict__.update(state)
        self._load()

    def _load(self) -> None:
        """Make the network from the file's content, and try it.

        Raises:
            ValueError: it is no network for MetaDrive's observation, or its outputs are not finite.
        """
        self._network: OnnxModel | Mapping[str, FloatArray]
        if self._path.endswith(".onnx"):
            self._network = model = OnnxModel(self._data)
            shapes = [shown_shape(shape) for shape in model.inputs.values()]
            if len(shapes) != 1 or shapes[0] not in (f"(1, {SIZE})", f"(any, {SIZE})"):
                shown = " and ".join(shapes)
                raise ValueError(f"it takes {shown}: (1, {SIZE}) alone is needed")
        else:
            self._network = read_weights(self._data)
        self._outputs(np.zeros(SIZE, dtype=np.float32))

    def mean_action(self, state: FloatArray) -> tuple[float, float]:
        """See `ObservingDriver`.

        Raises:
            DriverError: the network's outputs are not finite.
        """
        try:
            return self._outputs(state)
        except ValueError as error:
            raise DriverError(f"{self._path}: {error}") from None

    def _outputs(self, state: FloatArray) -> tuple[float, float]:
        """Return the network's mean action.

        Raises:
            ValueError: the outputs are not finite, or neither 2 nor 4.
        """
        if isinstance(self._network, OnnxModel):
            (name,) = self._network.inputs
            outputs = self._network.run({name: state.astype(np.float32)[np.newaxis]})
            action = np.concatenate([output.ravel() for output in outputs.values()])
        else:
            with np.errstate(over="ignore", invalid="ignore"):
                action = np.array(mean_action(state, self._network))
        if action.size not in ACTION_SIZES:
            raise ValueError(f"it gives {action.size} numbers: 2, steering and pedal, are needed")
        if not np.isfinite(action).all():
            raise ValueError(f"it gives {action[~np.isfinite(action)][0]}")
        return float(action[0]), float(action[1])


def metadrive_driver(driver: Driver) -> MetaDriveDriver | None:
    """Return the driver if it is one of MetaDrive's own, otherwise None.

    Raises:
        DriverError: the driver is one of MetaDrive's own under wrappers, which it would ignore.
    """
    inner = unwrapped(driver)
    if not isinstance(inner, MetaDriveDriver):
        return None
    if inner is not driver:
        raise DriverError(
            f"{inner.name} looks at MetaDrive's own world, where noise, delay, view, and errors of"
            " sensors and steering do not reach it: leave them out, or take them away from a"
            " campaign's drives, as with noise=0 or view=inf"
        )
    return inner
