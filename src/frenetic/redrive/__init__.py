"""Driving again: how often roads fail, where else, whether they are fixed, how short they get."""
