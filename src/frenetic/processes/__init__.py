"""Processes beside the command's own: workers that drive, their limits, and their end."""
