"""Drive a campaign's roads again: whether they still fail, with a new version, and how short.

Each rerun is a campaign in the folder ``rerun`` of the campaign whose roads it drives.
"""
