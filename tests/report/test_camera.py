"""What a driver's camera saw, in a campaign's report."""

from __future__ import annotations

import base64
import io
import os
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from click.testing import CliRunner
from PIL import Image

from frenetic import (
    Budget,
    Campaign,
    CampaignStore,
    Driver,
    EmbeddedSimulator,
    Observation,
    Planner,
    RandomSearch,
)
from frenetic.campaign.record import Test
from frenetic.campaign.store import JSONValue
from frenetic.cli import cli
from frenetic.drivers import appearance
from frenetic.drivers.appearance import Foggy
from frenetic.drivers.loading import load_driver
from frenetic.drivers.neural.network import DAVE2, Network
from frenetic.report.html import campaign_report
from frenetic.report.html.camera import LARGEST, MOST_PICTURES, CameraData, DriverCamera
from frenetic.simulators.embedded.rendering import Renderer


def run(folder: Path, driver: Driver, simulations: int) -> None:
    Campaign(
        strategy=RandomSearch(seed=3),
        simulator=EmbeddedSimulator(),
        driver=driver,
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()


def camera_data(record: Test, config: Mapping[str, JSONValue]) -> CameraData | None:
    return DriverCamera(config, Path("nowhere")).saw(record)


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seen") / "campaign"
    driver = load_driver("marking-follower", fog=25.0, delay=0.1)
    run(folder, driver, 2)
    return folder


def picture(url: str) -> np.ndarray:
    kind, _, data = url.partition(",")
    assert kind == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).astype(float)


