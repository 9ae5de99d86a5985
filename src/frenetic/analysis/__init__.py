"""What a campaign's tests mean, each on its own and together.

The names are imported when they are used, so that asking for one takes no more than it needs.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from frenetic.analysis.bends import Bend, find_bends
    from frenetic.analysis.clusters import (
        Cluster,
        Clusters,
        Failure,
        cluster_failures,
        failures_of,
    )
    from frenetic.analysis.comparing import Comparison, compare, compare_measured
    from frenetic.analysis.competition import (
        CompetitionFeatures,
        CompetitionSegment,
        competition_features,
        competition_segment,
    )
    from frenetic.analysis.features import FEATURES, Feature, Features, feature, features_of
    from frenetic.analysis.grouping import find_campaigns, group_campaigns
    from frenetic.analysis.measures import MEASURES, Measure
    from frenetic.analysis.measuring import CampaignMeasures, measure_campaign
    from frenetic.analysis.replaying import Replay, replay, write_junit
    from frenetic.analysis.rerunning import Rerun, Variation, read_reruns, rerun, telling_reruns
    from frenetic.analysis.segments import Segment, segment_of, segment_profile, segments_of
    from frenetic.analysis.sparseness import (
        CompetitionSparseness,
        Diversity,
        competition_sparseness,
        diversity,
        edit_distance,
    )

_HOMES = {
    "bends": ("Bend", "find_bends"),
    "clusters": ("Cluster", "Clusters", "Failure", "cluster_failures", "failures_of"),
    "comparing": ("Comparison", "compare", "compare_measured"),
    "competition": (
        "CompetitionFeatures",
        "CompetitionSegment",
        "competition_features",
        "competition_segment",
    ),
    "features": ("FEATURES", "Feature", "Features", "feature", "features_of"),
    "grouping": ("find_campaigns", "group_campaigns"),
    "measures": ("MEASURES", "Measure"),
    "measuring": ("CampaignMeasures", "measure_campaign"),
    "replaying": ("Replay", "replay", "write_junit"),
    "rerunning": ("Rerun", "Variation", "read_reruns", "rerun", "telling_reruns"),
    "segments": ("Segment", "segment_of", "segment_profile", "segments_of"),
    "sparseness": (
        "CompetitionSparseness",
        "Diversity",
        "competition_sparseness",
        "diversity",
        "edit_distance",
    ),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__all__ = [
    "FEATURES",
    "MEASURES",
    "Bend",
    "CampaignMeasures",
    "Cluster",
    "Clusters",
    "Comparison",
    "CompetitionFeatures",
    "CompetitionSegment",
    "CompetitionSparseness",
    "Diversity",
    "Failure",
    "Feature",
    "Features",
    "Measure",
    "Replay",
    "Rerun",
    "Segment",
    "Variation",
    "cluster_failures",
    "compare",
    "compare_measured",
    "competition_features",
    "competition_segment",
    "competition_sparseness",
    "diversity",
    "edit_distance",
    "failures_of",
    "feature",
    "features_of",
    "find_bends",
    "find_campaigns",
    "group_campaigns",
    "measure_campaign",
    "read_reruns",
    "replay",
    "rerun",
    "segment_of",
    "segment_profile",
    "segments_of",
    "telling_reruns",
    "write_junit",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
