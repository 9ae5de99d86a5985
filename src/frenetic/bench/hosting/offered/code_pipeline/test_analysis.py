"""The competition's features of a test, mistakes included.

They cover the whole road and the whole drive, as in the pipeline. The tables of its reports cover
the failure's segment only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray

_STRAIGHT: Final = 1e-6  # m2: less than this, and three points count as collinear
_FEWEST_RECORDS: Final = 3  # from which features of a drive are computed

Feature = tuple[str, float]
"""Its name and its value."""


def compute_all_features(the_test: Any, execution_data: Sequence[Any]) -> dict[str, float]:
    """Return the features by name; those of the drive only if it has three records or more.

    Args:
        the_test: a road test, or a list of its interpolated points.
        execution_data: records of its drive.

    Raises:
        RoadError: No line passes through the road points.

    """
    features = [max_curvature(the_test), direction_coverage(the_test)]
    if len(execution_data) >= _FEWEST_RECORDS:
        features += [
            sd_steering(execution_data),
            mean_lateral_position(execution_data),
            max_lateral_position(execution_data),
        ]
    return dict(features)


def max_curvature(the_test: Any, w: int = 5) -> Feature:
    """Return MAX_CURV, 1/m: one over the radius of the smallest circle through three points.

    These are the first, the middle and the last of ``w`` consecutive interpolated points; the last
    such window is left out. A straight road has 0.

    Args:
        the_test: a road test, or a list of its interpolated points.
        w: points of a window.

    Raises:
        RoadError: No line passes through the road points.

    """
    points = _points(the_test)
    windows = max(0, len(points) - w)
    first, middle, last = (points[i : i + windows] for i in (0, (w - 1) // 2, w - 1))
    to_middle, to_last = middle - first, last - middle
    area = to_middle[:, 0] * to_last[:, 1] - to_last[:, 0] * to_middle[:, 1]  # m2, of two triangles
    area = np.where(np.abs(area) < _STRAIGHT, 0.0, np.abs(area))
    sides = [np.hypot(*side.T) for side in (to_middle, to_last, last - first)]
    product = sides[0] * sides[1] * sides[2]
    curvatures = 2.0 * area / np.where(area > 0.0, product, 1.0)
    return "MAX_CURV", float(curvatures.max(initial=0.0))


def direction_coverage(the_test: Any, n_bins: int = 25) -> Feature:
    """Return DIR_COV: the share of bins of the angle to north that the road passes through.

    The bins divide 360 degrees, of which the angle never exceeds 180, and the share is one of the
    bins' edges.

    Args:
        the_test: a road test, or a list of its interpolated points.
        n_bins: bins.

    Raises:
        RoadError: No line passes through the road points.

    """
    steps = np.diff(_points(the_test), axis=0)
    with np.errstate(invalid="ignore"):  # a step of no length has no direction: a bin of its own
        angles = np.degrees(np.arccos(steps[:, 1] / np.hypot(steps[:, 0], steps[:, 1])))
    return "DIR_COV", _share(angles, np.linspace(0.0, 360.0, n_bins + 1))


def direction_coverage_klk(the_test: Any, n_bins: int = 36) -> Feature:
    """Return DIR_COV in the pipeline's other form: of the angle to +x, -180 to 180 degrees.

    Args:
        the_test: a road test, or a list of its interpolated points.
        n_bins: edges of bins.

    Raises:
        RoadError: No line passes through the road points.

    """
    steps = np.diff(_points(the_test), axis=0)
    angles = np.arctan2(steps[:, 1], steps[:, 0])
    return "DIR_COV", _share(angles, np.linspace(-np.pi, np.pi, n_bins))


def sd_steering(execution_data: Sequence[Any]) -> Feature:
    """Return STD_SA, standard deviation of `steering`."""
    return "STD_SA", float(np.std([record.steering for record in execution_data]))


def mean_lateral_position(execution_data: Sequence[Any]) -> Feature:
    """Return MEAN_LP, mean oob distance in m."""
    return "MEAN_LP", float(np.mean([record.oob_distance for record in execution_data]))


def max_lateral_position(execution_data: Sequence[Any]) -> Feature:
    """Return MAX_LP, largest oob distance in m: where the car was closest to the lane's centre."""
    return "MAX_LP", float(np.max([record.oob_distance for record in execution_data]))


def _points(the_test: Any) -> FloatArray:
    """The interpolated points, (N, 2) in m."""
    points = the_test if isinstance(the_test, (list, np.ndarray)) else the_test.interpolated_points
    return np.array([(point[0], point[1]) for point in points], dtype=np.float64).reshape(-1, 2)


def _share(angles: FloatArray, edges: FloatArray) -> float:
    return len(set(np.digitize(angles, edges).tolist())) / len(edges)
