"""Pictures of an object, by the layers above it.

Roads, drives, tests and campaigns have methods such as ``road.plot()``, and notebooks show them
with a picture. What draws lies above them and imports slowly: this module alone calls it from
below, when it is asked to.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes as Axes  # for the methods' signatures

    from frenetic.report.html.replay import Replay as Replay


class Shown:
    """Base of what a notebook shows with a picture and its figures."""

    def _repr_html_(self) -> str:
        from frenetic.report.notebook import html_of  # as this module says

        return html_of(self)


def draw(name: str, thing: Any, ax: Axes | None, **how: Any) -> Axes:
    """Draws a thing by the function of that name in `frenetic.report.plots`."""
    from frenetic.report import plots  # as this module says

    axes: Axes = getattr(plots, name)(thing, ax, **how)
    return axes


def replay(road: Any, drive: Any, **how: Any) -> Replay:
    """A drive as a replay, see `frenetic.report.html.replay`."""
    from frenetic.report.html.replay import replay_drive  # as this module says

    return replay_drive(road, drive, **how)


def data_frame(campaign: Any) -> pd.DataFrame:
    """The tests of a campaign as a data frame, see `frenetic.export.data_frame`."""
    from frenetic.export.frames import data_frame as frame_of  # as this module says

    return frame_of(campaign)
