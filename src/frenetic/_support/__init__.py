"""Helpers that all packages share and no user imports."""
