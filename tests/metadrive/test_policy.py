"""Policies of one's own, with MetaDrive's observation; no MetaDrive runs but for one test."""

from __future__ import annotations

import pickle
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
from frenetic.metadrive import MetaDriveExpert, MetaDrivePolicy, MetaDriveSimulator
from frenetic.metadrive.expert import weights
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator, Simulator
from frenetic.testing import DriverContract

LAYERS = ("fc_1", "fc_2", "fc_out")


def name_of(layer: str, part: str) -> str:
    return f"default_policy/{layer}/{part}"


def unmirrored() -> dict[str, npt.NDArray[Any]]:
    """The expert's network for the observation as MetaDrive gives it today: w (1 - x) = w - w x."""
    network = {name: array.copy() for name, array in weights().items()}
    kernel, bias = (network[name_of("fc_1", part)] for part in ("kernel", "bias"))
    bias += kernel[[10, 15]].sum(axis=0)
    kernel[[10, 15]] *= -1.0
    return network


def write_onnx(
    path: Path, network: dict[str, Any], shape: tuple[int | str, ...] = (1, 275)
) -> Path:
    """The same as a graph; without its spreads."""
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
    assert drive.error is None, drive.error
    return drive.trajectory.to_rows()


def test_the_experts_weights_drive_as_the_expert_does(tmp_path: Path) -> None:
    file = write_onnx(tmp_path / "mine.onnx", unmirrored())
    own = policy(file)
    file.unlink()
    with MetaDriveSimulator() as metadrive:
        for simulator in (EmbeddedSimulator(), metadrive):
            wanted = rows(simulator, MetaDriveExpert())
            for one in (own, pickle.loads(pickle.dumps(own))):
                np.testing.assert_allclose(rows(simulator, one), wanted, rtol=0, atol=0.01)


# What is refused, in a line


def giving(*values: float, shape: tuple[int | str, ...] = (1, 275)) -> Any:
    tensor = numpy_helper.from_array(np.array([values], dtype=np.float32))
    node = helper.make_node("Constant", [], ["out"], value=tensor)
    return lambda path: save(path, [node], "out", shape)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda _: None, "there is no file"),
        (giving(0.0, 0.0, shape=(1, 259)), "it takes (1, 259): (1, 275) alone is needed"),
        (giving(0.0), "it gives 1 numbers: 2, steering and pedal, are needed"),
        (giving(0.0, float("nan")), "it gives nan"),
        (lambda path: path.write_bytes(b"no model"), "it is no ONNX model"),
    ],
)
def test_a_file_that_holds_no_policy_is_refused_in_a_line(
    make: Any, message: str, tmp_path: Path
) -> None:
    file = tmp_path / "m.onnx"
    make(file)
    with pytest.raises(FreneticError) as caught:
        load_driver("frenetic.metadrive:MetaDrivePolicy", {"weights": str(file)})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
