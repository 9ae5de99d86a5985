"""Whether a campaign's database is sound, and what it holds.

A check reads everything, verifies it and changes nothing. SQLite checks its file; then every fact,
candidate, result and trajectory is compared with what a campaign writes and with the others, and
each stored drive is judged again. A campaign may be running meanwhile: later results are left out.
"""

from frenetic.campaign.check.check import check_campaign
from frenetic.campaign.check.report import (
    CheckReport,
    Finding,
    Holdings,
    Severity,
    State,
    Subject,
)

__all__ = [
    "CheckReport",
    "Finding",
    "Holdings",
    "Severity",
    "State",
    "Subject",
    "check_campaign",
]
