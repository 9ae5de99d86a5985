"""Drive a campaign's roads again: repeat, vary, minimise, compare versions, estimate rates.

Each rerun is a campaign in the folder ``rerun`` of the campaign whose roads it drives.
"""
