"""Pictures of a driver's camera in a campaign's report."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from frenetic import (
    Budget,
    Campaign,
    CampaignStore,
    Driver,
    EmbeddedSimulator,
    Planner,
    RandomSearch,
)
from frenetic._support.json_value import JSONValue
from frenetic.campaign.record import Test
from frenetic.drivers.loading import load_driver
from frenetic.plugins.vision import appearance
from frenetic.plugins.vision.film import LARGEST, MOST_PICTURES, camera_film
from frenetic.plugins.vision.rendering import CameraRenderer
from frenetic.report.html import campaign_report
from frenetic.report.html.tests import Film
from frenetic.spec.terms import Terms


def run(
    folder: Path, driver: Driver, simulations: int, conditions: Mapping[str, float] | None = None
) -> None:
    Campaign(
        strategy=RandomSearch(seed=3),
        simulator=EmbeddedSimulator(),
        driver=driver,
        terms=Terms(conditions=conditions or {}),
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()


def camera_data(record: Test, config: Mapping[str, JSONValue]) -> Film | None:
    return camera_film(config)(record)


@pytest.fixture(scope="module", params=["wrappers", "conditions"])
def searched(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign in fog, laid over the driver by hand or as a condition of the campaign."""
    folder = tmp_path_factory.mktemp("searched") / "campaign"
    if request.param == "wrappers":
        run(folder, load_driver("marking-follower", fog=25.0, delay=0.1), 2)
    else:
        run(folder, load_driver("marking-follower"), 2, {"fog": 25.0, "delay": 0.1})
    return folder


def picture(url: str) -> np.ndarray:
    kind, _, data = url.partition(",")
    assert kind == "data:image/jpeg;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))).astype(float)


@pytest.mark.heavy
def test_a_report_shows_what_the_camera_saw_through_its_wrappers(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        report = campaign_report(store)
        record = store.test(report.data["drives"][0]["id"])
    camera = report.data["drives"][0]["film"]
    assert camera is not None
    assert len(camera.times) <= MOST_PICTURES
    assert camera.times[0] == 0.0
    assert list(camera.times) == sorted(set(camera.times))
    sheet = picture(camera.pictures)
    driver = load_driver("marking-follower", fog=25.0)
    assert isinstance(driver, appearance.Foggy)
    renderer = CameraRenderer(record.road, driver.driver.camera)  # type: ignore[attr-defined]
    assert record.drive is not None
    path = record.drive.trajectory
    for k in (0, 9):
        i = int(np.argmin(np.abs(path.time - path.time[0] - camera.times[k])))
        drawn = renderer.draw(path.x[i], path.y[i], path.heading[i])
        v, u = divmod(k, camera.columns)
        part = sheet[v * camera.height :, u * camera.width :][: camera.height, : camera.width]
        foggy = driver.alter(drawn, None).astype(float)  # type: ignore[arg-type]
        assert np.abs(part - foggy).mean() < 4.0
        assert np.abs(part - drawn).mean() > 15.0  # the fog is there


def test_a_report_has_pictures_only_of_built_in_parts(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        config, record = store.config, store.test(1)
    assert camera_data(record, config) is not None
    elsewhere = {"simulator": {"class": "mine:Simulator"}}
    assert camera_data(record, {**config, **elsewhere}) is None
    assert camera_data(record, {**config, "driver": {"class": "mine:Driver"}}) is None


def test_large_pictures_are_shrunk(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        config, record = store.config, store.test(1)
    large: JSONValue = {"class": "mine:Driver", "camera": {"width": 400, "height": 100}}
    camera = camera_data(record, {**config, "driver": large})
    assert camera is not None
    assert (camera.width, camera.height) == (LARGEST, 80)


def test_a_driver_without_a_camera_has_no_pictures(tmp_path: Path) -> None:
    folder = tmp_path / "campaign"
    run(folder, Planner(), 1)
    with CampaignStore.open(folder) as store:
        assert [drive["film"] for drive in campaign_report(store).data["drives"]] == [None]
