"""Models in ONNX files, executed by the package onnxruntime.

A model is data: onnxruntime brings its operators, and the file itself holds its weights. It runs on
one thread of the processor, so its answers repeat on the same machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.files import open_file
from frenetic._support.words import pip_install
from frenetic.errors import FreneticError, describe_error

_NO_FOLDER: Final = "no folder: a model's weights are in its own file"
"""Folder of further files with weights: none exists by this name, and messages show it."""
_FATAL: Final = 4
"""Least severity of events in onnxruntime's own log; errors are raised as well."""

Shape: TypeAlias = tuple[int | None, ...]
"""Sizes of an array's axes; None where the file leaves a size open."""


class OnnxModel:
    """A loaded ONNX model.

    Args:
        data: content of the model's file.

    Raises:
        FreneticError: onnxruntime is not installed.
        ValueError: onnxruntime cannot load the data, or an input is no tensor of float32.
    """

    def __init__(self, data: bytes) -> None:
        try:
            import onnxruntime  # of the extra "neural"
        except ImportError as error:
            raise FreneticError(
                f"a neural network needs onnxruntime: {pip_install('neural')}"
            ) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = _FATAL
        # Weights in other files would come from any current folder, and no version covers them.
        options.add_session_config_entry(
            "session.model_external_initializers_file_folder_path", _NO_FOLDER
        )
        try:
            self._session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime raises several classes of its own
            raise ValueError(_reason(error)) from None
        self.inputs: Mapping[str, Shape] = _shapes(self._session.get_inputs())
        """Name of an input -> shape of its array."""
        self.outputs: Mapping[str, Shape] = _shapes(self._session.get_outputs())
        """Name of an output -> shape of its array; ``()`` if the file does not say it."""
        for tensor in self._session.get_inputs():
            if tensor.type != "tensor(float)":
                name = f" {tensor.name}" if len(self.inputs) > 1 else ""
                raise ValueError(f"its input{name} is a {tensor.type}: tensor(float) is needed")

    @property
    def metadata(self) -> dict[str, str]:
        """Entries that the file's author wrote: name -> value."""
        return dict(self._session.get_modelmeta().custom_metadata_map)

    def run(self, inputs: Mapping[str, npt.NDArray[np.float32]]) -> dict[str, FloatArray]:
        """Compute the outputs and return them: name -> array, in the file's order.

        Args:
            inputs: name of an input -> its array.

        Raises:
            ValueError: onnxruntime cannot compute the outputs.
        """
        try:
            outputs = self._session.run(None, dict(inputs))
            arrays = (np.asarray(output, dtype=np.float64) for output in outputs)
            return dict(zip(self.outputs, arrays, strict=True))
        except Exception as error:  # onnxruntime raises its own classes; an output may be no array
            raise ValueError(f"it cannot be computed: {describe_error(error)}") from None


def _shapes(values: Sequence[Any]) -> dict[str, Shape]:
    """Return the shapes of a session's inputs or outputs: name -> shape."""
    return {
        value.name: tuple(
            size if isinstance(size, int) and size > 0 else None for size in value.shape
        )
        for value in values
    }


def shown_shape(shape: Sequence[int | None]) -> str:
    """Return a shape as a text, such as ``(any, 3, 66, 200)``."""
    return f"({', '.join('any' if size is None else str(size) for size in shape)})"


def read_model(path: str) -> bytes:
    """Return the content of a model's file.

    Raises:
        ValueError: the file is missing or cannot be read.
    """
    try:
        with open_file(Path(path).expanduser()) as file:
            return file.read()
    except FileNotFoundError:
        raise ValueError(f"there is no file {path!r}") from None
    except OSError as error:
        raise ValueError(f"it cannot be read: {error.strerror or error}") from None


def _reason(error: Exception) -> str:
    """Return why onnxruntime cannot load a file, in plain words for common mistakes."""
    text = describe_error(error)
    if "INVALID_PROTOBUF" in text or "No graph was found" in text:
        return "it is no ONNX model"
    if "xternal" in text:
        return (
            "it keeps weights in another file: export it as one file (torch.onnx.export(...,"
            " external_data=False))"
        )
    if "is not a registered function/op" in text:
        name = text.rpartition(": ")[2].partition("(")[0]
        return f"its operator {name} is not one of onnxruntime's, and none is loaded from elsewhere"
    return f"onnxruntime cannot load it: {text}"
