"""Drive a campaign's roads again: repeat, vary, minimise, compare, estimate rates and margins.

Each rerun is a campaign in the folder ``rerun`` of the campaign whose roads it drives.
"""
