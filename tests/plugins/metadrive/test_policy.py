"""A user's policies on MetaDrive's observation; MetaDrive runs in one test only."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from metadrive_drives import WINDING
from onnx import TensorProto, helper, numpy_helper

from frenetic.drivers import Driver
from frenetic.drivers.loading import load_driver
from frenetic.errors import FreneticError
from frenetic.plugins.metadrive import MetaDriveExpert, MetaDrivePolicy, MetaDriveSimulator
from frenetic.plugins.metadrive.expert import weights
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Simulator
from frenetic.testing import DriverContract

pytestmark = pytest.mark.heavy

Arrays = Mapping[str, npt.NDArray[Any]]
LAYERS = ("fc_1", "fc_2", "fc_out")


def name_of(layer: str, part: str) -> str:
    return f"default_policy/{layer}/{part}"


def unmirrored() -> dict[str, npt.NDArray[Any]]:
    """Return the expert's network for today's observation, 1 - x for x: w (1 - x) = w - w x."""
    network = {name: array.copy() for name, array in weights().items()}
    kernel, bias = (network[name_of("fc_1", part)] for part in ("kernel", "bias"))
    bias += kernel[[10, 15]].sum(axis=0)
    kernel[[10, 15]] *= -1.0
    return network


def write_npz(path: Path, network: Arrays) -> Path:
    np.savez(path, **dict(network))  # type: ignore[arg-type]
    return path


def write_onnx(path: Path, network: Arrays, shape: tuple[int | str, ...] = (1, 275)) -> Path:
    """Write a network as ONNX, without its standard deviations."""
    nodes, tensors, value = [], [], "seen"
    for layer in LAYERS:
        kernel, bias = (network[name_of(layer, part)] for part in ("kernel", "bias"))
        if layer == "fc_out":
            kernel, bias = kernel[:, :2], bias[:2]
        tensors += [
            numpy_helper.from_array(array.astype(np.float32), f"{layer}/{part}")
            for part, array in (("kernel", kernel), ("bias", bias))
        ]
        nodes.append(helper.make_node("Gemm", [value, *(t.name for t in tensors[-2:])], [layer]))
        nodes.append(helper.make_node("Tanh", [layer], [value := f"{layer}/tanh"]))
    return save(path, nodes[:-1], "fc_out", shape, tensors)


def save(path: Path, nodes: Any, out: str, shape: tuple[int | str, ...], tensors: Any = ()) -> Path:
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("seen", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(out, TensorProto.FLOAT, None)],
        list(tensors),
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def policy(path: Path) -> MetaDrivePolicy:
    return MetaDrivePolicy(weights=str(path))


class TestPolicy(DriverContract):
    @pytest.fixture(autouse=True)
    def _file(self, tmp_path: Path) -> None:
        self.file = write_onnx(tmp_path / "m.onnx", unmirrored(), ("n", 275))

    def make(self) -> Driver:
        return policy(self.file)


def rows(simulator: Simulator, driver: Driver, road: Road = WINDING) -> npt.NDArray[Any]:
    drive = simulator.drive(road, driver)
    assert drive.trouble is None, drive.trouble
    return drive.trajectory.to_rows()


def test_the_experts_weights_drive_like_the_expert(tmp_path: Path) -> None:
    files = [
        write(tmp_path / name, unmirrored())
        for name, write in (("mine.npz", write_npz), ("mine.onnx", write_onnx))
    ]
    policies = [policy(file) for file in files]
    for file in files:
        file.unlink()
    policies += [pickle.loads(pickle.dumps(driver)) for driver in policies]
    with MetaDriveSimulator() as metadrive:
        for simulator in (EmbeddedSimulator(), metadrive):
            expected = rows(simulator, MetaDriveExpert())
            for driver in policies:
                np.testing.assert_allclose(rows(simulator, driver), expected, rtol=0, atol=0.01)


# Refused files


def changed(part: str, layer: str, array: Any) -> Any:
    return lambda path: write_npz(path, small() | {name_of(layer, part): np.asarray(array)})


def small() -> dict[str, npt.NDArray[Any]]:
    """Return a network whose sizes differ from the expert's network."""
    sizes = dict(zip(LAYERS, ((275, 3), (3, 5), (5, 2)), strict=True))
    return {
        name_of(layer, part): np.zeros(size[:2] if part == "kernel" else size[1:])
        for layer, size in sizes.items()
        for part in ("kernel", "bias")
    }


