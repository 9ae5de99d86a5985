"""Measures and curves of campaigns as pandas data frames."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.curves import campaign_curves
from frenetic.analysis.measures import campaign_values
from frenetic.export.table_columns import TABLES, column_of

if TYPE_CHECKING:
    import pandas as pd


def measure_frame(campaigns: Iterable[CampaignMeasures]) -> pd.DataFrame:
    """Return the table ``measures`` of campaigns, with the column ``campaign``."""
    import pandas as pd  # an extra

    rows: list[dict[str, Any]] = [
        {
            "campaign": campaign.folder.as_posix(),
            "seed": campaign.seed if isinstance(campaign.seed, int) else None,
            "simulations": campaign.simulations,
            "is_finished": campaign.is_finished,
            **campaign_values(campaign),
        }
        for campaign in campaigns
    ]
    return pd.DataFrame(
        {
            name: pd.Series([row[name] for row in rows], dtype=column_of("measures", name).dtype)
            for name in ("campaign", *TABLES["measures"])
        }
    )


def curve_frame(campaigns: Iterable[CampaignMeasures]) -> pd.DataFrame:
    """Return the table ``curves`` of campaigns, with the column ``campaign``."""
    import pandas as pd  # an extra

    curves = [
        (campaign.folder.as_posix(), name, x, y)
        for campaign in campaigns
        for name, (x, y) in campaign_curves(campaign).items()
    ]
    lengths = [len(x) for _, _, x, _ in curves]
    texts = {
        column: pd.Series([curve[i] for curve in curves], dtype="string")
        .repeat(lengths)
        .reset_index(drop=True)
        for i, column in enumerate(("campaign", "curve"))
    }
    x = np.concatenate([np.empty(0), *(x for _, _, x, _ in curves)])
    y = np.concatenate([np.empty(0, np.int64), *(y for *_, y in curves)])
    return pd.DataFrame({**texts, "x": x, "y": y})
