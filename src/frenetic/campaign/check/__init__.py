"""Whether a campaign's database is sound, and what it holds.

Everything is read, nothing is changed, and nothing is believed: SQLite checks its file, then every
fact, candidate, result and trajectory is held against what a campaign writes and against the
others, and each stored drive is judged again. A campaign may be running meanwhile: what is told
after the check began is not looked at.
"""

from frenetic.campaign.check.check import check_campaign
from frenetic.campaign.check.findings import Finding, Severity, Subject
from frenetic.campaign.check.report import CheckReport, Holdings, State

__all__ = [
    "CheckReport",
    "Finding",
    "Holdings",
    "Severity",
    "State",
    "Subject",
    "check_campaign",
]
