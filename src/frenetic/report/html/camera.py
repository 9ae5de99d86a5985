"""What a driver's camera saw, drawn again from the stored drive: nothing of it is stored."""

from __future__ import annotations

import base64
import io
import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image as Pictures

from frenetic._support.arrays import evenly
from frenetic.campaign.record import Test
from frenetic.campaign.store import JSONValue
from frenetic.drivers import appearance
from frenetic.drivers.camera import Camera, Image
from frenetic.drivers.driver import Controls, Driver, DriveSetup, Observation
from frenetic.drivers.neural.model import check_file
from frenetic.drivers.neural.network import Dave2, Network
from frenetic.errors import FreneticError
from frenetic.fingerprint import differences, digest_of_file, innermost, over_each_other
from frenetic.simulators.drive import Trajectory
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.embedded.rendering import Renderer
from frenetic.spec import describe

MOST_PICTURES: Final = 48
"""Pictures of a drive, at most."""
COLUMNS: Final = 8
"""Pictures beside each other."""
LARGEST: Final = 320
"""Width of the widest picture; larger ones are shrunk."""
PICTURES_SIZE: Final = 3_000_000
"""Approximate bytes of all pictures of a page."""
LOOKING: Final = 60.0
"""Time that a page takes to find out where a network looked, in s."""

_QUALITY = 70  # of JPEG
_LONGEST = 300  # characters of a reason
_SALIENT: Final[Mapping[str, type[Network]]] = {
    f"{kind.__module__}:{kind.__qualname__}": kind for kind in (Dave2, Network)
}
"""Class in a record -> driver that says where it looked."""
_HEAT = np.array([255.0, 40.0, 0.0])


@dataclass(frozen=True)
class CameraData:
    """What the camera saw in a drive."""

    pictures: str
    """All pictures as one image, `COLUMNS` beside each other, as a data URL."""
    columns: int
    width: int
    """Width of one of them."""
    height: int
    times: tuple[float, ...]
    """Time of each since the drive's start, in s."""
    looked: str | None
    """The picture of the moment that matters, red where the driver looked, as a data URL."""
    looked_time: float
    """Its time, in s."""
    looked_note: str
    """Why a network's `looked` is missing; empty for other drivers."""

    @property
    def size(self) -> int:
        """Approximate bytes of its JSON."""
        return len(self.pictures) + len(self.looked or self.looked_note) + 8 * len(self.times)


class DriverCamera:
    """The camera of a campaign's driver, whose pictures are drawn again for one page.

    Args:
        config: of the campaign.
        folder: of the campaign.
    """

    def __init__(self, config: Mapping[str, JSONValue], folder: Path) -> None:
        self._config = config
        self._gaze = _Gaze(innermost(config.get("driver")), folder)

    def saw(self, record: Test) -> CameraData | None:
        """What it saw in a test.

        None for a driver without a camera, in another simulator than the embedded one, or if the
        campaign's record does not say what camera it was.

        Args:
            record: of the test, with its trajectory.
        """
        eye = _eye(self._config)
        if eye is None or record.drive is None or len(record.drive.trajectory) < 2:
            return None
        path, road = record.drive.trajectory, record.road
        renderer = Renderer(road, eye.camera, appearance.scene_of(eye.layered))
        critical = _critical(record, path)
        taken = evenly(len(path), MOST_PICTURES)
        taken = np.unique(np.append(taken[: MOST_PICTURES - 1], critical))
        pictures = [eye.seen(renderer, path, int(i)) for i in taken]
        small = [_shrunk(one) for one in pictures]
        height, width, _ = small[0].shape
        rows = math.ceil(len(small) / COLUMNS)
        sheet = np.zeros((rows * height, COLUMNS * width, 3), dtype=np.uint8)
        for k, one in enumerate(small):
            v, u = divmod(k, COLUMNS)
            sheet[v * height : (v + 1) * height, u * width : (u + 1) * width] = one
        shown = pictures[int(np.searchsorted(taken, critical))]
        looked, note = self._gaze.over(shown, observation_at(path, critical, shown), eye.camera)
        start = float(path.time[0])
        return CameraData(
            pictures=_data_url(sheet),
            columns=COLUMNS,
            width=width,
            height=height,
            times=tuple(round(float(path.time[i]) - start, 2) for i in taken),
            looked=None if looked is None else _data_url(_shrunk(looked)),
            looked_time=round(float(path.time[critical]) - start, 2),
            looked_note=note,
        )


