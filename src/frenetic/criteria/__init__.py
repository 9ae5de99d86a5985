"""Criteria of a drive beside the lane: limits of signals such as the lateral acceleration."""
