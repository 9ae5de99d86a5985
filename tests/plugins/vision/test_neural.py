"""Neural networks as drivers."""

from __future__ import annotations

import hashlib
import math
import pickle
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx_models import (
    NCHW,
    NHWC,
    answering,
    weighing,
    with_weights_in,
    write,
)

from frenetic import (
    Controls,
    Driver,
    DriveSetup,
    EmbeddedSimulator,
    Observation,
    Outcome,
    Road,
    judge,
)
from frenetic.drivers.loading import load_driver
from frenetic.errors import DriverError, FreneticError
from frenetic.plugins.vision.neural import Convention, Dave2, Network
from frenetic.plugins.vision.neural.network import DAVE2
from frenetic.plugins.vision.policy import PolicyDriver
from frenetic.testing import DriverContract

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]
pytestmark = pytest.mark.heavy

SIZE = {"width": 6, "height": 4}


def setup() -> DriveSetup:
    return EmbeddedSimulator().setup(Road([0.0] * 8))


def seeing(image: npt.NDArray[np.uint8], speed: float = 5.0) -> Observation:
    nothing = np.empty((0, 2))
    return Observation(0.0, speed, 0.0, 0.0, 0.0, 0.0, nothing, nothing[:, 0], image=image)


def picture(seed: int = 1, shape: tuple[int, ...] = (4, 6, 3)) -> npt.NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def controls_of(network: Network, speed: float = 5.0) -> Controls:
    network.reset(setup())
    return network.act(seeing(picture(shape=network.camera.shape), speed))


# Inputs of a network


