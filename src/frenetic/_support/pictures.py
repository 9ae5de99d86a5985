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


class ShownCampaign(Shown):
    """Base of `Campaign` and `CampaignStore`: what is stored, drawn on Matplotlib's axes.

    Each draws on the given axes, or on those of a new figure of pyplot's, and returns them.
    """

    def plot_failures(self, ax: Axes | None = None, *, number: int = 12) -> Axes:
        """Draws the most severe distinct failures from above; the nearest misses if nothing failed.

        Args:
            ax: axes to draw on; a sheet fills them.
            number: most drives to draw, one of each distinct failure.

        Raises:
            CampaignError: there is no campaign, or it is damaged.
        """
        return draw("plot_failures", self, ax, number=number)

    def plot_progress(self, ax: Axes | None = None) -> Axes:
        """Draws failures and distinct failures over the simulations, as the report does.

        Dashed: how many there would be if all roads were like those of the random phase, with bands
        of what is not known of it (95 %).

        Raises:
            CampaignError: there is no campaign, or it is damaged.
        """
        return draw("plot_progress", self, ax)

    def plot_feature_map(
        self,
        ax: Axes | None = None,
        *,
        x: str = "max_curvature",
        y: str = "mean_speed",
        whole: bool = False,
    ) -> Axes:
        """Draws what roads and drives were tried (grey), and where they fail.

        A cell with failures has their number, and the colour of the lowest MOOBD.

        Args:
            ax: axes to draw on.
            x: feature to the right, see `frenetic.analysis.FEATURES`.
            y: feature upwards.
            whole: measure the whole road and drive instead of the 30 m before and after the place
                of departure.

        Raises:
            CampaignError: there is no campaign, or it is damaged.
            UnknownNameError: there is no such feature.
        """
        return draw("plot_feature_map", self, ax, x=x, y=y, whole=whole)


def replay(road: Any, drive: Any, **how: Any) -> Replay:
    """A drive as a replay, see `frenetic.report.html.replay`."""
    from frenetic.report.html.replay import replay_drive  # as this module says

    return replay_drive(road, drive, **how)


def data_frame(campaign: Any) -> pd.DataFrame:
    """The tests of a campaign as a data frame, see `frenetic.export.data_frame`."""
    from frenetic.export.tables import data_frame as frame_of  # as this module says

    return frame_of(campaign)
