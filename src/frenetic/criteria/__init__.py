"""Criteria of a drive beside the lane: limits of signals such as the lateral acceleration."""

from frenetic.criteria.criterion import Criterion, Profile, Quantity, profiles, quantity

__all__ = ["Criterion", "Profile", "Quantity", "profiles", "quantity"]
