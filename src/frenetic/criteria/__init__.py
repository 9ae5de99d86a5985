"""Criteria of a drive beside the lane: limits of signals such as the lateral acceleration."""

from frenetic.criteria.criterion import CriteriaSet, Criterion, Signal, criteria_sets, signal_named

__all__ = ["CriteriaSet", "Criterion", "Signal", "criteria_sets", "signal_named"]