def test_a_report_shows_what_the_camera_saw_through_its_layers(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        report = campaign_report(store)
        record = store.test(report.drives[0].id)
    camera = report.drives[0].camera
    assert camera is not None
    assert len(camera.times) <= MOST_PICTURES
    assert camera.times[0] == 0.0
    assert list(camera.times) == sorted(set(camera.times))
    assert camera.looked_time in camera.times
    assert (camera.looked, camera.looked_note) == (None, "")  # marking-follower does not say it
    sheet = picture(camera.pictures)
    driver = load_driver("marking-follower", fog=25.0)
    assert isinstance(driver, appearance.Foggy)
    renderer = Renderer(record.road, driver.driver.camera)  # type: ignore[attr-defined]
    assert record.drive is not None
    path = record.drive.trajectory
    for k in (0, 9):
        i = int(np.argmin(np.abs(path.time - path.time[0] - camera.times[k])))
        drawn = renderer.draw(path.x[i], path.y[i], path.heading[i])
        v, u = divmod(k, camera.columns)
        part = sheet[v * camera.height :, u * camera.width :][: camera.height, : camera.width]
        seen = driver.seen(drawn, None).astype(float)  # type: ignore[arg-type]
        assert np.abs(part - seen).mean() < 4.0
        assert np.abs(part - drawn).mean() > 15.0  # the fog is there


def test_only_what_can_be_drawn_again_is_in_a_report(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        config, record = store.config, store.test(1)
    assert camera_data(record, config) is not None
    driver = config["driver"]
    assert isinstance(driver, dict)
    elsewhere = {"simulator": {"class": "mine:Simulator"}}
    assert camera_data(record, {**config, **elsewhere}) is None
    for damaged in ({"width": 1e9}, {"lens": 2}, None, {"pitch": "x"}):
        bad = {"class": "mine:Driver", "camera": damaged}
        assert camera_data(record, {**config, "driver": bad}) is None
    fog = {**driver["driver"], "options": {"visibility": -3.0}}
    assert camera_data(record, {**config, "driver": {**driver, "driver": fog}}) is None
    for seed in ("x", -1, 1.5):
        options: JSONValue = {"rate": 5.0, "seed": seed}
        rain = {**driver, "class": "frenetic.drivers.appearance:Rainy", "options": options}
        assert camera_data(record, {**config, "driver": rain}) is None


def test_large_pictures_are_shrunk(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        config, record = store.config, store.test(1)
    own: JSONValue = {"class": "mine:Driver", "camera": {"width": 400, "height": 100}}
    camera = camera_data(record, {**config, "driver": own})
    assert camera is not None
    assert (camera.width, camera.height) == (LARGEST, 80)


def test_a_driver_without_a_camera_has_no_pictures(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    run(folder, Planner(), 1)
    with CampaignStore.open(folder) as store:
        assert [drive.camera for drive in campaign_report(store).drives] == [None]


def test_a_network_says_where_it_looked_while_it_is_the_same(tmp_path: Path) -> None:
    options = ["--driver", "dave2", "--simulations", "1", "--seed", "1", "--workers", "1"]
    out = tmp_path / "network"
    assert CliRunner().invoke(cli, ["run", *options, "--out", str(out)]).exit_code == 0
    with CampaignStore.open(out) as store:
        config, record = store.config, store.test(1)
    camera = camera_data(record, config)
    assert camera is not None
    assert camera.looked is not None
    looked = picture(camera.looked)
    assert looked.shape == (camera.height, camera.width, 3)
    assert (looked[..., 0] - looked[..., 2]).max() > 100.0  # red somewhere
    driver = config["driver"]
    assert isinstance(driver, dict)
    foreign: JSONValue = {**driver, "class": "frenetic.drivers.neural.network:read_model"}
    unasked = camera_data(record, {**config, "driver": foreign})
    assert unasked is not None
    assert unasked.looked is None
    changed: JSONValue = {**driver, "fingerprint": {"digest": "another", "version": "version 0"}}
    unlike = camera_data(record, {**config, "driver": changed})
    assert unlike is not None
    assert unlike.looked is None
    assert "onnxruntime" in unlike.looked_note
    assert unlike.looked_note.endswith("it was version 0")


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A campaign of a network, and its file, named from the folder that both lie in."""
    folder = tmp_path_factory.mktemp("own")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        Path("models").mkdir()
        Path("models", "MODEL.ONNX").write_bytes(DAVE2.read_bytes())
        driver = Network(str(Path("models", "MODEL.ONNX")), max_speed=40.0, crop=(0, 0))
        run(Path("runs", "own"), Foggy(driver, 80.0), 2)
    return folder / "runs" / "own", folder / "models" / "MODEL.ONNX"


def seen_by(folder: Path, options: dict[str, JSONValue] | None = None) -> CameraData:
    """What the network's camera saw in test 1, with other options of the network in the record."""
    with CampaignStore.open(folder) as store:
        config, record = dict(store.config), store.test(1)
    layer: JSONValue = config["driver"]
    assert isinstance(layer, dict)
    network = layer["driver"]
    assert isinstance(network, dict)
    assert isinstance(network["options"], dict)
    network = {**network, "options": network["options"] | (options or {})}
    config["driver"] = {**layer, "driver": network}
    camera = DriverCamera(config, folder).saw(record)
    assert camera is not None
    return camera


def test_a_network_of_your_own_says_where_it_looked(
    own: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, model = own
    monkeypatch.chdir(tmp_path)  # its path counts from elsewhere
    camera = seen_by(folder)
    assert camera.looked is not None
    assert camera.looked_note == ""
    content = model.read_bytes()
    model.write_bytes(b"another")
    try:
        camera = seen_by(folder)
    finally:
        model.write_bytes(content)
    assert camera.looked is None
    assert camera.looked_note == f"{Path('models', 'MODEL.ONNX')} as it was then is not here"


def test_a_report_opens_no_file_but_the_recorded_model(
    own: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[object] = []
    monkeypatch.setattr("frenetic.drivers.neural.network.read_model", opened.append)
    monkeypatch.setattr("frenetic.report.html.camera.digest_of_file", opened.append)
    large = tmp_path / "MODEL.ONNX"
    with large.open("wb") as file:
        file.truncate(600_000_000)
    secret = tmp_path / "secret"
    secret.write_text("mine")
    named: list[JSONValue] = [str(large), str(secret), str(tmp_path), "\0", "~nobody/MODEL.ONNX"]
    if hasattr(os, "mkfifo"):
        queue = tmp_path / "queue" / "MODEL.ONNX"
        queue.parent.mkdir()
        os.mkfifo(queue)
        named.append(str(queue))
    for path in named:
        camera = seen_by(own[0], {"model": path})
        assert camera.looked is None
        assert camera.looked_note.endswith("is not here")
    assert opened == []
    seen_by(own[0], {"model": str(own[1])})
    assert opened == [own[1]]


def test_a_page_takes_limited_time_to_find_out_where_a_network_looked(
    own: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = Network.saliency

    def slow(
        network: Network, seen: Observation, limit: float | None = None
    ) -> npt.NDArray[np.float32]:
        assert limit is not None
        time.sleep(limit)
        return usual(network, seen)

    monkeypatch.setattr(Network, "saliency", slow)
    monkeypatch.setattr("frenetic.report.html.camera.LOOKING", 0.1)
    with CampaignStore.open(own[0]) as store:
        camera = DriverCamera(store.config, own[0])
        first, second = (camera.saw(store.test(i)) for i in (1, 2))
    assert first is not None
    assert second is not None
    assert first.looked is not None
    assert second.looked is None
    assert second.looked_note == "the 0.1 s that a page takes to find it out are over"
