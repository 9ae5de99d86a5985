"""The segment of a drive around its place, and the values by which drives are compared."""

from frenetic.segments.causes import Cause, Kind, cause_of
from frenetic.segments.features import FEATURES, Features, features_of
from frenetic.segments.segment import Segment, segment_of

__all__ = [
    "FEATURES",
    "Cause",
    "Features",
    "Kind",
    "Segment",
    "cause_of",
    "features_of",
    "segment_of",
]
