"""Plots of a campaign, by the object that runs it and the one that reads it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from frenetic._support.pictures import Shown, draw

if TYPE_CHECKING:
    from frenetic._support.pictures import Axes


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
