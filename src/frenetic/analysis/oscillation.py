"""How often a driver turns its steering back, and how it sways about its lane's centre."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.compiled import njit

REVERSAL_GAP: Final = 0.2
"""Least angle of the front wheels between two turning points that count as a reversal, in degrees;
about 3 degrees at a steering wheel with a ratio of 16 to 1, a usual gap of SAE J2944's steering
reversal rate."""
MIN_PERIODS: Final = 3.0
"""Fewest periods of a sway within a drive; our choice."""
MAX_FREQUENCY: Final = 2.0
"""Highest frequency of a sway, in Hz; our choice."""
MIN_FREQUENCY: Final = 0.1
"""Lowest frequency of a sway, in Hz; slower movements follow the road; our choice."""
PEAK_SHARE: Final = 0.5
"""Least share that a peak holds of the power from `MIN_FREQUENCY` on, for it to be a sway; our
choice."""
_LOBE: Final = 2
"""Number of frequencies on either side of a peak that belong to it: the main lobe of Hann's window
spans two on either side."""


class Sway(NamedTuple):
    """The dominant oscillation of a signal."""

    frequency: float
    """Frequency in Hz."""
    amplitude: float
    """Amplitude, half of the way from side to side, in the signal's unit."""


@njit(error_model="numpy", interpret_first=0.5)
def reversals(values: FloatArray, gap: float) -> int:
    """Return how often a signal turns back by at least a gap.

    The signal's direction is the first in which it has moved by the gap. It reverses when the
    signal comes back from its farthest point in this direction by the gap.

    Args:
        values: the signal, (n,).
        gap: smallest way back that counts, in the signal's unit.
    """
    count, direction = 0, 0
    if not len(values):
        return count
    low = high = values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
        if direction >= 0 and high - value >= gap:
            count += direction
            direction = -1
            low = high = value
        elif direction <= 0 and value - low >= gap:
            count -= direction
            direction = 1
            low = high = value
    return count


def dominant_sway(time: FloatArray, values: FloatArray) -> Sway | None:
    """Return the dominant oscillation of a signal; None if no frequency stands out.

    The signal has the frequency of the highest peak in its spectrum, without its linear trend,
    under Hann's window. The peak must hold `PEAK_SHARE` of the power, and its frequency must
    be at most `MAX_FREQUENCY` and fit `MIN_PERIODS` times into the drive.

    Args:
        time: times of the records, (n,) in s, which increase strictly.
        values: the signal, (n,).
    """
    n = len(time)
    if n < 2 * _LOBE + 4:
        return None
    duration = float(time[-1] - time[0])
    even = np.linspace(time[0], time[-1], n)
    signal = np.interp(even, time, values)
    signal = signal - np.polyval(np.polyfit(even - even[0], signal, 1), even - even[0])
    window = np.hanning(n)
    power = np.abs(np.fft.rfft(signal * window)) ** 2
    spacing = (n - 1) / (n * duration)  # of the frequencies, in Hz
    first = max(int(np.ceil(max(MIN_FREQUENCY, MIN_PERIODS / duration) / spacing)), 1)
    last = min(int(MAX_FREQUENCY / spacing), len(power) - 2)
    if last < first or not power[first:].any():
        return None
    peak = first + int(np.argmax(power[first : last + 1]))
    lobe = slice(max(peak - _LOBE, 0), peak + _LOBE + 1)
    lobe_power = float(power[lobe].sum())
    is_summit = power[peak] >= power[peak - 1] and power[peak] >= power[peak + 1]
    if not is_summit or lobe_power < PEAK_SHARE * float(power[first:].sum()):
        return None
    frequency = float((power[lobe] * np.arange(len(power))[lobe]).sum()) / lobe_power * spacing
    # By Parseval's theorem, of a sine under the window.
    amplitude = 2.0 * np.sqrt(lobe_power / (n * float((window**2).sum())))
    return Sway(frequency, float(amplitude))
