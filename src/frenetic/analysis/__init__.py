"""The meaning of a campaign's tests, one by one and together.

The names are imported on use, so asking for one imports no more than it needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.public_names import lazy_names

if TYPE_CHECKING:
    from frenetic.analysis.comparison import Comparison, compare, compare_measured
    from frenetic.analysis.competition import (
        CompetitionFeatures,
        CompetitionSegment,
        competition_features,
        competition_segment,
    )
    from frenetic.analysis.failures import (
        Cluster,
        Clusters,
        Failure,
        cluster_failures,
        failures_of,
        nearest_misses,
    )
    from frenetic.analysis.features import FEATURES, Feature, Features, feature, features_of
    from frenetic.analysis.groups import find_campaigns, group_campaigns
    from frenetic.analysis.metrics import MEASURES, CampaignMeasures, Measure, measure_campaign
    from frenetic.analysis.segments import (
        Bend,
        Segment,
        find_bends,
        segment_of,
        segment_profile,
        segments_of,
    )
    from frenetic.analysis.sparseness import (
        CompetitionSparseness,
        Diversity,
        competition_sparseness,
        diversity,
        edit_distance,
    )

__getattr__ = lazy_names(
    __name__,
    {
        "frenetic.analysis.failures": (
            "Cluster",
            "Clusters",
            "Failure",
            "cluster_failures",
            "failures_of",
            "nearest_misses",
        ),
        "frenetic.analysis.comparison": ("Comparison", "compare", "compare_measured"),
        "frenetic.analysis.competition": (
            "CompetitionFeatures",
            "CompetitionSegment",
            "competition_features",
            "competition_segment",
        ),
        "frenetic.analysis.features": ("FEATURES", "Feature", "Features", "feature", "features_of"),
        "frenetic.analysis.groups": ("find_campaigns", "group_campaigns"),
        "frenetic.analysis.metrics": (
            "MEASURES",
            "CampaignMeasures",
            "Measure",
            "measure_campaign",
        ),
        "frenetic.analysis.segments": (
            "Bend",
            "Segment",
            "find_bends",
            "segment_of",
            "segment_profile",
            "segments_of",
        ),
        "frenetic.analysis.sparseness": (
            "CompetitionSparseness",
            "Diversity",
            "competition_sparseness",
            "diversity",
            "edit_distance",
        ),
    },
)

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
    "Segment",
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
    "nearest_misses",
    "segment_of",
    "segment_profile",
    "segments_of",
]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
