"""Film of a drive for the report: the pictures of the driver's camera.

A campaign stores no pictures, so they are drawn again from the stored trajectory.
"""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from PIL import Image as Pictures

from frenetic._support.arrays import evenly
from frenetic._support.json_value import JSONValue
from frenetic.campaign.record import Test
from frenetic.conditions.condition import SEED
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.loading import with_wrappers
from frenetic.drivers.stack import scene_of
from frenetic.oracle.drive import Trajectory
from frenetic.parts.records import over_each_other
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.rendering import CameraRenderer
from frenetic.report.html.tests import Film
from frenetic.simulators.embedded import EmbeddedSimulator

# Our choice.
MOST_PICTURES: Final = 48
"""Largest number of pictures of a drive."""
COLUMNS: Final = 8
"""Number of pictures beside each other in a film's sheet."""
LARGEST: Final = 320
"""Largest width of a picture, in pixels; wider ones are shrunk."""
_JPEG_QUALITY = 70  # of 100


def camera_film(config: Mapping[str, JSONValue]) -> Callable[[Test], Film | None]:
    """Return a function that returns the film of a test, read with its trajectory.

    The function returns None if the driver has no camera, if another simulator than the embedded
    one drove, or if the campaign's record does not describe the camera.

    Args:
        config: the campaign's record.
    """
    witness = _witness_of(config)

    def film_of(test: Test) -> Film | None:
        if witness is None or test.drive is None or len(test.drive.trajectory) < 2:
            return None
        trajectory = test.drive.trajectory
        driver = _in_conditions(witness, test)
        renderer = CameraRenderer(test.road, witness.camera, scene_of(driver))
        records = evenly(len(trajectory), MOST_PICTURES)
        # The critical record is shown, too, without exceeding the number of pictures.
        records = np.unique(
            np.append(records[: MOST_PICTURES - 1], _critical_record(test, trajectory))
        )
        pictures = [_shrunk(witness.picture(driver, renderer, trajectory, int(i))) for i in records]
        height, width, _ = pictures[0].shape
        start = float(trajectory.time[0])
        return Film(
            pictures=_data_url(_sheet(pictures)),
            columns=COLUMNS,
            width=width,
            height=height,
            times=tuple(round(float(trajectory.time[i]) - start, 2) for i in records),
            caption="What the camera sees, drawn again",
        )

    return film_of


class _Witness:
    """A driver that only keeps the picture that it is shown.

    In place of a campaign's driver, under the same wrappers, it gets the pictures that the driver
    got.

    Args:
        camera: camera of the campaign's driver.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.wrapped: Driver = self
        """The witness under the campaign's wrappers."""
        self._image: Image | None = None

    def reset(self, setup: DriveSetup) -> None:
        """Do nothing: each picture replaces the one before."""

    def act(self, observation: Observation) -> Controls:
        """Keep the picture."""
        self._image = observation.image
        return Controls(0.0)

    def picture(
        self, driver: Driver, renderer: CameraRenderer, trajectory: Trajectory, i: int
    ) -> Image:
        """Return the picture at record ``i`` of a drive.

        Args:
            driver: the witness under all wrappers of the drive.
            renderer: renderer of the drive's road and scene.
            trajectory: trajectory of the drive.
            i: index of the record.
        """
        drawn = renderer.draw(
            float(trajectory.x[i]), float(trajectory.y[i]), float(trajectory.heading[i])
        )
        driver.act(_observation_at(trajectory, i, drawn))
        assert self._image is not None
        return self._image


def _observation_at(trajectory: Trajectory, i: int, image: Image) -> Observation:
    """Return an observation with a picture and the car's motion at record ``i`` of a drive.

    Wrappers of a camera need nothing else, so all about the lane is 0.
    """
    return Observation(
        time=float(trajectory.time[i]),
        speed=float(trajectory.speed[i]),
        yaw_rate=float(trajectory.yaw_rate[i]),
        steering=float(trajectory.steering[i]),
        lateral_offset=0.0,
        heading_error=0.0,
        ahead=np.zeros((1, 2)),
        curvature_ahead=np.zeros(1),
        image=image,
    )


def _witness_of(config: Mapping[str, JSONValue]) -> _Witness | None:
    """Return a witness in place of the driver of a campaign's record; None where there is no film.

    Of the wrappers over the driver, it gets the ones that change the picture.
    """
    simulator: Any = config.get("simulator")
    embedded = f"{EmbeddedSimulator.__module__}:{EmbeddedSimulator.__qualname__}"
    if not isinstance(simulator, Mapping) or simulator.get("class") != embedded:
        return None
    *wrappers, innermost = over_each_other(config.get("driver"))
    camera: Any = innermost.get("camera")
    if not isinstance(camera, Mapping):
        return None
    kinds = {f"{kind.__module__}:{kind.__qualname__}": kind for kind in appearance.ALL.values()}
    witness = _Witness(Camera(**camera))
    for wrapper in reversed(wrappers):
        kind = kinds.get(str(wrapper.get("class")))
        if kind is not None:
            options = dict(wrapper.get("options", {}))
            amount = options.pop(kind.amount_name)
            witness.wrapped = kind(witness.wrapped, amount, **options)
    return witness


def _in_conditions(witness: _Witness, test: Test) -> Driver:
    """Return the wrapped witness, also under the wrappers of the test's visible conditions."""
    conditions = test.candidate.conditions
    if test.setting is not None:
        conditions = test.setting.conditions_of(conditions)
    visible = {
        name: amount
        for name, amount in conditions.items()
        if name == SEED or name in appearance.ALL
    }
    return with_wrappers(witness.wrapped, visible)


def _critical_record(test: Test, trajectory: Trajectory) -> int:
    """Return the index of the record that a viewer wants to see.

    It is the record at the departure from the lane, else at the MOOBD, else the last.
    """
    last = len(trajectory) - 1
    if test.departure is not None:
        return min(int(np.searchsorted(trajectory.time, test.departure.time)), last)
    if test.result.moobd_distance is not None:
        along = test.road.track(np.column_stack([trajectory.x, trajectory.y]))[:, 0]
        return int(np.argmin(np.abs(along - test.result.moobd_distance)))
    return last


def _shrunk(image: Image) -> Image:
    """Return the picture, at most `LARGEST` pixels wide."""
    height, width, _ = image.shape
    if width <= LARGEST:
        return image
    size = (LARGEST, max(round(height * LARGEST / width), 1))
    return np.asarray(Pictures.fromarray(image).resize(size, Pictures.Resampling.BOX))


def _sheet(pictures: Sequence[Image]) -> Image:
    """Return pictures of one size as one image, row by row, `COLUMNS` beside each other."""
    height, width, _ = pictures[0].shape
    rows = math.ceil(len(pictures) / COLUMNS)
    sheet: Image = np.zeros((rows * height, COLUMNS * width, 3), dtype=np.uint8)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, COLUMNS)
        top, left = row * height, column * width
        sheet[top : top + height, left : left + width] = picture
    return sheet


def _data_url(image: Image) -> str:
    """Return the image as a data URL of a JPEG."""
    file = io.BytesIO()
    Pictures.fromarray(image).save(file, "JPEG", quality=_JPEG_QUALITY, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode()
