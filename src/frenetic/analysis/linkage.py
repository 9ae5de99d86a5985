"""Average linkage of many vectors, such as failures, in batches.

Of more than `BATCH` different vectors, the ones with the lowest ranks are linked first. Then each
other vector joins the cluster from whose members its root mean square difference is least, if that
difference is at most the threshold. The next `BATCH` of the remaining vectors follow.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray

BATCH: Final = 3000
"""Largest number of vectors linked at a time (our choice); time and memory grow with the square."""


def link(vectors: FloatArray, ranks: FloatArray, threshold: float) -> IntArray:
    """Return the number of the cluster of each of (n, m) vectors, (n,), from 0 without a gap.

    Args:
        vectors: (n, m) vectors, of which some may be equal.
        ranks: (n,) numbers; the vectors with the lowest are linked first.
        threshold: largest root mean square difference at which clusters are joined.
    """
    different, row_of = different_rows(vectors)
    lowest = np.full(len(different), np.inf)
    np.minimum.at(lowest, row_of, ranks)
    labels = np.full(len(different), -1, dtype=np.int64)
    waiting = np.argsort(lowest, kind="stable")
    while len(waiting):
        # Sorted, so that ties do not depend on the order of the vectors.
        batch, waiting = np.sort(waiting[:BATCH]), waiting[BATCH:]
        first_label = labels.max() + 1
        linked = _link_batch(different[batch], threshold)
        labels[batch] = first_label + linked
        nearest = _nearest_cluster(different[waiting], different[batch], linked, threshold)
        joins = nearest >= 0
        labels[waiting[joins]] = first_label + nearest[joins]
        waiting = waiting[~joins]
    vector_labels: IntArray = labels[row_of]
    return vector_labels


def different_rows(vectors: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the different ones of (n, m) vectors, (k, m), and the row of each vector, (n,)."""
    # Adding 0 makes negative zeros positive, so that equal vectors have equal bytes.
    different, row_of = np.unique(vectors + 0.0, axis=0, return_inverse=True)
    return different, row_of.ravel()


def join_differences(vectors: FloatArray) -> FloatArray:
    """Return the root mean square differences at which clusters are joined, (n - 1,) ascending.

    Args:
        vectors: (n, m) different vectors, at least one; at first each is a cluster.
    """
    differences: FloatArray = np.sqrt(np.sort(_tree(vectors)[:, 2]))
    return differences


def _link_batch(vectors: FloatArray, threshold: float) -> IntArray:
    """Return the number of the cluster of each of (n, m) different vectors, (n,), from 0."""
    from scipy.cluster.hierarchy import fcluster  # slow to import

    if len(vectors) == 1:
        return np.zeros(1, dtype=np.int64)
    labels = fcluster(_tree(vectors), threshold**2, "distance")
    return labels.astype(np.int64) - 1  # scipy counts from 1


def _tree(vectors: FloatArray) -> FloatArray:
    """Return scipy's average linkage of the square differences of (n, m) vectors, (n - 1, 4).

    The third column holds the mean square difference at which two clusters are joined.
    """
    from scipy.cluster.hierarchy import linkage  # slow to import
    from scipy.spatial.distance import pdist

    if len(vectors) == 1:
        return np.empty((0, 4))
    tree: FloatArray = linkage(pdist(vectors, "sqeuclidean"), "average")
    return tree


def _nearest_cluster(
    vectors: FloatArray, members: FloatArray, labels: IntArray, threshold: float
) -> IntArray:
    """Return the cluster nearest to each of (k, m) vectors, (k,); -1 beyond the threshold.

    The mean square difference of a vector from a cluster's members is its square difference from
    their mean plus their variance.

    Args:
        vectors: (k, m) vectors without a cluster.
        members: (n, m) vectors of the clusters' members.
        labels: (n,) numbers of the members' clusters.
        threshold: see `link`.
    """
    counts = np.bincount(labels)
    means = np.zeros((len(counts), members.shape[1]))
    np.add.at(means, labels, members)
    means /= counts[:, None]
    variances = np.bincount(labels, ((members - means[labels]) ** 2).sum(axis=1)) / counts
    nearest = np.full(len(vectors), -1, dtype=np.int64)
    for i, vector in enumerate(vectors):
        squares = ((means - vector) ** 2).sum(axis=1) + variances
        least = int(squares.argmin())
        if squares[least] <= threshold**2:
            nearest[i] = least
    return nearest
