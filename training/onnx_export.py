"""Write networks of torch as ONNX files for the driver `Network`."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from torch import nn

from frenetic.plugins.vision.neural import METADATA

OPERATORS: Final[Mapping[type[nn.Module], str]] = {
    nn.ReLU: "Relu",
    nn.ELU: "Elu",
    nn.Tanh: "Tanh",
    nn.Flatten: "Flatten",
}
"""Layer without weights -> its ONNX operator."""


class Value(NamedTuple):
    """Input or output of a network, an array of float32."""

    name: str
    """Name in the file."""
    shape: Sequence[int]
    """Sizes of the axes."""


def write_network(
    layers: Iterable[nn.Module],
    path: Path,
    *,
    name: str,
    takes: Value,
    gives: Value,
    entries: Mapping[str, Any],
    output_scale: float = 1.0,
) -> None:
    """Write layers that follow each other as a network; the same weights give the same bytes.

    Args:
        layers: convolutions, dense layers and layers of `OPERATORS`; the last one is dense.
        path: the file.
        name: name of the network.
        takes: input of the network.
        gives: output of the network.
        entries: fields of the network's convention.
        output_scale: number by which the output is divided.
    """
    *hidden_layers, last_layer = layers
    nodes, tensors, value = [], [], takes.name
    for i, layer in enumerate([*hidden_layers, last_layer]):
        is_last = i == len(hidden_layers)
        inputs, output = [value], gives.name if is_last else f"x{i}"
        if isinstance(layer, (nn.Conv2d, nn.Linear)):
            scale = np.float32(output_scale if is_last else 1.0)
            for kind, weights in layer.state_dict().items():
                inputs.append(f"{kind}{i}")
                tensors.append(numpy_helper.from_array(weights.numpy() / scale, inputs[-1]))
        if isinstance(layer, nn.Conv2d):
            strides = [int(pixels) for pixels in layer.stride]
            nodes.append(helper.make_node("Conv", inputs, [output], strides=strides))
        elif isinstance(layer, nn.Linear):
            nodes.append(helper.make_node("Gemm", inputs, [output], transB=1))
        else:
            nodes.append(helper.make_node(OPERATORS[type(layer)], inputs, [output]))
        value = output
    graph = helper.make_graph(
        nodes,
        name,
        [helper.make_tensor_value_info(takes.name, TensorProto.FLOAT, takes.shape)],
        [helper.make_tensor_value_info(gives.name, TensorProto.FLOAT, gives.shape)],
        tensors,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    model.producer_name, model.producer_version = "frenetic", ""
    helper.set_model_props(model, {METADATA: json.dumps(entries)})
    onnx.checker.check_model(model)
    path.write_bytes(model.SerializeToString(deterministic=True))
