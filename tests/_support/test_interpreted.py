"""The first calls of a kernel, in Python."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from frenetic._support import interpreted
from frenetic._support.interpreted import is_interpreted, without_compiling

KERNELS = """
from frenetic._support.compiled import njit

SCALE = 3.0

@njit()
def scaled(value):
    return SCALE * value

@njit(interpret_first={seconds})
def total(values):
    result, count = 0.0, 0
    for value in values:
        result += scaled(value)
        count += 1
    return result, count > 2, count

@njit(error_model="numpy", interpret_first={seconds})
def invert(values, counts):
    counts[0] += 1
    for i in range(len(values)):
        values[i] = 1.0 / float(values[i])
    return len(values)
"""

LoadKernels = Callable[[float], Any]


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> LoadKernels:
    """A function that imports the kernels anew, for which compiling is to take some seconds."""
    mode = interpreted._Mode()
    monkeypatch.setattr(interpreted, "_MODE", mode)

    def load_kernels(seconds: float) -> ModuleType:
        path = tmp_path / "kernels.py"
        text = KERNELS.format(seconds=seconds)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
        spec = importlib.util.spec_from_file_location("kernels", path)
        assert spec
        assert spec.loader
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load_kernels


VALUES = np.array([0.1, 0.2, 0.7])


def test_nothing_is_compiled_for_the_first_calls(load: LoadKernels) -> None:
    kernels = load(1e9)
    assert is_interpreted(kernels.total)
    results = [kernels.total(VALUES) for _ in range(3)]
    assert not kernels.total.signatures
    assert not kernels.scaled.signatures
    interpreted.end_interpretation()
    assert not is_interpreted(kernels.total)
    assert results == 3 * [kernels.total(VALUES)]
    assert len(kernels.total.signatures) == 1


def test_a_kernel_is_compiled_once_its_calls_have_taken_as_long(load: LoadKernels) -> None:
    kernels = load(1e-9)
    first = kernels.total(VALUES)
    assert not kernels.total.signatures
    assert kernels.total(VALUES) == first
    assert len(kernels.total.signatures) == 1


def test_a_kernel_on_disk_is_loaded_at_its_first_call(load: LoadKernels) -> None:
    kernels = load(1e-9)
    for _ in range(2):
        kernels.total(VALUES)
    kernels = load(1e-9)
    kernels.total(VALUES)
    assert sum(kernels.total.stats.cache_hits.values()) == 1


def test_nothing_is_compiled_or_loaded_while_a_call_is_timed(load: LoadKernels) -> None:
    kernels = load(1e-9)
    with without_compiling():
        for _ in range(3):
            kernels.total(VALUES)
        assert not kernels.total.signatures
    kernels.total(VALUES)
    assert kernels.total.signatures


def test_results_have_the_types_of_compiled_code(load: LoadKernels) -> None:
    kernels = load(1e9)
    assert [type(part) for part in kernels.total(VALUES)] == [float, bool, int]


def test_where_python_raises_the_compiled_form_counts(load: LoadKernels) -> None:
    kernels = load(1e9)
    values, counts = np.array([4.0, 0.0, 2.0]), np.zeros(1, np.int64)
    assert kernels.invert(values, counts) == 3
    assert values.tolist() == [0.25, math.inf, 0.5]
    assert counts.tolist() == [1]
    assert kernels.invert.signatures