def without_bias(path: Path) -> Path:
    network = small()
    del network[name_of("fc_2", "bias")]
    return write_npz(path, network)


def pickled(path: Path) -> None:
    path.write_bytes(pickle.dumps({"weights": [1.0]}))


def giving(*values: float, shape: tuple[int | str, ...] = (1, 275)) -> Any:
    tensor = numpy_helper.from_array(np.array([values], dtype=np.float32))
    node = helper.make_node("Constant", [], ["out"], value=tensor)
    return lambda path: save(path, [node], "out", shape)


KERNEL = "default_policy/fc_1/kernel"
REFUSED: list[tuple[str, Any, str]] = [
    ("m.npz", lambda _: None, "there is no file"),
    ("m.npz", lambda path: path.write_bytes(b"PK\x03\x04"), "it is no .npz file of numbers, as"),
    ("m.npz", pickled, "it is no .npz file of numbers, as"),
    ("m.npz", changed("kernel", "fc_1", [object()]), "it is no .npz file of numbers, as"),
    ("m.npz", without_bias, "it has no array default_policy/fc_2/bias"),
    (
        "m.npz",
        changed("kernel", "fc_1", np.zeros((259, 3))),
        f"its {KERNEL} has the shape (259, 3): (275, any) is needed",
    ),
    (
        "m.npz",
        changed("kernel", "fc_2", np.zeros((4, 5))),
        "its default_policy/fc_2/kernel has the shape (4, 5): (3, any) is needed",
    ),
    (
        "m.npz",
        changed("kernel", "fc_out", np.zeros((5, 3))),
        "its default_policy/fc_out/kernel has the shape (5, 3): (5, 2 or 4) is needed",
    ),
    (
        "m.npz",
        changed("bias", "fc_2", np.zeros(4)),
        "its default_policy/fc_2/bias has the shape (4,): (5,) is needed",
    ),
    ("m.npz", changed("kernel", "fc_1", np.full((275, 3), np.nan)), f"its {KERNEL} must be finite"),
    ("m.npz", changed("kernel", "fc_1", np.zeros((275, 3), int)), f"its {KERNEL} must be finite"),
    ("m.onnx", giving(0.0, 0.0, shape=(1, 259)), "it takes (1, 259): (1, 275) alone is needed"),
    ("m.onnx", giving(0.0), "it gives 1 numbers: 2, steering and pedal, are needed"),
    ("m.onnx", giving(0.0, float("nan")), "it gives nan"),
    ("m.onnx", pickled, "it is no ONNX model"),
]


@pytest.mark.parametrize(("name", "make", "message"), REFUSED)
def test_a_file_without_a_policy_is_refused_in_one_line(
    name: str, make: Any, message: str, tmp_path: Path
) -> None:
    file = tmp_path / name
    make(file)
    with pytest.raises(FreneticError) as caught:
        load_driver("frenetic.plugins.metadrive:MetaDrivePolicy", {"weights": str(file)})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_network_of_other_sizes_drives(tmp_path: Path) -> None:
    network = small() | {name_of("fc_out", "bias"): np.array([0.0, 0.25])}
    drive = EmbeddedSimulator().drive(WINDING, policy(write_npz(tmp_path / "m.npz", network)))
    assert drive.trouble is None
    assert drive.trajectory.speed.max() > 3.0


def test_non_finite_output_ends_the_drive(tmp_path: Path) -> None:
    network = small()
    for layer in LAYERS:  # infinite where an input is not 0
        network[name_of(layer, "kernel")][:] = 1e308
    drive = EmbeddedSimulator().drive(WINDING, policy(write_npz(tmp_path / "m.npz", network)))
    assert drive.trouble is not None
    assert "m.npz: it gives inf" in drive.trouble.reason
