"""Frenetic finds the roads on which an automated driver leaves its lane."""
