"""Children: roads made from a place of the archive, and the choice of one among several."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.conditions.domain import Domain
from frenetic.road import profile
from frenetic.search.approach import ALIKE
from frenetic.search.archive import Archive
from frenetic.search.conditions import inherit_conditions
from frenetic.search.failing import FailureModel
from frenetic.search.prediction import Foresight, promise_of
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Origin

NEW_DIFFERENCE = ALIKE
"""Least difference from every known failure with which a failure counts as entirely new, in m: what
is new for the search is new for the analysis, too."""
_NEW_GRADE_SHARE = 0.25  # share of children with a new grade, in a road class (our choice)
_LIKELIEST_OF = 6  # children of which the likeliest to fail is chosen (our choice)
_MAX_FORESEEN = 40  # children that foresight looks at for one road (our choice)
_FORESEEN_AT_ONCE = 8  # of these children that it looks at together (our choice)


class Child(NamedTuple):
    """A road that may be proposed, made from a place of the archive: the parent."""

    row: int
    """Row of the parent's place in the archive."""
    operator: int | None
    """Number of the operator, see `variation.OPERATORS`; None for the parent's road in other
    conditions."""
    curvatures: FloatArray
    """Curvatures, (n,) in 1/m."""
    fields: Mapping[str, Any]
    """Further fields of the `Candidate`, such as grade and conditions."""
    side: int
    """Side on which the car is expected to leave its lane, as in `archive.SIDES`."""
    vector: FloatArray | None
    """Approach with which the car is expected to fail, (64,) in m; None for the parent's road in
    other conditions."""


def choose_foreseen(
    children: Iterator[Child], foresight: Foresight, archive: Archive, step: float
) -> Child | None:
    """Return a child that is foreseen to fail differently from every known failure.

    "Differently" is by `NEW_DIFFERENCE`. Foresight looks at some children at once, until there is
    such a child among them. The child is the one of the largest promise, see `promise_of`; None
    without children. It has the side and the approach that are foreseen.

    Args:
        children: Children, which are drawn only as they are looked at.
        foresight: Model of the driver.
        archive: The archive with the known failures.
        step: Distance between two curvatures, in m.
    """
    best, largest = None, -math.inf
    children = islice(children, _MAX_FORESEEN)
    while batch := list(islice(children, _FORESEEN_AT_ONCE)):
        # Candidates for the model alone: they have no id and no origin yet.
        candidates = [
            Candidate(0, child.curvatures, step, Origin(""), **child.fields) for child in batch
        ]
        foreseen = foresight.foresee(candidates)
        for child, candidate, evaluation in zip(batch, candidates, foreseen, strict=True):
            promise, place = promise_of(candidate, evaluation, archive)
            if best is None or promise > largest:
                best, largest = child, promise
                if place is not None:
                    best = child._replace(side=place.side, vector=place.vector)
        if largest >= NEW_DIFFERENCE:
            break
    return best


def choose_likeliest(
    children: Iterator[Child], model: FailureModel, archive: Archive
) -> Child | None:
    """Return the likeliest to fail of the first `_LIKELIEST_OF` children; None without children."""
    return max(
        islice(children, _LIKELIEST_OF),
        key=lambda child: model.chance(features_of_child(child, model, archive)),
        default=None,
    )


def inherited_fields(
    rng: np.random.Generator,
    roads: RandomRoads,
    domain: Domain | None,
    parent: Candidate,
    curvatures: FloatArray,
    moved: float,
) -> Mapping[str, Any]:
    """Return grade, speed limits and conditions of a child as fields of a `Candidate`.

    Args:
        rng: Generator that draws a new grade or new conditions.
        roads: Random roads, which know whether roads have grades.
        domain: Domain of the conditions; None for the usual ones.
        parent: The parent.
        curvatures: Curvatures of the child, (n,) in 1/m.
        moved: Distance in m by which the critical place moved along the road; the parent's grade,
            limits and conditions move with it.
    """
    grade, limits = parent.grade, parent.speed_limits
    if roads.has_class and rng.random() < _NEW_GRADE_SHARE:
        grade = roads.grade(rng, curvatures)
    elif grade is not None and len(grade):
        grade = np.column_stack([grade[:, 0] + moved, grade[:, 1]])
    length = (len(curvatures) - 1) * roads.step
    conditions = inherit_conditions(rng, domain, parent, length, moved)
    values: dict[str, Any] = {"grade": grade, "conditions": conditions}
    if limits is not None and len(limits):
        values[profile.LIMITS] = profile.moved_steps(limits, moved)
    return values


def features_of_child(child: Child, model: FailureModel, archive: Archive) -> FloatArray:
    """Return the features of a child for a model, see `FailureModel.features`."""
    vector = archive.vectors[child.row] if child.vector is None else child.vector
    fitness = float(archive.places["fitness"][child.row])
    return model.features(vector, child.side, child.operator, fitness)
