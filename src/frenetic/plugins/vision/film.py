"""What a driver's camera saw, drawn again from the stored drive: nothing of it is stored."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from PIL import Image as Pictures

from frenetic._support.arrays import evenly
from frenetic._support.json_value import JSONValue
from frenetic.campaign.record import Test
from frenetic.conditions.condition import SEED
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation, scene_of
from frenetic.drivers.loading import under
from frenetic.oracle.drive import Trajectory
from frenetic.parts.versions import over_each_other
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.rendering import CameraRenderer
from frenetic.report.html.tests import Film
from frenetic.simulators.embedded import EmbeddedSimulator

MOST_PICTURES: Final = 48
"""Pictures of a drive, at most."""
COLUMNS: Final = 8
"""Pictures beside each other."""
LARGEST: Final = 320
"""Width of the widest picture; larger ones are shrunk."""
_QUALITY = 70  # of JPEG


def camera_film(config: Mapping[str, JSONValue]) -> Callable[[Test], Film | None]:
    """Return what the camera of a campaign's driver saw in a test, drawn again.

    None for a driver without a camera, in another simulator than the embedded one, or if the
    campaign's record does not say what camera it was. A test is read with its trajectory.
    """
    eye = _eye(config)

    def saw(record: Test) -> Film | None:
        if eye is None or record.drive is None or len(record.drive.trajectory) < 2:
            return None
        path, road = record.drive.trajectory, record.road
        wrapped = _in_conditions(eye, record)
        renderer = CameraRenderer(road, eye.camera, scene_of(wrapped))
        critical = _critical(record, path)
        taken = evenly(len(path), MOST_PICTURES)
        taken = np.unique(np.append(taken[: MOST_PICTURES - 1], critical))
        small = [_shrunk(eye.picture(wrapped, renderer, path, int(i))) for i in taken]
        height, width, _ = small[0].shape
        rows = math.ceil(len(small) / COLUMNS)
        sheet = np.zeros((rows * height, COLUMNS * width, 3), dtype=np.uint8)
        for k, image in enumerate(small):
            v, u = divmod(k, COLUMNS)
            sheet[v * height : (v + 1) * height, u * width : (u + 1) * width] = image
        start = float(path.time[0])
        return Film(
            pictures=_data_url(sheet),
            columns=COLUMNS,
            width=width,
            height=height,
            times=tuple(round(float(path.time[i]) - start, 2) for i in taken),
            caption="What the camera sees, drawn again",
        )

    return saw


class _Eye:
    """A driver that only looks, under the wrappers of another one."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.wrapped: Driver = self
        self.image: Image | None = None

    def reset(self, setup: DriveSetup) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> Controls:
        """Keep the picture."""
        self.image = observation.image
        return Controls(0.0)

    def picture(self, wrapped: Driver, renderer: CameraRenderer, path: Trajectory, i: int) -> Image:
        """Return the picture at a record of a drive, under wrappers."""
        picture = renderer.draw(float(path.x[i]), float(path.y[i]), float(path.heading[i]))
        wrapped.act(observation_at(path, i, picture))
        assert self.image is not None
        return self.image


def observation_at(path: Trajectory, i: int, image: Image) -> Observation:
    """Return the picture and the car's own motion at a record; the road is not looked at again."""
    return Observation(
        time=float(path.time[i]),
        speed=float(path.speed[i]),
        yaw_rate=float(path.yaw_rate[i]),
        steering=float(path.steering[i]),
        lateral_offset=0.0,
        heading_error=0.0,
        ahead=np.zeros((1, 2)),
        curvature_ahead=np.zeros(1),
        image=image,
    )


def _eye(config: Mapping[str, JSONValue]) -> _Eye | None:
    """Return the camera and the wrappers of a campaign's record."""
    simulator: Any = config.get("simulator")
    embedded = f"{EmbeddedSimulator.__module__}:{EmbeddedSimulator.__qualname__}"
    if not isinstance(simulator, Mapping) or simulator.get("class") != embedded:
        return None
    *wrappers, innermost = over_each_other(config.get("driver"))
    camera: Any = innermost.get("camera")
    if not isinstance(camera, Mapping):
        return None
    kinds = {f"{kind.__module__}:{kind.__qualname__}": kind for kind in appearance.ALL.values()}
    eye = _Eye(Camera(**camera))
    for wrapper in reversed(wrappers):
        kind = kinds.get(str(wrapper.get("class")))
        if kind is not None:
            options = dict(wrapper.get("options", {}))
            amount = options.pop(kind.amount_name)
            eye.wrapped = kind(eye.wrapped, amount, **options)
    return eye


def _in_conditions(eye: _Eye, record: Test) -> Driver:
    """Return the wrapped eye in the conditions of a test, as far as the camera sees these."""
    conditions_of_drive = record.candidate.conditions
    conditions = (
        conditions_of_drive
        if record.setting is None
        else record.setting.conditions_of(conditions_of_drive)
    )
    visible = {n: amount for n, amount in conditions.items() if n == SEED or n in appearance.ALL}
    return under(visible, eye.wrapped)


def _critical(record: Test, path: Trajectory) -> int:
    """Record of the moment that matters: of the departure, or of the worst place, or the last."""
    if record.departure is not None:
        return min(int(np.searchsorted(path.time, record.departure.time)), len(path) - 1)
    if record.result.moobd_distance is not None:
        along = record.road.track(np.column_stack([path.x, path.y]))[:, 0]
        return int(np.argmin(np.abs(along - record.result.moobd_distance)))
    return len(path) - 1


def _shrunk(image: Image) -> Image:
    height, width, _ = image.shape
    if width <= LARGEST:
        return image
    size = (LARGEST, max(round(height * LARGEST / width), 1))
    return np.asarray(Pictures.fromarray(image).resize(size, Pictures.Resampling.BOX))


def _data_url(image: Image) -> str:
    file = io.BytesIO()
    Pictures.fromarray(image).save(file, "JPEG", quality=_QUALITY, optimize=True)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode()
