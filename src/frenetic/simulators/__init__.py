"""Simulators, which move the car: the Simulator protocol and its implementations."""

from frenetic.oracle.drive import CarBody, Drive, Rules, Trajectory
from frenetic.simulators.command import CommandSimulator
from frenetic.simulators.embedded import EmbeddedSimulator, Vehicle
from frenetic.simulators.observer import Observer
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.stepped import Motion, SteppedSimulator

__all__ = [
    "CarBody",
    "CommandSimulator",
    "Drive",
    "EmbeddedSimulator",
    "Motion",
    "Observer",
    "Rules",
    "Simulator",
    "SteppedSimulator",
    "Trajectory",
    "Vehicle",
]
