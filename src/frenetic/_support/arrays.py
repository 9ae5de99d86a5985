"""The array type of all packages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import TypeAlias

    import numpy.typing as npt

    FloatArray: TypeAlias = npt.NDArray[np.float64]
    """Float64 array; docstrings give the shape."""
else:
    # What the competition's pipeline is pinned to, numpy 1.19 on Python 3.9, has no more than this.
    FloatArray = np.ndarray
