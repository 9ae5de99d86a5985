"""Analysis of a campaign: failures, causes, features, coverage, and comparison with others."""

from frenetic.analysis.bend_map import SweepMap, sweep_map
from frenetic.analysis.campaign_measures import CampaignMeasures, measure_campaign
from frenetic.analysis.clusters import Cluster, Clusters, cluster_failures, nearest_misses
from frenetic.analysis.comparison import Comparison, compare
from frenetic.analysis.coverage import DomainCoverage, domain_coverage
from frenetic.analysis.curves import CURVES, Curve
from frenetic.analysis.failures import Failure, failures_of
from frenetic.analysis.groups import find_campaigns
from frenetic.analysis.measures import MEASURES, Measure
from frenetic.analysis.official_segment import competition_segment, failure_segment
from frenetic.analysis.quality import QUALITY, DriveQuality, QualityMeasure, drive_quality
from frenetic.analysis.quality_comparison import QualityComparison
from frenetic.analysis.segments import segments_of
from frenetic.analysis.spaces import SPACES, Space
from frenetic.analysis.sparseness import unlike_lines
from frenetic.analysis.unlike import UnlikeFailures
from frenetic.segments.features import FEATURES, Features, features_of
from frenetic.segments.segment import Segment, segment_of

__all__ = [
    "CURVES",
    "FEATURES",
    "MEASURES",
    "QUALITY",
    "SPACES",
    "CampaignMeasures",
    "Cluster",
    "Clusters",
    "Comparison",
    "Curve",
    "DomainCoverage",
    "DriveQuality",
    "Failure",
    "Features",
    "Measure",
    "QualityComparison",
    "QualityMeasure",
    "Segment",
    "Space",
    "SweepMap",
    "UnlikeFailures",
    "cluster_failures",
    "compare",
    "competition_segment",
    "domain_coverage",
    "drive_quality",
    "failure_segment",
    "failures_of",
    "features_of",
    "find_campaigns",
    "measure_campaign",
    "nearest_misses",
    "segment_of",
    "segments_of",
    "sweep_map",
    "unlike_lines",
]