class _Eye:
    """A driver that only looks, under the layers of another one."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.layered: Driver = self
        self.image: Image | None = None

    def reset(self, setup: DriveSetup) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> Controls:
        """Keeps the picture."""
        self.image = observation.image
        return Controls(0.0)

    def seen(self, renderer: Renderer, path: Trajectory, i: int) -> Image:
        """The picture at a record of a drive."""
        picture = renderer.draw(float(path.x[i]), float(path.y[i]), float(path.heading[i]))
        self.layered.act(observation_at(path, i, picture))
        assert self.image is not None
        return self.image


def observation_at(path: Trajectory, i: int, image: Image) -> Observation:
    """The picture and the car's own motion at a record; the road is not looked at again."""
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
    """The camera and the layers of a campaign's record."""
    simulator: Any = config.get("simulator")
    embedded = f"{EmbeddedSimulator.__module__}:{EmbeddedSimulator.__qualname__}"
    if not isinstance(simulator, Mapping) or simulator.get("class") != embedded:
        return None
    *layers, own = over_each_other(config.get("driver"))
    camera: Any = own.get("camera")
    if not isinstance(camera, Mapping):
        return None
    kinds = {f"{kind.__module__}:{kind.__qualname__}": kind for kind in appearance.ALL.values()}
    try:
        eye = _Eye(Camera(**camera))
        for layer in reversed(layers):
            kind = kinds.get(str(layer.get("class")))
            if kind is not None:
                options = dict(layer.get("options", {}))
                amount = options.pop(kind.name)
                eye.layered = kind(eye.layered, amount, **options)
    except (LookupError, TypeError, ValueError):  # a damaged record
        return None
    return eye


def _critical(record: Test, path: Trajectory) -> int:
    """Record of the moment that matters: of the departure, or of the worst place, or the last."""
    if record.departure is not None:
        return min(int(np.searchsorted(path.time, record.departure.time)), len(path) - 1)
    if record.result.moobd_distance is not None:
        along = record.road.track(np.column_stack([path.x, path.y]))[:, 0]
        return int(np.argmin(np.abs(along - record.result.moobd_distance)))
    return len(path) - 1


class _Gaze:
    """Where a campaign's network looked, as long as there is time for it.

    A record names any class and file, so only those of `_SALIENT` are asked, and no file is loaded
    but the recorded one: a page runs no other code.

    Args:
        recorded: the driver in the campaign's record, without layers.
        folder: of the campaign.
    """

    def __init__(self, recorded: Mapping[str, Any], folder: Path) -> None:
        self._recorded, self._folder = recorded, folder
        self._left = LOOKING
        self._network: Network | None = None
        self._note = ""

    def over(self, image: Image, seen: Observation, camera: Camera) -> tuple[Image | None, str]:
        """The image, red where the network looked, or why there is none.

        Both are empty for a driver that does not say where it looks.
        """
        if str(self._recorded.get("class")) not in _SALIENT:
            return None, ""
        started, weights, note = time.monotonic(), None, self._note
        if not note and self._left > 0.0:
            try:
                weights = self._asked(camera).saliency(seen, self._left)
            except (FreneticError, TypeError, ValueError) as error:
                note = str(error)[:_LONGEST]
                self._note = note if self._network is None else ""
        self._left -= time.monotonic() - started
        if weights is None:
            if not self._note and self._left <= 0.0:
                note = f"the {LOOKING:g} s that a page takes to find it out are over"
            return None, note
        share = 0.65 * np.clip(weights, 0.0, 1.0)[..., None]
        heated: Image = (image * (1.0 - share) + share * _HEAT).astype(np.uint8)
        return heated, ""

    def _asked(self, camera: Camera) -> Network:
        """The network of the record.

        Raises:
            FreneticError, TypeError, ValueError: it has changed since, is not here, or the record
                is damaged.
        """
        if self._network is None:
            recorded = self._recorded
            kind, options = _SALIENT[recorded["class"]], dict(recorded.get("options", {}))
            if "model" in options:
                options["model"] = str(_recorded_model(recorded, self._folder))
            network = kind(**options)
            before, now = recorded.get("fingerprint"), describe(network)["fingerprint"]
            if before != now:
                changed = differences("the network", before, now).changed
                raise FreneticError("; ".join(changed) or "the network has changed since")
            if getattr(network, "camera", None) != camera:
                raise FreneticError("the network has another camera")
            self._network = network
        return self._network


def _recorded_model(recorded: Mapping[str, Any], folder: Path) -> Path:
    """The file of a record's model, with the content of then.

    Raises:
        FreneticError: it is not here.
    """
    given, fingerprint = str(recorded["options"]["model"]), recorded.get("fingerprint")
    files = fingerprint.get("files") if isinstance(fingerprint, Mapping) else None
    for place in _places(given, folder):
        digest = files.get(f"model ({place.name})") if isinstance(files, Mapping) else None
        try:
            check_file(place)
            if digest is not None and digest_of_file(place) == digest:
                return place
        except (OSError, ValueError):  # it is something else, or not there
            continue
    raise FreneticError(f"{given} as it was then is not here")


def _places(given: str, folder: Path) -> Iterator[Path]:
    """Where a file of a record may lie: as it was given, or so seen from the campaign's folder.

    A relative path counts from the folder that the campaign was made in, mostly one above its own.
    """
    folder = folder.resolve()
    try:
        place = Path(given).expanduser()
    except RuntimeError:  # nobody's home
        return
    # Asking for a file on another computer of Windows tells it who asks.
    if not place.drive.startswith("\\\\") or place.drive == folder.drive:
        yield place
    if not (place.is_absolute() or place.anchor):
        yield from (above / place for above in (folder, *folder.parents))


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
