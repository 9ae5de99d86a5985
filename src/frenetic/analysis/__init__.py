"""The meaning of a campaign's tests, one by one and together."""

from frenetic.analysis.comparison import Comparison, compare, compare_measured
from frenetic.analysis.competition import competition_segment, failure_segment
from frenetic.analysis.coverage import DomainCoverage, domain_coverage
from frenetic.analysis.failures import (
    Cluster,
    Clusters,
    Failure,
    cluster_failures,
    failures_of,
    nearest_misses,
)
from frenetic.analysis.features import FEATURES, Feature, Features, features_of
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
from frenetic.analysis.sparseness import largest_distances, unlike_lines

__all__ = [
    "FEATURES",
    "MEASURES",
    "Bend",
    "CampaignMeasures",
    "Cluster",
    "Clusters",
    "Comparison",
    "DomainCoverage",
    "Failure",
    "Feature",
    "Features",
    "Measure",
    "Segment",
    "cluster_failures",
    "compare",
    "compare_measured",
    "competition_segment",
    "domain_coverage",
    "failure_segment",
    "failures_of",
    "features_of",
    "find_bends",
    "find_campaigns",
    "group_campaigns",
    "largest_distances",
    "measure_campaign",
    "nearest_misses",
    "segment_of",
    "segment_profile",
    "segments_of",
    "unlike_lines",
]