def rgb_to_yuv(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Convert by the formula of OpenCV's documentation, to 0..1."""
    r, g, b = (image[..., i] / 255.0 for i in range(3))
    y = 0.299 * r + 0.587 * g + 0.114 * b
    return np.stack([y, 0.492 * (b - y) + 0.5, 0.877 * (r - y) + 0.5], axis=-1)


WEIGHTS = np.random.default_rng(3).normal(0.0, 0.1, (4, 6, 3))
"""Weights of pixels: height, width, channels."""


def assert_fed(
    network: Network, image: npt.NDArray[np.uint8], channels: npt.ArrayLike, within: float = 1e-4
) -> None:
    """Assert that the network's input is these channels of an image: height, width, n."""
    network.reset(setup())
    angle = network.act(seeing(image)).steering
    weights = WEIGHTS[..., : np.shape(channels)[2]]
    expected = (weights * np.asarray(channels)).sum()
    assert angle == pytest.approx(expected, abs=within, rel=1e-6)


@pytest.mark.parametrize("shape", [NCHW, NHWC, (1, 3, "height", "width"), ("n", 4, 6, 3)])
def test_colour_layout_and_scale_follow_the_file(
    shape: tuple[int | str, ...], tmp_path: Path
) -> None:
    image = picture()
    inputs: dict[str, npt.NDArray[np.float64]] = {
        "rgb": image / 255.0,
        "bgr": image[..., ::-1] / 255.0,
        "yuv": rgb_to_yuv(image),
    }
    weights = WEIGHTS.transpose(2, 0, 1) if shape[1] == 3 else WEIGHTS
    scale = {"mean": [0.5, 0.4, 0.3], "std": 0.5, "camera": SIZE}
    for colour, channels in inputs.items():
        file = weighing(tmp_path / "m.onnx", weights, shape=shape, colour=colour, **scale)
        within = 5e-3 if colour == "yuv" else 1e-4  # its constants are rounded
        assert_fed(Network(str(file)), image, (channels - (0.5, 0.4, 0.3)) / 0.5, within)


def test_a_grey_image_is_the_brightness(tmp_path: Path) -> None:
    image = picture()
    file = weighing(tmp_path / "m.onnx", WEIGHTS[..., :1], shape=(1, 1, 4, 6), colour="grey")
    assert_fed(Network(str(file)), image, rgb_to_yuv(image)[..., :1])


def test_rows_are_cropped_and_larger_images_resized(tmp_path: Path) -> None:
    file = weighing(tmp_path / "m.onnx", WEIGHTS, shape=NHWC, crop=[2, 1])
    network = Network(str(file))
    assert network.camera.shape == (7, 6, 3)
    image = picture(shape=(7, 6, 3))
    assert_fed(network, image, image[2:6] / 255.0)
    # Twice as fine: each pixel is the mean of the four that it covers.
    finer = Network(str(file), crop=[0, 0], camera={"width": 12, "height": 8})
    image = picture(shape=(8, 12, 3))
    assert_fed(finer, image, image.reshape(4, 2, 6, 2, 3).mean(axis=(1, 3)) / 255.0)


def test_dave2_is_a_preset_that_metadata_and_options_override(tmp_path: Path) -> None:
    file = answering(tmp_path / "m.onnx", 0.0, shape=(1, 3, 66, 200), preset="dave2", std=1.0)
    network = Network(str(file), mean=0.1, camera={"pitch": 5.0})
    convention = network.convention
    assert (convention.colour, convention.mean, convention.std) == ("yuv", 0.1, 1.0)
    camera = network.camera
    assert (camera.height, camera.width, camera.pitch, camera.field_of_view) == (66, 200, 5.0, 90.0)
    assert network.options == {"model": str(file), "mean": 0.1, "camera": {"pitch": 5.0}}


# Outputs of a network


@pytest.mark.parametrize(
    ("options", "value", "angle"),
    [
        ({}, 0.25, lambda s: 0.25 * s.max_steering),
        ({"steering": "rad", "steering_sign": -1}, 0.1, lambda s: -0.1),
        ({"steering": "degrees"}, 10.0, lambda s: math.radians(10.0)),
        ({"steering": "curvature"}, -0.05, lambda s: math.atan(-0.05 * s.wheelbase)),
    ],
)
def test_steering_has_a_unit_and_a_sign(
    options: dict[str, Any], value: float, angle: Any, tmp_path: Path
) -> None:
    file = answering(tmp_path / "m.onnx", value, **options)
    assert controls_of(Network(str(file))).steering == pytest.approx(angle(setup()), abs=1e-6)


def test_speed_follows_the_rule_of_the_competition(tmp_path: Path) -> None:
    file = str(answering(tmp_path / "m.onnx", 0.5))
    assert controls_of(Network(file, max_speed=36.0), 5.0).throttle == pytest.approx(0.5)
    assert controls_of(Network(file, max_speed=36.0), 12.0) == Controls(0.5 * setup().max_steering)
    limit = setup().speed_limit  # of the drive
    for network in (Network(file), Network(file, max_speed=500.0)):
        throttle = 1.0 - 0.25 - (5.0 / limit) ** 2
        assert controls_of(network, 5.0).throttle == pytest.approx(throttle)


@pytest.mark.parametrize(("value", "pedals"), [(0.75, (0.75, 0.0)), (-0.25, (0.0, 0.25))])
def test_a_network_may_have_a_throttle(
    value: float, pedals: tuple[float, float], tmp_path: Path
) -> None:
    file = answering(tmp_path / "m.onnx", 0.0, value, outputs="steering-throttle")
    answer = controls_of(Network(str(file)))
    assert (answer.throttle, answer.brake) == pedals


# As a driver of the command line


def test_a_model_file_names_a_driver(
    frenetic: Frenetic, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ("--simulations", "3", "--seed", "1", "--workers", "1", "--json")
    answering(tmp_path / "m.onnx", 0.0, max_speed=30.0)
    answer = frenetic("run", "--driver", "m.onnx", *options, "--strategy", "random", "--out", "c")
    assert answer.code == 0, answer.err
    shown = frenetic("show", "c", "--json").json["config"]
    assert shown["spec"]["driver"] == "m.onnx"
    assert "onnxruntime" in shown["driver"]["version"]
    assert frenetic("resume", "c", "--simulations", "4", "--json").code == 0
    answering(tmp_path / "m.onnx", 0.1, max_speed=30.0)
    answer = frenetic("resume", "c", "--simulations", "5")
    assert answer.refuses("c was made with another driver", "start a new campaign from this one")


def test_a_pickled_network_needs_no_file(tmp_path: Path) -> None:
    file = answering(tmp_path / "m.onnx", 0.3)
    network = load_driver(str(file), {"max_speed": 20.0})
    data = pickle.dumps(network)
    file.unlink()
    copy = pickle.loads(data)
    assert controls_of(copy) == controls_of(network)  # type: ignore[arg-type]
    assert copy.options == {"model": str(file), "max_speed": 20.0}


# Refused models


def of_node(*node: Any, **more: Any) -> Callable[[Path], Path]:
    """Return a function that writes a model of one node."""
    domain = more.pop("domain", None)
    return lambda path: write(path, [helper.make_node(*node, ["out"], domain=domain)], **more)


def other_folder(path: Path) -> Path:
    (path.parent.parent / "secret").write_bytes(bytes(12))
    return with_weights_in(path, "../secret")


def giving(*values: float, **more: Any) -> Callable[[Path], Path]:
    """Return a function that writes a model that returns these numbers."""
    return lambda path: answering(path, *values, **more)


steering_only = giving(0.0)
matmul = ("MatMul", ["image", "image"])


REFUSED = [
    (lambda _: None, {}, "there is no file"),
    (lambda path: path.write_bytes(b"\x80\x04garbage"), {}, "it is no ONNX model"),
    (lambda path: path.write_bytes(b""), {}, "it is no ONNX model"),
    (
        of_node("Evil", ["image"], domain="evil"),
        {},
        "its operator evil:Evil is not one of onnxruntime's",
    ),
    (
        of_node("Add", ["image", "b"], inputs=("image", "b")),
        {},
        "its input b, (1, 3, 4, 6), is neither the image, one speed, nor a state that just one",
    ),
    (other_folder, {}, "it keeps weights in another file: export it as one file"),
    (of_node(*matmul, shape=(1, 3, "height", "width"), camera=SIZE), {}, "it cannot be computed"),
    (of_node(*matmul), {}, "onnxruntime cannot load it: "),
    (giving(math.nan), {}, "the network gives nan"),
    (
        giving(0.0, shape=(1, 3, 100_000, 100_000)),
        {},
        "the camera's width is 100000: a whole number",
    ),
    (
        giving(0.0, shape=(8, 3, 66, 200)),
        {},
        "its input has the shape (8, 3, 66, 200): one image is needed",
    ),
    (
        giving(0.0, kind=TensorProto.DOUBLE),
        {},
        "its input is a tensor(double): tensor(float) is needed",
    ),
    (steering_only, {"outputs": "steering-throttle"}, "gives 1 numbers, but its outputs are"),
    (
        steering_only,
        {"outputs": "pedals"},
        "outputs is 'pedals': 'steering' or 'steering-throttle' is",
    ),
    (steering_only, {"colour": "grey"}, "has the shape (1, 3, 4, 6), nchw: grey has 1 channel;"),
    (steering_only, {"mean": [1, 2]}, "mean is [1.0, 2.0]: a number is needed, or one"),
    (steering_only, {"std": 0}, "std is 0: a number > 0 is needed"),
    (steering_only, {"crop": [4, 0], "camera": SIZE}, "nothing is left of 4 rows"),
    (steering_only, {"camera": {"zoom": 2}}, "a camera has no 'zoom'; it has: width, height"),
    (giving(0.0, crops=1), {}, "its metadata frenetic are damaged: Object contains unknown field"),
]


@pytest.mark.parametrize(("make", "options", "message"), REFUSED)
def test_an_unsuitable_model_is_refused_in_one_line(
    make: Any,
    options: dict[str, Any],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    folder = tmp_path / "models"
    folder.mkdir()
    monkeypatch.chdir(folder)
    file = folder / "m.onnx"
    make(file)
    with pytest.raises(FreneticError, match=r"driver '.*m\.onnx'") as caught:
        load_driver(str(file), options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"mean": NaN}', '{"crop": [1e400, 0]}', "[" * 100_000], ids=range(5)
)
def test_damaged_metadata_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"its metadata frenetic are damaged"):
        Convention.of({"frenetic": text}, {})


def test_non_finite_output_and_a_missing_image_end_the_drive(tmp_path: Path) -> None:
    # The network divides by the sum of the pixels, which is 0 for a black image only.
    nodes = [
        helper.make_node("ReduceSum", ["image"], ["sum"], keepdims=0),
        helper.make_node("Div", ["sum", "sum"], ["out"]),
    ]
    network = Network(str(write(tmp_path / "m.onnx", nodes)))
    network.reset(setup())
    with pytest.raises(DriverError, match=r"m\.onnx: the network gives nan"):
        network.act(seeing(np.zeros((4, 6, 3), dtype=np.uint8)))
    with pytest.raises(DriverError, match="draws no image"):
        network.act(seeing(None))  # type: ignore[arg-type]


def test_an_error_names_the_missing_extra(
    frenetic: Frenetic, monkeypatch: pytest.MonkeyPatch
) -> None:
    answering(Path("m.onnx"), 0.0)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    answer = frenetic("run", "--driver", "m.onnx", "--simulations", "2", "--out", "c")
    assert answer.refuses('a neural network needs onnxruntime: pip install ".[neural]"')
    assert not Path("c").exists()


# The built-in network


DAVE2_SHA256 = "1ae3ead8ef0275bd19c469059535602f374cbb73b1d432283f11cd0217b734ba"


class TestDave2(DriverContract):
    def make(self) -> Driver:
        return Dave2()


def test_dave2_is_the_trained_network() -> None:
    assert hashlib.sha256(DAVE2.read_bytes()).hexdigest() == DAVE2_SHA256
    assert DAVE2.stat().st_size < 2_000_000


def test_dave2_keeps_its_lane_on_a_winding_road() -> None:
    road = Road([0.0, 0.0, 0.02, 0.03, 0.0, -0.03, -0.03, 0.0, 0.02, 0.0])
    result = judge(road, EmbeddedSimulator().drive(road, load_driver("dave2")))
    assert result.outcome is Outcome.PASS


# A policy of the environment


def test_a_network_of_vectors_drives_like_the_same_policy(tmp_path: Path) -> None:
    weights = np.zeros((2, 26), dtype=np.float32)
    weights[0, 4:6] = -0.8
    weights[0, 6:9] = 0.17
    weights[1, 0] = -20.0
    tensors = [
        numpy_helper.from_array(weights, "w"),
        numpy_helper.from_array(np.array([0.0, 5.0], dtype=np.float32), "b"),
    ]
    file = write(
        tmp_path / "m.onnx",
        [helper.make_node("Gemm", ["image", "w", "b"], ["out"], transB=1)],
        shape=("n", 26),
        tensors=tensors,
        outputs="steering-throttle",
        steering="action",
    )
    network = Network(str(file), inputs="vector")

    def policy(vector: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return weights @ vector + np.array([0.0, 5.0], dtype=np.float32)

    road = Road([0.0, 0.02, 0.05, 0.05, 0.0, -0.04, -0.06, -0.02, 0.0])
    drives = [EmbeddedSimulator().drive(road, driver) for driver in (network, PolicyDriver(policy))]
    assert not hasattr(network, "camera")
    rows = [drive.trajectory.to_rows() for drive in drives]
    np.testing.assert_allclose(rows[0], rows[1], rtol=0, atol=1e-3)
    assert judge(road, drives[0]).outcome is Outcome.PASS


@pytest.mark.parametrize("shape", [(1, 25), (1, 3, 4, 6)])
def test_a_network_of_vectors_refuses_other_shapes(shape: tuple[int, ...], tmp_path: Path) -> None:
    file = answering(tmp_path / "m.onnx", 0.0, shape=shape)
    with pytest.raises(ValueError, match=r"a vector is needed, \(1, 26\) floats"):
        Network(str(file), inputs="vector")
