"""Networks with speed, several frames and states, compared with NumPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from onnx import TensorProto, helper, numpy_helper
from onnx_models import NCHW, answering, write

from frenetic import EmbeddedSimulator, Observation, Road
from frenetic.drivers.loading import load_driver
from frenetic.errors import DriverError, FreneticError
from frenetic.plugins.vision.neural import Network

pytestmark = pytest.mark.heavy

Pixels = npt.NDArray[np.uint8]

ROAD = Road([0.0] * 8)


def seeing(image: Pixels, speed: float = 5.0) -> Observation:
    nothing = np.empty((0, 2))
    return Observation(0.0, speed, 0.0, 0.0, 0.0, 0.0, nothing, nothing[:, 0], image=image)


def pictures(count: int, shape: Sequence[int]) -> list[Pixels]:
    random = np.random.default_rng(5)
    return [random.integers(0, 256, shape, dtype=np.uint8) for _ in range(count)]


def angles(network: Network, images: Sequence[Pixels], speed: float = 5.0) -> list[float]:
    """Reset a network; return its steering for each image."""
    network.reset(EmbeddedSimulator().setup(ROAD))
    return [network.act(seeing(image, speed)).steering for image in images]


def weights(*shape: int) -> npt.NDArray[np.float32]:
    return np.random.default_rng(3).normal(0.0, 0.1, shape).astype(np.float32)


def tensor(values: npt.ArrayLike, name: str) -> Any:
    return numpy_helper.from_array(np.asarray(values, dtype=np.float32), name)


SEEING = [
    helper.make_node("Flatten", ["image"], ["flat"]),
    helper.make_node("MatMul", ["flat", "w"], ["seen"]),
]


# Speed


@pytest.mark.parametrize("shape", [(), (1,), (1, 1), ("n", 1)])
def test_another_input_of_one_number_is_the_speed(
    shape: Sequence[int | str], tmp_path: Path
) -> None:
    w = weights(3, 4, 6)
    file = write(
        tmp_path / "m.onnx",
        [
            *SEEING,
            helper.make_node("Mul", ["speed", "k"], ["fast"]),
            helper.make_node("Add", ["seen", "fast"], ["out"]),
        ],
        further={"speed": shape},
        tensors=[tensor(w.reshape(-1, 1), "w"), tensor(0.01, "k")],
        steering="rad",
    )
    (image,) = pictures(1, (4, 6, 3))
    from_image = (w * image.transpose(2, 0, 1) / 255.0).sum()
    for options, unit in (({}, 1.0), ({"speed_scale": 3.6}, 3.6)):
        network = Network(str(file), **options)  # type: ignore[arg-type]
        assert angles(network, [image], 7.0) == pytest.approx(
            [from_image + 0.01 * 7.0 * unit], abs=1e-5
        )


# Frames


def stacked(axis: int) -> Callable[[list[Any]], Any]:
    """Return a function that joins frames as channels, moved to this axis."""
    return lambda frames: np.moveaxis(np.concatenate(frames, axis=2), 2, axis)


def apart(axis: int) -> Callable[[list[Any]], Any]:
    """Return a function that joins frames in a first axis, with the channels in this axis."""
    return lambda frames: np.moveaxis(np.stack(frames), 3, axis)


FRAMES: list[tuple[Sequence[int | str], dict[str, Any], Callable[[list[Any]], Any]]] = [
    ((1, 6, 8, 10), {}, stacked(0)),
    ((1, 8, 10, 6), {}, stacked(2)),
    ((1, 8, 10, 6), {"layout": "nhwc", "frames": 2}, stacked(2)),
    ((1, 2, 3, 8, 10), {}, apart(1)),
    (("n", 2, 8, 10, 3), {}, apart(3)),
    (("n", "frames", 3, 8, 10), {"frames": 2}, apart(1)),
    ((2, 3, 8, 10), {"frames": 2}, apart(1)),
    ((2, 8, 10, 3), {"frames": 2}, apart(3)),
    ((1, "channels", 8, 10), {"frames": 2}, stacked(0)),
    ((1, 4, 8, 10), {"colour": "grey"}, stacked(0)),
    ((1, 3, 8, 10), {"colour": "grey", "frames": 3}, stacked(0)),
]


@pytest.mark.parametrize(("shape", "options", "arranged"), FRAMES)
def test_frames_are_the_last_images_and_at_first_the_first_image_repeated(
    shape: Sequence[int | str],
    options: dict[str, Any],
    arranged: Callable[[list[Any]], Any],
    tmp_path: Path,
) -> None:
    is_grey = options.get("colour") == "grey"
    count = {4: 4, 3: 3}[int(shape[1])] if is_grey else 2
    images = pictures(5, (8, 10, 3))
    planes = [
        image @ [0.299, 0.587, 0.114] / 255.0 if is_grey else image / 255.0 for image in images
    ]
    planes = [plane.reshape(8, 10, -1) for plane in planes]
    padded = [planes[0]] * (count - 1) + planes
    fed = [arranged(padded[i : i + count]) for i in range(len(images))]
    w = weights(fed[0].size)
    file = write(
        tmp_path / "m.onnx",
        [
            helper.make_node("Reshape", ["image", "row"], ["flat"]),
            helper.make_node("MatMul", ["flat", "w"], ["out"]),
        ],
        shape=shape,
        tensors=[
            tensor(w.reshape(-1, 1), "w"),
            numpy_helper.from_array(np.array([1, -1], dtype=np.int64), "row"),
        ],
        steering="rad",
        camera={"width": 10, "height": 8},
    )
    network = Network(str(file), **options)
    expected = [float(frames.ravel() @ w) for frames in fed]
    assert angles(network, images) == pytest.approx(expected, abs=1e-5)
    assert angles(network, images[2:])[0] != pytest.approx(
        expected[2], abs=1e-5
    )  # a reset clears the frames


# States


def remembering(
    path: Path, states: Mapping[str, str], shapes: Sequence[Sequence[int | str]]
) -> Path:
    """Write a network with h' = tanh(0.9 h + seen), c' = c + h'; it returns the sum of c'."""
    (h, h_next), (c, c_next) = states.items()
    return write(
        path,
        [
            *SEEING,
            helper.make_node("Mul", [h, "k"], ["less"]),
            helper.make_node("Add", ["less", "seen"], ["both"]),
            helper.make_node("Tanh", ["both"], [h_next]),
            helper.make_node("ReduceSum", [h_next, "one"], ["sum"], keepdims=1)
            if tuple(shapes[1])[-1] == 1
            else helper.make_node("Identity", [h_next], ["sum"]),
            helper.make_node("Add", [c, "sum"], [c_next]),
            helper.make_node("ReduceSum", [c_next, "all"], ["out"], keepdims=1),
        ],
        further=dict(zip(states, shapes, strict=True)),
        gives=("out", c_next, h_next),
        tensors=[
            tensor(weights(72, 2), "w"),
            tensor(0.9, "k"),
            numpy_helper.from_array(np.array([1], dtype=np.int64), "one"),
            numpy_helper.from_array(np.array([0, 1], dtype=np.int64), "all"),
        ],
        steering="rad",
    )


PAIR = ((1, 2), (1, 2))
STATES: list[tuple[dict[str, str], Any, dict[str, Any]]] = [
    ({"h_in": "h_out", "c_in": "c_out"}, PAIR, {}),
    ({"h0": "hn", "c0": "cn"}, (("n", 2), ("n", 2)), {}),
    ({"hidden": "next_hidden", "cell": "next_cell"}, PAIR, {}),
    ({"a": "13", "b": "14"}, PAIR, {"states": {"a": "13", "b": "14"}}),
    (
        {"a": "13", "total_in": "total_out"},
        ((1, 2), (1, 1)),
        {},
    ),  # a by its shape, total_in by its name
]


@pytest.mark.parametrize(("states", "shapes", "options"), STATES)
def test_states_start_at_zero_and_are_fed_back(
    states: dict[str, str], shapes: Any, options: dict[str, Any], tmp_path: Path
) -> None:
    network = Network(str(remembering(tmp_path / "m.onnx", states, shapes)), **options)
    images = pictures(6, (4, 6, 3))
    h, total, expected = np.zeros(2), 0.0, []
    for image in images:
        h = np.tanh(0.9 * h + (image.transpose(2, 0, 1) / 255.0).ravel() @ weights(72, 2))
        total += h.sum()
        expected.append(total)
    first = angles(network, images)
    assert first == pytest.approx(expected, abs=1e-4)
    assert angles(network, images) == first


def test_speed_in_is_no_state_and_the_output_steering_comes_first(tmp_path: Path) -> None:
    file = write(
        tmp_path / "m.onnx",
        [
            helper.make_node("Add", ["steering_in", "k"], ["steering_out"]),
            helper.make_node("Mul", ["steering_out", "k"], ["steering"]),
            helper.make_node("Mul", ["speed_in", "k"], ["speed_out"]),
            helper.make_node("Mul", ["speed_out", "k"], ["throttle"]),
        ],
        further={"speed_in": (1, 1), "steering_in": (1, 1)},
        gives=("steering", "steering_out", "throttle"),
        tensors=[tensor(0.1, "k")],
        outputs="steering-throttle",
        steering="rad",
    )
    network = Network(str(file))
    images = pictures(2, (4, 6, 3))
    assert angles(network, images) == pytest.approx([0.01, 0.02])
    assert network.act(seeing(images[0], 8.0)).throttle == pytest.approx(0.08)


def test_drives_with_speed_frames_and_states_repeat(tmp_path: Path) -> None:
    file = write(
        tmp_path / "m.onnx",
        [
            *SEEING,
            helper.make_node("Mul", ["h_in", "k"], ["less"]),
            helper.make_node("Add", ["less", "seen"], ["both"]),
            helper.make_node("Tanh", ["both"], ["h_out"]),
            helper.make_node("Mul", ["h_out", "speed"], ["fast"]),
            helper.make_node("ReduceMean", ["fast"], ["out"]),
        ],
        shape=(1, 6, 8, 10),
        further={"speed": (1, 1), "h_in": (1, 2)},
        gives=("out", "h_out"),
        tensors=[tensor(weights(480, 2), "w"), tensor(0.9, "k")],
        speed_scale=3.6,
        max_speed=30.0,
    )
    road = Road([0.0, 0.02, 0.03, 0.0, -0.02, 0.0])
    network = load_driver(str(file))
    rows = [EmbeddedSimulator().drive(road, network).trajectory.to_rows() for _ in range(2)]
    assert len(rows[0]) > 20
    np.testing.assert_array_equal(rows[0], rows[1])


# Refused models


def unused_input(shape: Sequence[int | str], **more: Any) -> Callable[[Path], Path]:
    """Return a function that writes a model with an unused second input and no states."""
    return lambda path: write(
        path,
        [helper.make_node("ReduceMean", ["image"], ["out"])],
        **{"shape": NCHW, "further": {"b": shape}, **more},
    )


def image_only(*shape: int | str) -> Callable[[Path], Path]:
    """Return a function that writes a model with an image of this shape as its only input."""
    return lambda path: write(
        path, [helper.make_node("ReduceMean", ["image"], ["out"])], shape=shape
    )


def unnamed(path: Path) -> Path:
    return remembering(path, {"a": "13", "b": "14"}, PAIR)


def growing(path: Path) -> Path:
    nodes = [
        helper.make_node("Concat", ["h_in", "h_in"], ["h_out"], axis=1),
        helper.make_node("ReduceMean", ["image"], ["out"]),
    ]
    return write(path, nodes, further={"h_in": (1, "n")}, gives=("out", "h_out"))


OTHER = "is neither the image, one speed, nor a state that just one further output"

REFUSED: list[tuple[Any, dict[str, Any], str]] = [
    (unused_input((1, 7)), {}, f"its input b, (1, 7), {OTHER}"),
    (unused_input((1, 1), further={"b": (1, 1), "c": (1,)}), {}, f"its input c, (1), {OTHER}"),
    (unnamed, {}, f"its input a, (1, 2), {OTHER}"),
    (growing, {}, "its output h_out has the shape (1, 2), but the state h_in has (1, 1)"),
    (
        unnamed,
        {"states": {"a": "13", "b": "15"}},
        "its inputs are image, a, b, its outputs out, 14, 13",
    ),
    (
        lambda path: answering(path, 0.0, kind=TensorProto.DOUBLE, further={"b": (1, 1)}),
        {},
        "its input image is a tensor(double): tensor(float) is needed",
    ),
    (image_only(1, 1), {}, "none of its inputs (image) takes the image"),
    (image_only(1, 4, 8, 10), {}, "has the shape (1, 4, 8, 10), nchw: rgb has 3 channels; give"),
    (image_only(1, 6, 8, 10), {"frames": 3}, "(1, 6, 8, 10), which is 2 frames, and frames is 3"),
    (
        image_only(1, "n", 3, 8, 10),
        {},
        "is any number of frames, and frames is None: give their number",
    ),
    (
        image_only(1, 300, 999, 999),
        {},
        "is 100 frames, and frames is None: give their number, at most",
    ),
    (
        image_only(2, 3, 8, 10),
        {"frames": 4},
        "one image is needed, (1, channels, height, width) or",
    ),
    (image_only(1, 3, 8, 10), {"frames": 0}, "frames is 0: a whole number"),
    (image_only(1, 3, 8, 10), {"speed_scale": -1}, "speed_scale is -1: a number > 0 is needed"),
]


@pytest.mark.parametrize(("make", "options", "message"), REFUSED)
def test_unknown_inputs_are_refused_in_one_line(
    make: Any, options: dict[str, Any], message: str, tmp_path: Path
) -> None:
    file = make(tmp_path / "m.onnx")
    with pytest.raises(FreneticError, match=r"driver '.*m\.onnx'") as caught:
        load_driver(str(file), options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_non_finite_state_ends_the_drive(tmp_path: Path) -> None:
    file = write(
        tmp_path / "m.onnx",
        [
            helper.make_node("Add", ["h_in", "k"], ["h_out"]),
            helper.make_node("Mul", ["h_out", "h_out"], ["out"]),
        ],
        further={"h_in": (1, 1)},
        gives=("out", "h_out"),
        tensors=[tensor(1.5e19, "k")],
    )
    network = Network(str(file))
    images = pictures(2, (4, 6, 3))
    with pytest.raises(DriverError, match="the network gives inf"):
        angles(network, images)
