"""A model of the driver's speed, learnt from the campaign's drives: a small neural network.

Speed tells failures apart as much as the road's shape. Where a child's road differs from its
parent's, the driver is faster or slower; the model predicts by how much. A hidden layer takes the
curvatures from 60 m before a place to 60 m after it. After 30 drives the error is below 1 m/s.

=============  ========  =========================================================================
symbol         shape     meaning
=============  ========  =========================================================================
``x``          (15,)     inputs at a place: 13 curvatures, and 2 of the distance from the start
``h``          (16,)     activations of the hidden layer
``weights``    (273,)    (15, 16) of the hidden layer, its (16,) biases, (16,) and 1 of the output
``g``          (273,)    gradient of the error by the weights
``moments``    (2, 273)  Adam's running means of the gradient and of its square
``powers``     (2,)      powers of Adam's two decays, by which the running means are corrected
=============  ========  =========================================================================

The activation is x / (1 + |x|), which every machine rounds alike, compiled or not. Adam is the
method of D. P. Kingma and J. Ba, "Adam: A method for stochastic optimization", ICLR 2015.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit
from frenetic.search.approach import SPACING

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.search.records import Trace

# The values are our choice.
_EACH_WAY = 6  # curvatures before the place, and after it
_CURVATURE_SPACING = 10.0  # [m] between two of these curvatures
_CURVATURES = 2 * _EACH_WAY + 1
_INPUTS = _CURVATURES + 2
_HIDDEN = 16  # neurons of the hidden layer
# First indices of the parts of the weights after the hidden layer's, and their number.
_BIASES = _INPUTS * _HIDDEN
_OUTPUT = _BIASES + _HIDDEN
_OFFSET = _OUTPUT + _HIDDEN
_SIZE = _OFFSET + 1

_USUAL_SPEED, _SPEED_SPREAD = 14.0, 4.0  # [m/s] offset and scale of the output
_SHARP = 0.04  # [1/m] curvature that makes an input 1

_SAMPLE_SPACING = 5.0  # [m] of road between two samples of a drive
_MEMORY = 16_384  # most recent samples from which the model learns
_BATCH_SIZE = 32  # samples in a step of training
_STEPS = 6  # steps of training after each drive
_FIRST_STEPS = 300  # steps of training before the first use
_MIN_DRIVES = 20  # drives before the first use
_LEARNING_RATE, _DECAY, _SQUARE_DECAY = 3e-3, 0.9, 0.999  # Adam's; the decays are as published
_EPSILON = 1e-8  # Adam's, as published: it keeps a step finite


@njit()
def _fill_inputs(curvatures: FloatArray, step: float, s: float, x: FloatArray) -> None:
    """Fill `x` with the inputs at `s` m along a road; curvatures beyond its ends count as 0."""
    last = len(curvatures) - 1
    for i in range(_CURVATURES):
        at = (s + (i - _EACH_WAY) * _CURVATURE_SPACING) / step
        value = 0.0
        if 0.0 <= at <= last:
            k = min(int(at), last - 1)
            value = curvatures[k] + (at - k) * (curvatures[k + 1] - curvatures[k])
        x[i] = value / _SHARP
    # The car starts at rest: up to 120 m the distance from the start counts, above all at first.
    driven = max(s, 0.0)
    x[_INPUTS - 2] = min(driven, 120.0) / 60.0 - 1.0
    x[_INPUTS - 1] = 30.0 / (30.0 + driven)


@njit()
def _output(weights: FloatArray, x: FloatArray, h: FloatArray) -> float:
    """Return the output of the network; fill `h` with the activations."""
    for j in range(_HIDDEN):
        h[j] = weights[_BIASES + j]
    for i in range(_INPUTS):
        value = x[i]
        for j in range(_HIDDEN):
            h[j] += value * weights[i * _HIDDEN + j]
    y: float = weights[_OFFSET]
    for j in range(_HIDDEN):
        h[j] = h[j] / (1.0 + abs(h[j]))
        y += h[j] * weights[_OUTPUT + j]
    return y


@njit(interpret_first=0.4)
def predict(
    weights: FloatArray, curvatures: FloatArray, step: float, first: float, out: FloatArray
) -> None:
    """Predict speeds along a road, every `SPACING` m.

    Args:
        weights: See `SpeedModel.weights`.
        curvatures: Curvatures of the road, (n,) in 1/m.
        step: Distance between two curvatures, in m.
        first: Distance along the road to the first speed, in m.
        out: Room for the speeds, in m/s.
    """
    x, h = np.empty(_INPUTS), np.empty(_HIDDEN)
    for k in range(len(out)):
        _fill_inputs(curvatures, step, first + SPACING * k, x)
        out[k] = _USUAL_SPEED + _SPEED_SPREAD * _output(weights, x, h)


@njit(interpret_first=0.4)
def _sample(
    curvatures: FloatArray,
    step: float,
    along: FloatArray,
    speeds: FloatArray,
    inputs: FloatArray,
    targets: FloatArray,
    count: int,
) -> int:
    """Sample a drive into a ring of inputs and targets; return the number of all samples so far.

    Args:
        curvatures: Curvatures of the road, (n,) in 1/m.
        step: Distance between two curvatures, in m.
        along: Distances along the road, record by record, in m; they never decrease.
        speeds: Speeds, record by record, in m/s.
        inputs: Ring of inputs, (memory, inputs).
        targets: Ring of speeds as the network's output, (memory,).
        count: Number of all samples before this drive.
    """
    s = max(along[0], 0.0) + _SAMPLE_SPACING
    i = 0
    while s < along[-1]:
        while along[i + 1] < s:
            i += 1
        share = (s - along[i]) / (along[i + 1] - along[i])
        row = count % _MEMORY
        _fill_inputs(curvatures, step, s, inputs[row])
        targets[row] = (
            speeds[i] + share * (speeds[i + 1] - speeds[i]) - _USUAL_SPEED
        ) / _SPEED_SPREAD
        count += 1
        s += _SAMPLE_SPACING
    return count


@njit()
def _train(
    weights: FloatArray,
    moments: FloatArray,
    powers: FloatArray,
    inputs: FloatArray,
    targets: FloatArray,
    batches: npt.NDArray[np.int64],
) -> None:
    """Take a step of Adam for each row of `batches`, (steps, m) indices of samples."""
    h, g = np.empty(_HIDDEN), np.empty(_SIZE)
    for k in range(len(batches)):
        g[:] = 0.0
        for row in batches[k]:
            x = inputs[row]
            error = (_output(weights, x, h) - targets[row]) / len(batches[k])
            # Backwards through the network; h becomes the gradient by the hidden layer's sums.
            g[_OFFSET] += error
            for j in range(_HIDDEN):
                g[_OUTPUT + j] += error * h[j]
                slope = 1.0 - abs(h[j])
                h[j] = error * weights[_OUTPUT + j] * slope * slope
                g[_BIASES + j] += h[j]
            for i in range(_INPUTS):
                value = x[i]
                for j in range(_HIDDEN):
                    g[i * _HIDDEN + j] += value * h[j]
        powers[0] *= _DECAY
        powers[1] *= _SQUARE_DECAY
        for i in range(_SIZE):
            moments[0, i] += (1.0 - _DECAY) * (g[i] - moments[0, i])
            moments[1, i] += (1.0 - _SQUARE_DECAY) * (g[i] * g[i] - moments[1, i])
            root = math.sqrt(moments[1, i] / (1.0 - powers[1])) + _EPSILON
            weights[i] -= _LEARNING_RATE * moments[0, i] / (1.0 - powers[0]) / root


class SpeedModel:
    """A model of a driver's speed along roads.

    Args:
        rng: Generator that draws the first weights and the samples of each training step.

    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.weights = np.zeros(_SIZE)
        """Weights of the network, (273,), see the module's table."""
        self.weights[:_BIASES] = rng.uniform(-1.0, 1.0, _BIASES) * math.sqrt(3.0 / _INPUTS)
        self.weights[_OUTPUT:_OFFSET] = rng.uniform(-1.0, 1.0, _HIDDEN) * math.sqrt(3.0 / _HIDDEN)
        self._moments = np.zeros((2, _SIZE))
        self._inputs = np.empty((_MEMORY, _INPUTS))
        self._targets = np.empty(_MEMORY)
        self._powers = np.ones(2)
        self._samples = self._drives = 0  # numbers of all samples and drives so far

    @property
    def is_ready(self) -> bool:
        """Whether the model has learnt enough to be of use."""
        return self._drives >= _MIN_DRIVES

    def learn(self, curvatures: FloatArray, step: float, trace: Trace) -> None:
        """Learn from a drive along a road with (N,) curvatures in 1/m, `step` m apart."""
        if len(trace.distance) < 2:
            return
        along = np.maximum.accumulate(trace.distance)
        self._samples = _sample(
            curvatures, step, along, trace.speed, self._inputs, self._targets, self._samples
        )
        self._drives += 1
        if self._drives < _MIN_DRIVES or self._samples < _BATCH_SIZE:
            return
        steps = _FIRST_STEPS if self._drives == _MIN_DRIVES else _STEPS
        remembered = min(self._samples, _MEMORY)
        batches = self._rng.integers(0, remembered, (steps, _BATCH_SIZE))
        _train(self.weights, self._moments, self._powers, self._inputs, self._targets, batches)
