"""Export of a whole campaign into a folder, for other tools."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Literal, TypeAlias, get_args

from frenetic.campaign.campaign import Campaign
from frenetic.campaign.store import CampaignStore
from frenetic.export.competition_folder import write_competition_folder
from frenetic.export.folders import EXPORTS, whole_folder
from frenetic.export.table_files import write_tables
from frenetic.export.table_rows import CampaignSource, open_store
from frenetic.oracle.outcome import Outcome, chosen_outcomes

Format: TypeAlias = Literal["parquet", "csv", "json", "competition"]
"""Format of an exported campaign."""
TrajectoryChoice: TypeAlias = Literal["all", "failures", "none"]
"""Choice of tests whose trajectories are exported."""


def export_campaign(
    campaign: CampaignSource,
    format: str,  # noqa: A002
    out: Path | str | None = None,
    *,
    outcomes: Outcome | str | Iterable[Outcome | str] = (),
    trajectories: TrajectoryChoice = "all",
    on_progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a campaign's tests and trajectories into a folder, completely or not at all.

    | format | files | read by |
    | --- | --- | --- |
    | parquet | ``tests.parquet``, ``trajectories.parquet`` | pandas, DuckDB, Polars, R |
    | csv | ``tests.csv``, ``trajectories.csv`` | anything |
    | json | ``tests.jsonl``, ``trajectories.jsonl``: one object per line | pandas, DuckDB, jq |
    | competition | ``test.NNNN.json`` and its tables | the competition's tools |

    `frenetic.export.TABLES` lists the tables' columns. Memory does not grow with the campaign,
    which may be running: later results are left out.

    Args:
        campaign: the campaign, as `data_frame` takes it. A folder of several campaigns is allowed
            in all formats but ``competition``.
        format: format of the files.
        out: an empty or new folder; by default ``exports/FORMAT`` in the campaign's folder.
        outcomes: one outcome, such as ``"FAIL"``, or several: only their tests are written. Empty
            for all tests.
        trajectories: choice of the tests whose trajectories are written.
        on_progress: called now and then with the number of written tests and the number of all
            tests.

    Returns:
        The folder.

    Raises:
        FreneticError: the folder is not empty or cannot be written, the campaign is damaged, or
            Parquet is meant and pandas or pyarrow is missing.
        ValueError: the format, an outcome or the choice of trajectories is unknown.
    """
    for name, value, allowed in (
        ("format", format, get_args(Format)),
        ("trajectories", trajectories, get_args(TrajectoryChoice)),
    ):
        if value not in allowed:
            raise ValueError(f"{name} is {value!r}: one of {', '.join(allowed)} is needed")
    wanted = chosen_outcomes(outcomes)
    driven = {
        "all": wanted,
        "failures": tuple(outcome for outcome in wanted if outcome is Outcome.FAIL),
        "none": None,
    }[trajectories]
    notify = on_progress or (lambda *_: None)
    home = campaign.folder if isinstance(campaign, Campaign | CampaignStore) else Path(campaign)
    target = home / EXPORTS / format if out is None else Path(out)
    with whole_folder(target) as folder:
        if format in ("parquet", "csv", "json"):
            write_tables(folder, campaign, format, wanted, driven, notify)
            return target
        with open_store(campaign) as store:
            total = sum(store.by_outcome().values())
            write_competition_folder(
                folder,
                store,
                outcomes=wanted,
                driven=driven or (),
                # A running campaign may have more tests by now.
                on_test=lambda count: notify(count, max(count, total)),
            )
    return target
