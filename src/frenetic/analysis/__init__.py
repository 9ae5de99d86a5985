"""What a campaign's tests mean together."""

from frenetic.analysis.diversity import most_different, segment_profile

__all__ = ["most_different", "segment_profile"]
