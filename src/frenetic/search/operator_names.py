"""Names of operators, as an `Origin` carries them and the database keeps them, and descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

RANDOM = "random"
"""The operator that draws a random road, each value relative to the one before it."""
INDEPENDENT = "independent"
"""The operator that draws a random road of independent values."""
SLALOM = "slalom"
"""The operator that draws a random slalom."""
BENDS = "bends"
"""The operator that draws random bends between straights."""
SECTIONS = "sections"
"""The operator that draws random straights, clothoids and arcs."""
REST = "rest"
"""The operator that continues a road after the place where the car left its lane."""
EARLIER = "earlier"
"""The operator that takes a road of an earlier campaign."""
GIVEN = "given"
"""The operator that takes a stretch of a real road, from which the search starts."""
SWEEP = "sweep"
"""The operator that takes a single bend of a sweep."""
CONDITIONS = "conditions"
"""The operator that takes the parent's road in other conditions."""

OPERATOR_DESCRIPTIONS: Mapping[str, str] = MappingProxyType(
    {
        RANDOM: "draws a new road",
        INDEPENDENT: "draws a new road, each value by itself",
        SLALOM: "draws a new road, bends to both sides in turn",
        BENDS: "draws a new road, bends between straights",
        SECTIONS: "draws a new road of straights, clothoids and arcs",
        # frenetic.search.operators
        "P1": "adds new values at the end",
        "P2": "removes values anywhere",
        "P3": "removes values from the front",
        "P4": "removes values from the end",
        "P5": "replaces values anywhere",
        "P6": "multiplies all values by one factor",
        "F1": "drives the road from its other end",
        "F2": "reverses the order of the values",
        "F3": "puts the second half first",
        "F4": "mirrors the road: left becomes right",
        "C1": "takes each value from either of two parents",
        "C2": "joins halves of two parents",
        # frenetic.search.variation; "the place" is where the car was worst on the parent's road
        "redraw": "draws the road after the place anew",
        "shift": "bends the road more to one side after the place",
        "jitter": "changes all values a little",
        "local": "changes values around the place",
        "prefix": "leads another way to the place",
        "approach": "draws the values before the place anew",
        "scale": "multiplies all values by one factor",
        "splice": "continues after the place as another road does",
        "amplify": "sharpens the bend",
        "flatten": "straightens the way to the place, for more speed",
        "mirror": "mirrors the road: left becomes right",
        "straight": "puts a straight before the place",
        CONDITIONS: "drives the road in other conditions",
        SWEEP: "drives a single bend",
        REST: "continues after the place where the car left its lane",
        GIVEN: "drives a stretch of a real road",
        EARLIER: "drives a road of an earlier campaign again",
    }
)
"""Name of an operator -> what it does, in a few words for people."""
