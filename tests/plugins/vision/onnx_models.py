"""Small models in ONNX files."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from onnx import TensorProto, helper, numpy_helper

NCHW = (1, 3, 4, 6)
NHWC = (1, 4, 6, 3)


def write(
    path: Path,
    nodes: Sequence[Any],
    *,
    shape: Sequence[int | str] = NCHW,
    kind: int = TensorProto.FLOAT,
    inputs: Sequence[str] = ("image",),
    further: Mapping[str, Sequence[int | str]] = {},
    gives: Sequence[str] = ("out",),
    tensors: Sequence[Any] = (),
    opset: int = 13,
    **convention: Any,
) -> Path:
    """Write a model of nodes with further inputs; its metadata hold the convention."""
    shapes = dict.fromkeys(inputs, shape) | dict(further)
    domains = {node.domain for node in nodes}
    graph = helper.make_graph(
        list(nodes),
        "test",
        [helper.make_tensor_value_info(name, kind, list(size)) for name, size in shapes.items()],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in gives],
        list(tensors),
    )
    model = helper.make_model(
        graph,
        opset_imports=[helper.make_opsetid(domain, opset) for domain in sorted(domains | {""})],
        ir_version=8,
    )
    if convention:
        helper.set_model_props(model, {"frenetic": json.dumps(convention)})
    path.write_bytes(model.SerializeToString())
    return path


def answering(path: Path, *values: float, **more: Any) -> Path:
    """Write a model that returns these numbers for every image."""
    tensor = numpy_helper.from_array(np.array([values], dtype=np.float32))
    return write(path, [helper.make_node("Constant", [], ["out"], value=tensor)], **more)


def weighing(path: Path, weights: npt.NDArray[np.float64], **more: Any) -> Path:
    """Write a model that returns the weighted sum of its input as the wheels' angle."""
    nodes = [
        helper.make_node("Flatten", ["image"], ["flat"]),
        helper.make_node("MatMul", ["flat", "w"], ["out"]),
    ]
    tensors = [numpy_helper.from_array(weights.reshape(-1, 1).astype(np.float32), "w")]
    return write(path, nodes, tensors=tensors, steering="rad", **more)


def with_weights_in(path: Path, other: str) -> Path:
    """Write a model whose weights lie in another file."""
    tensor = numpy_helper.from_array(np.zeros(3, dtype=np.float32), "w")
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", other
    nodes = [helper.make_node("Identity", ["w"], ["out"])]
    return write(path, nodes, tensors=[tensor])
