"""The embedded car of a drive with a driver in Python, and the renderer of its camera."""

from __future__ import annotations

from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.entry_points import imported, installed
from frenetic.drivers.camera import RENDERERS, Camera, Image, Renderer, Scene
from frenetic.errors import DriverError
from frenetic.road import Road
from frenetic.simulators.embedded import rollout as kernels
from frenetic.simulators.embedded.single_track import (
    ASKED,
    BRAKE,
    HEADING,
    INPUT_SIZE,
    THROTTLE,
    X,
    Y,
    advance,
)

_ONLY_CAR: Final = np.zeros(1, np.int64)
"""Number of the car in its array of states."""


class EmbeddedCar:
    """A `MovedCar`: the car of one drive with a driver in Python.

    Args:
        state: (7,) state at the start, which changes as the car moves.
        parameters: `Vehicle.to_array()`.
        weather: see `frenetic.simulators.embedded.weather`; None without.
        road: Road under the car.
        renderer: Renderer of the driver's camera; None without a camera.
    """

    def __init__(
        self,
        state: FloatArray,
        parameters: FloatArray,
        weather: FloatArray | None,
        road: Road,
        renderer: Renderer | None,
    ) -> None:
        self._state, self._states = state, state[np.newaxis]
        slopes = road.slopes if len(road.slopes) else None
        self._ground = parameters, road.table, road.sub_step, slopes, weather
        self._is_plain = slopes is None and weather is None
        self._s = 0.0  # distance along the road before the last step, on slopes and in weather
        self._inputs = np.empty((1, INPUT_SIZE))
        self._grounds = parameters[np.newaxis].copy()
        self._renderer = renderer

    def motion(self) -> list[float]:
        """Return the state, in the order of the columns of a `Trajectory`."""
        values: list[float] = self._state.tolist()
        return values

    def picture(self) -> Image | None:
        """Return what the camera sees; None without a camera."""
        state = self._state
        if self._renderer is None:
            return None
        return self._renderer.draw(state[X], state[Y], state[HEADING])

    def advance(self, steering: float, throttle: float, brake: float, seconds: float) -> None:
        """Move the car for some seconds, a multiple of the integration step."""
        if not self._is_plain:
            ground, self._s = kernels.ground_under(*self._ground, self._state, self._s, seconds)
            self._grounds[0] = ground
        inputs = self._inputs  # a value at a time: numpy is slow to make an array of a tuple
        inputs[0, ASKED], inputs[0, THROTTLE], inputs[0, BRAKE] = steering, throttle, brake
        steps = round(seconds / kernels.STEP)
        advance(self._states, self._inputs, self._grounds, _ONLY_CAR, kernels.STEP, steps)


def new_renderer(road: Road, camera: Camera, scene: Scene) -> Renderer:
    """Return a renderer for a camera, made by the first installed entry point.

    Raises:
        DriverError: No renderer is installed.
    """
    entry = next(iter(installed(RENDERERS)), None)
    if entry is None:
        raise DriverError(
            f"the driver has a camera, and nothing is installed that draws for it ({RENDERERS})"
        )
    renderer: Renderer = imported(entry.target)(road, camera, scene)
    return renderer
