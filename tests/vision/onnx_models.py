"""Small models in ONNX files."""

from __future__ import annotations

import json
from collections.abc import Sequence
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
    tensors: Sequence[Any] = (),
    opset: int = 13,
    **convention: Any,
) -> Path:
    """A model of nodes whose last one gives ``out``; its metadata hold the convention."""
    domains = {node.domain for node in nodes}
    graph = helper.make_graph(
        list(nodes),
        "test",
        [helper.make_tensor_value_info(name, kind, list(shape)) for name in inputs],
        [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)],
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
    """A model that gives these numbers for every image."""
    tensor = numpy_helper.from_array(np.array([values], dtype=np.float32))
    return write(path, [helper.make_node("Constant", [], ["out"], value=tensor)], **more)


def weighing(path: Path, weights: npt.NDArray[np.float64], **more: Any) -> Path:
    """A model that gives the weighted sum of its input as the wheels' angle."""
    nodes = [
        helper.make_node("Cast", ["image"], ["cast"], to=TensorProto.FLOAT),
        helper.make_node("Flatten", ["cast"], ["flat"]),
        helper.make_node("MatMul", ["flat", "w"], ["out"]),
    ]
    tensors = [numpy_helper.from_array(weights.reshape(-1, 1).astype(np.float32), "w")]
    return write(path, nodes, tensors=tensors, steering="rad", **more)


def endless(path: Path) -> Path:
    """A model that adds a number to itself, again and again, if the image is not black."""
    scalar = helper.make_tensor_value_info
    body = helper.make_graph(
        [
            helper.make_node("Identity", ["again"], ["and_again"]),
            helper.make_node("Add", ["value", "value"], ["twice"]),
        ],
        "body",
        [
            scalar("i", TensorProto.INT64, []),
            scalar("again", TensorProto.BOOL, []),
            scalar("value", TensorProto.FLOAT, []),
        ],
        [scalar("and_again", TensorProto.BOOL, []), scalar("twice", TensorProto.FLOAT, [])],
    )
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "often"], ["count"]),
        helper.make_node("Cast", ["count"], ["times"], to=TensorProto.INT64),
        helper.make_node("Loop", ["times", "true", "mean"], ["out"], body=body),
    ]
    tensors = [
        numpy_helper.from_array(np.array(1 << 60, dtype=np.float32), "often"),
        numpy_helper.from_array(np.array(True), "true"),
    ]
    return write(path, nodes, tensors=tensors)


def endless_to_load(path: Path) -> Path:
    """A model of constants: multiplying the matrices takes hours, and needs no image."""
    n, steps = 3000, 3000
    ones = numpy_helper.from_array(np.ones(1, dtype=np.float32))
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["m0"], value=ones),
        *(helper.make_node("MatMul", [f"m{i}", "m0"], [f"m{i + 1}"]) for i in range(steps)),
        helper.make_node("ReduceMean", [f"m{steps}"], ["out"], keepdims=0),
    ]
    return write(path, nodes, tensors=[numpy_helper.from_array(np.array([n, n]), "shape")])


def with_weights_in(path: Path, other: str) -> Path:
    """A model whose weights lie in another file."""
    tensor = numpy_helper.from_array(np.zeros(3, dtype=np.float32), "w")
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", other
    nodes = [helper.make_node("Identity", ["w"], ["out"])]
    return write(path, nodes, tensors=[tensor])
