"""A model of the driver's speed, learnt from the campaign's drives: a small neural network.

Where a road differs from a driven one, the driver will be faster or slower. One hidden layer on the
curvatures from 60 m behind a place to 60 m ahead of it predicts by how much, to better than 1 m/s
after 30 drives. Failures are told apart by speed as much as by shape.

=============  ========  =========================================================================
symbol         shape     meaning
=============  ========  =========================================================================
``x``          (15,)     inputs at a place: curvatures, the way from the road's start
``weights``    (273,)    (15, 16) of the hidden layer, its (16,) biases, (16,) and 1 of the output
``moments``    (2, 273)  Adam's running means of the gradient and of its square
=============  ========  =========================================================================

The activation is x / (1 + |x|), which every machine rounds alike, compiled or not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

if TYPE_CHECKING:
    import numpy.typing as npt

    from frenetic.search.records import Trace

# All values are ours.
_AROUND = 6  # curvatures in either direction
_SPACING = 10.0  # [m] between two curvatures
_INPUTS = 2 * _AROUND + 3
_HIDDEN = 16  # neurons of the hidden layer
# Indices of the weights:
_BIASES = _INPUTS * _HIDDEN
_OUTPUT = _BIASES + _HIDDEN
_OFFSET = _OUTPUT + _HIDDEN
_SIZE = _OFFSET + 1

_USUAL_SPEED, _SPEED_SPREAD = 14.0, 4.0  # [m/s], by which the output is scaled
_SHARP = 0.04  # [1/m], curvature that makes an input 1

_SAMPLED = 5.0  # [m] of road between two samples of a drive
_ROOM = 16_384  # last samples that are learnt from
_BATCH = 32  # samples in a step
_STEPS = 6  # of training after each drive
_FIRST_STEPS = 300  # of training before the first use
_FIRST = 20  # drives before the first use
_RATE, _DECAY, _SQUARE_DECAY = 3e-3, 0.9, 0.999  # of Adam


@njit()
def _inputs(curvatures: FloatArray, step: float, s: float, x: FloatArray) -> None:
    last = len(curvatures) - 1
    for i in range(2 * _AROUND + 1):
        at = (s + (i - _AROUND) * _SPACING) / step
        value = 0.0
        if 0.0 <= at <= last:
            k = min(int(at), last - 1)
            value = curvatures[k] + (at - k) * (curvatures[k + 1] - curvatures[k])
        x[i] = value / _SHARP
    way = max(s, 0.0)
    x[_INPUTS - 2] = min(way, 120.0) / 60.0 - 1.0
    x[_INPUTS - 1] = 30.0 / (30.0 + way)


@njit()
def _hidden(weights: FloatArray, x: FloatArray, h: FloatArray) -> float:
    """Return the output; fill `h` with the activations."""
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


@njit()
def predict(
    weights: FloatArray, curvatures: FloatArray, step: float, first: float, out: FloatArray
) -> None:
    """Fill `out` with speeds in m/s, from `first` m along a road on, every 2.5 m."""
    x, h = np.empty(_INPUTS), np.empty(_HIDDEN)
    for k in range(len(out)):
        _inputs(curvatures, step, first + 2.5 * k, x)
        out[k] = _USUAL_SPEED + _SPEED_SPREAD * _hidden(weights, x, h)


@njit()
def _sample(
    curvatures: FloatArray,
    step: float,
    along: FloatArray,
    speeds: FloatArray,
    inputs: FloatArray,
    targets: FloatArray,
    count: int,
) -> int:
    """Keep the samples of a drive in a ring; return the number of all samples so far."""
    s = max(along[0], 0.0) + _SAMPLED
    i = 0
    while s < along[-1]:
        while along[i + 1] < s:
            i += 1
        share = (s - along[i]) / (along[i + 1] - along[i])
        row = count % _ROOM
        _inputs(curvatures, step, s, inputs[row])
        targets[row] = (
            speeds[i] + share * (speeds[i + 1] - speeds[i]) - _USUAL_SPEED
        ) / _SPEED_SPREAD
        count += 1
        s += _SAMPLED
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
    """Take a step of Adam for each row of `batches`, (k, m) numbers of samples."""
    h, g = np.empty(_HIDDEN), np.empty(_SIZE)
    for k in range(len(batches)):
        g[:] = 0.0
        for row in batches[k]:
            x = inputs[row]
            error = (_hidden(weights, x, h) - targets[row]) / len(batches[k])
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
            root = math.sqrt(moments[1, i] / (1.0 - powers[1])) + 1e-8
            weights[i] -= _RATE * moments[0, i] / (1.0 - powers[0]) / root


class SpeedModel:
    """A model of a driver's speed on roads.

    Args:
        rng: Draws the first weights and the samples that are learnt from.

    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self.weights = np.zeros(_SIZE)
        """Weights of the network, (273,), see the module's table."""
        self.weights[:_BIASES] = rng.uniform(-1.0, 1.0, _BIASES) * math.sqrt(3.0 / _INPUTS)
        self.weights[_OUTPUT:_OFFSET] = rng.uniform(-1.0, 1.0, _HIDDEN) * math.sqrt(3.0 / _HIDDEN)
        self._moments = np.zeros((2, _SIZE))
        self._inputs = np.empty((_ROOM, _INPUTS))
        self._targets = np.empty(_ROOM)
        self._powers = np.ones(2)  # of Adam's decays
        self._samples = self._drives = 0

    @property
    def is_ready(self) -> bool:
        """Whether the model has learnt enough to be of use."""
        return self._drives >= _FIRST

    def learn(self, curvatures: FloatArray, step: float, trace: Trace) -> None:
        """Learn from a drive of a road of (N,) curvatures in 1/m, `step` m apart."""
        if len(trace.distance) < 2:
            return
        along = np.maximum.accumulate(trace.distance)
        self._samples = _sample(
            curvatures, step, along, trace.speed, self._inputs, self._targets, self._samples
        )
        self._drives += 1
        if self._drives < _FIRST or self._samples < _BATCH:
            return
        steps = _FIRST_STEPS if self._drives == _FIRST else _STEPS
        count = min(self._samples, _ROOM)
        batches = self._rng.integers(0, count, (steps, _BATCH))
        _train(self.weights, self._moments, self._powers, self._inputs, self._targets, batches)
