"""Driving a campaign's roads again: whether they fail again, on a new version, and how short.

Whatever drives again is a campaign in the folder ``again`` of the one whose roads these are.
"""
