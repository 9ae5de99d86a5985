"""Models in ONNX files, executed by onnxruntime, an extra.

A model is data: its operators are those that the runtime brings, its weights are in the file
itself. It runs on one thread of the processor, so it answers alike each time on the same machine.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from threading import Timer
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic._support.child_processes import ending_of
from frenetic._support.words import pip_install
from frenetic.errors import FreneticError, describe_error

LARGEST: Final = 500_000_000
"""Largest file, in bytes."""
LONGEST: Final = 10.0
"""Longest time for an image when a model is loaded, in s: some never end."""
LONGEST_LOADING: Final = 60.0
"""Longest time for loading an unknown model, in s: onnxruntime calculates constants then."""
_TYPES: Final[Mapping[str, type[np.generic]]] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(uint8)": np.uint8,
}
"""Type of an input -> its elements."""
_NO_FOLDER: Final = "no folder: a model's weights are in its own file"
_FATAL: Final = 4  # onnxruntime's own log shows nothing less; errors are raised as well
_TRIAL: Final = """
import sys
sys.path[:] = sys.argv[1:]
from frenetic.vision.neural.model import Model
Model(sys.stdin.buffer.read())
"""
_RAISED: Final = 1
"""Exit code of a Python that has raised."""


class Model:
    """A model with one input, loaded.

    Args:
        data: content of its file.

    Raises:
        FreneticError: onnxruntime is not installed.
        ValueError: it cannot be loaded.
    """

    def __init__(self, data: bytes) -> None:
        try:
            import onnxruntime  # the extra
        except ImportError as error:
            raise FreneticError(
                f"a neural network needs onnxruntime: {pip_install('neural')}"
            ) from error
        self._runtime = onnxruntime
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.log_severity_level = _FATAL
        # Weights elsewhere would be looked up in the current folder, and be in no fingerprint.
        options.add_session_config_entry(
            "session.model_external_initializers_file_folder_path", _NO_FOLDER
        )
        try:
            self._session = onnxruntime.InferenceSession(
                data, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # of several classes of its own
            raise ValueError(_reason(error)) from None
        inputs = self._session.get_inputs()
        if len(inputs) != 1:
            names = ", ".join(one.name for one in inputs)
            raise ValueError(f"it has {len(inputs)} inputs ({names}): one, the image, is needed")
        if inputs[0].type not in _TYPES:
            raise ValueError(f"its input is a {inputs[0].type}: float, float16 or uint8 is needed")
        self._input: str = inputs[0].name
        self.type = _TYPES[inputs[0].type]
        """Type of the input's elements."""
        self.shape: tuple[int | None, ...] = tuple(
            size if isinstance(size, int) and size > 0 else None for size in inputs[0].shape
        )
        """Shape of the input, None where the file leaves it open."""

    @property
    def metadata(self) -> dict[str, str]:
        """The file's own entries, name -> value."""
        return dict(self._session.get_modelmeta().custom_metadata_map)

    def run(self, image: npt.NDArray[Any], limit: float | None = None) -> FloatArray:
        """All numbers of all outputs, in their order, (n,).

        Args:
            image: the input.
            limit: s after which it is given up; None for no limit.

        Raises:
            ValueError: it cannot be computed, or not in that time.
        """
        options = timer = None
        if limit is not None:
            options = self._runtime.RunOptions()
            options.log_severity_level = _FATAL
            timer = Timer(limit, setattr, (options, "terminate", True))
            timer.start()
        try:
            outputs = self._session.run(None, {self._input: image}, options)
            return np.concatenate([np.asarray(one, dtype=np.float64).ravel() for one in outputs])
        except Exception as error:  # of several classes of its own; or an output is no array
            if options is not None and options.terminate:
                raise ValueError(f"it takes more than {limit:g} s for an image") from None
            raise ValueError(f"it cannot be computed: {describe_error(error)}") from None
        finally:
            if timer is not None:
                timer.cancel()


def read_model(path: str) -> bytes:
    """The content of a model's file.

    Raises:
        ValueError: it cannot be read, or it is too large.
    """
    place = Path(path).expanduser()
    try:
        check_file(place)
        return place.read_bytes()
    except FileNotFoundError:
        raise ValueError(f"there is no file {path!r}") from None
    except OSError as error:
        raise ValueError(f"it cannot be read: {error.strerror or error}") from None


def check_file(place: Path) -> None:
    """Checks that a file may be that of a model; it is not opened for that.

    Raises:
        ValueError: it is no regular file, or too large.
        OSError: it is not there.
    """
    size = place.stat().st_size
    if not place.is_file():
        raise ValueError(f"{place} is no file")
    if size > LARGEST:
        raise ValueError(
            f"it has {size / 1e6:.0f} MB: a model of at most {LARGEST / 1e6:.0f} MB is read"
        )


def check_loading(data: bytes) -> None:
    """Checks that loading a model ends, in a process of its own: onnxruntime cannot be interrupted.

    A model that is refused there is refused here, too, with a reason, so nothing is said about it.

    Args:
        data: content of its file.

    Raises:
        ValueError: loading it does not end in time, or breaks the process.
    """
    try:
        trial = subprocess.run(  # noqa: S603 - our own code, no shell
            [sys.executable or "", "-c", _TRIAL, *sys.path],
            input=data,
            capture_output=True,
            timeout=LONGEST_LOADING,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"loading it takes more than {LONGEST_LOADING:g} s") from None
    except OSError:  # no process can be started here
        return
    if trial.returncode not in (0, _RAISED):
        raise ValueError(f"onnxruntime's process {ending_of(trial.returncode)} while loading it")


def _reason(error: Exception) -> str:
    """The runtime's message about a file, in our words where it is a common one."""
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
