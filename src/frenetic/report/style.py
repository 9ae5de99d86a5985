"""Style and files of all pictures."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text
from matplotlib.ticker import MaxNLocator, ScalarFormatter
from matplotlib.transforms import Affine2D
from PIL import Image

from frenetic._support.arrays import FloatArray
from frenetic._support.files import replacing
from frenetic.errors import FreneticError

SUFFIXES: Final = (".png", ".svg", ".pdf")
"""Valid suffixes of a picture's file."""
DPI: Final = 110

# Sizes of a page in inches.
WIDTH: Final = 11.0
MARGIN: Final = 0.45
INNER: Final = WIDTH - 2.0 * MARGIN
POINT: Final = 72.0
"""Points per inch; lines and letters are measured in points."""

INK: Final = "#1d2733"
QUIET: Final = "#6a7684"
FAINT: Final = "#c9d0d8"
PANEL: Final = "#f4f6f8"
_GRID: Final = "#e8ebef"

_Span: TypeAlias = tuple[float, float]

STYLE: Final[dict[str, Any]] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana"],  # as wide: for SVGs shown elsewhere
    "font.size": 9.0,
    "text.usetex": False,
    "text.parse_math": False,  # a $ in somebody's name is a $
    "text.color": INK,
    "axes.unicode_minus": True,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": QUIET,
    "axes.linewidth": 0.8,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": QUIET,
    "ytick.labelcolor": QUIET,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "path.sketch": None,
    "savefig.bbox": "standard",
    "svg.fonttype": "none",  # text stays text: it can be searched and selected
    "svg.hashsalt": "frenetic",
    "pdf.fonttype": 42,
}
"""Settings of Matplotlib while a picture is drawn."""


def form_of(path: Path | str) -> str:
    """The form of a picture by its suffix: png, svg or pdf.

    Raises:
        FreneticError: another suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        allowed = ", ".join(SUFFIXES[:-1]) + f" or {SUFFIXES[-1]}"
        raise FreneticError(f"cannot draw {path}: a picture's name must end with {allowed}")
    return suffix[1:]


def write_figure(figure: Figure, path: Path | str, form: str) -> None:
    """Draws a picture and writes it whole or not at all.

    Raises:
        FreneticError: the file cannot be written.
    """
    path = Path(path)
    drawn = encode_figure(figure, form)
    try:
        with replacing(path) as partial:
            partial.write_bytes(drawn)
    except OSError as error:
        raise FreneticError(
            f"cannot write the picture {path}: {error.strerror or error}"
        ) from error


def encode_figure(figure: Figure, form: str, *, colours: int | None = None) -> bytes:
    """The bytes of a picture's file; a PNG of few colours is small."""
    canvas = FigureCanvasAgg(figure)
    drawn = BytesIO()
    with warnings.catch_warnings():
        # A title may have letters that the font lacks; boxes in their place suffice.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        if form == "png":
            canvas.draw()
            # Nothing is transparent; without that a file is as small in half the time.
            pixels = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
            image = pixels.convert("RGB")
            if colours is not None:
                image = image.quantize(colours, kmeans=3)  # so that small marks keep theirs
            image.save(drawn, form, compress_level=3 if colours is None else 9, dpi=(DPI, DPI))
        else:
            undated: Any = {"Date" if form == "svg" else "CreationDate": None}
            figure.savefig(drawn, format=form, dpi=DPI, metadata=undated)
    return drawn.getvalue()


@dataclass(frozen=True)
class Paper:
    """A figure, or axes in one, on which things are placed in inches from the upper left corner."""

    canvas: Figure | Axes
    width: float
    height: float

    @classmethod
    def on(cls, axes: Axes) -> Paper:
        """Axes in their present size."""
        box, dpi = axes.bbox, axes.figure.dpi
        return cls(axes, box.width / dpi, box.height / dpi)

    @property
    def square(self) -> Any:
        """Transform of the unit square to what it covers."""
        canvas = self.canvas
        return canvas.transFigure if isinstance(canvas, Figure) else canvas.transAxes

    def text(self, x: float, y: float, text: str, *, size: float, **how: Any) -> Any:
        """Writes a text."""
        how = {"va": "baseline", "transform": self.square, **how}
        return self.canvas.text(x / self.width, 1.0 - y / self.height, text, size=size, **how)

    def bar(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """A filled rectangle."""
        self.canvas.add_artist(
            Rectangle(
                (x / self.width, 1.0 - (y + height) / self.height),
                width / self.width,
                height / self.height,
                facecolor=colour,
                edgecolor="none",
                transform=self.square,
            )
        )

    def line(self, xs: Sequence[float], ys: Sequence[float], **how: Any) -> None:
        """A line through points."""
        across, up = [x / self.width for x in xs], [1.0 - y / self.height for y in ys]
        self.canvas.add_artist(Line2D(across, up, transform=self.square, **how))

    def panel(self, x: float, y: float, width: float, height: float) -> Panel:
        """A panel of so many points (1/72 inch), measured from its centre."""
        across, up = (-width / 2.0, width / 2.0), (-height / 2.0, height / 2.0)
        panel = self.chart(x, y, width / POINT, height / POINT, across, up)
        panel.edge.set_facecolor(PANEL)
        return panel

    def chart(
        self, x: float, y: float, width: float, height: float, across: _Span, up: _Span
    ) -> Panel:
        """A panel that shows the values ``across`` and ``up``, from the first to the last."""
        size = np.array([width / self.width, height / self.height])
        corner = x / self.width, 1.0 - (y + height) / self.height
        shown = np.array([across[1] - across[0], up[1] - up[0]])
        place = Affine2D().translate(-across[0], -up[0]).scale(*(size / shown)).translate(*corner)
        edge = Rectangle(
            corner,
            *size,
            facecolor="none",
            edgecolor="none",
            zorder=0.0,
            transform=self.square,
        )
        self.canvas.add_artist(edge)
        point = shown / (POINT * np.array([width, height]))
        return Panel(self.canvas, edge, place + self.square, across, up, point)


@dataclass(frozen=True)
class Panel:
    """A part of a picture with coordinates of its own; what is drawn is cut off at its edge.

    Matplotlib's axes can do all this, too, but take ten times as long to make and draw. So files
    and pages have panels, and a user's axes become one (`AxesPanel`): both are drawn on alike.
    """

    canvas: Figure | Axes
    edge: Patch
    place: Any
    """Transform of its coordinates to those of the display."""
    across: _Span
    """The coordinates at its left and right edge."""
    up: _Span
    """The coordinates at its lower and upper edge."""
    point: FloatArray
    """(2,) Size of a point on paper in its coordinates."""

    def add(self, artist: Artist, *, cut: bool = True) -> None:
        """Draws an artist whose order is among those of this panel, and before what is no panel."""
        artist.set_transform(self.place)
        artist.set_zorder(artist.get_zorder() / 100.0)
        self.canvas.add_artist(artist)
        if cut:
            artist.set_clip_path(self.edge)
        else:
            artist.set_clip_on(False)

    def line(self, xs: Any, ys: Any, *, cut: bool = True, **how: Any) -> None:
        """Draws a line through points."""
        self.add(Line2D(xs, ys, **how), cut=cut)

    def strip(self, xs: Any, ys: Any, width: float, **how: Any) -> None:
        """Draws a line that covers what is so many points wide."""
        self.line(xs, ys, lw=width, **how)

    def mark(self, place: FloatArray | _Span, marker: str, *, cut: bool = True, **how: Any) -> None:
        """Draws a marker at a place, (2,)."""
        x, y = place
        self.add(Line2D([x], [y], linestyle="none", marker=marker, **how), cut=cut)

    def level(self, y: float, **how: Any) -> None:
        """Draws a line from the left to the right edge."""
        self.line(self.across, (y, y), **how)

    def text(self, x: float, y: float, text: str, **how: Any) -> None:
        """Writes a text, also over the edge."""
        self.add(Text(x, y, text, **how), cut=False)

    def beside(
        self, place: tuple[float, float], off: tuple[float, float], text: str, **how: Any
    ) -> None:
        """Writes a text so many points off a place."""
        x, y = np.array(place) + np.array(off) * self.point
        self.text(x, y, text, **how)

    def draw_grid(
        self, across: Sequence[float], up: Sequence[float], *, labelled: bool = True
    ) -> None:
        """Draws a grid at some values, which stand left of it and, if ``labelled``, below it."""
        lines = [[(x, self.up[0]), (x, self.up[1])] for x in across]
        lines += [[(self.across[0], y), (self.across[1], y)] for y in up]
        self.add(LineCollection(lines, colors=_GRID, linewidths=0.7, zorder=0.5))
        self.level(self.up[0], cut=False, color=FAINT, lw=0.8, zorder=2.5)
        how = {"size": 8.5, "color": QUIET}
        for y, text in zip(up, _numbers(up, self.up), strict=True):
            self.beside(
                (self.across[0], y), (-3.5, 0.0), text, ha="right", va="center_baseline", **how
            )
        for x, text in zip(across, _numbers(across, self.across), strict=True) if labelled else ():
            self.beside((x, self.up[0]), (0.0, -3.5), text, ha="center", va="top", **how)


class _Strip(Line2D):
    """A line that covers what it covered when it was made, however its axes are scaled since."""

    def __init__(self, xs: Any, ys: Any, width: float, points: Any, **how: Any) -> None:
        super().__init__(xs, ys, linewidth=width, **how)
        self._width, self._points = width, points

    def draw(self, renderer: Any) -> None:
        """Draws it with the width that it has by now."""
        self.set_linewidth(self._width * self._points())
        super().draw(renderer)


class AxesPanel(Panel):
    """Matplotlib's axes as a panel; its coordinates are points on paper in their present size."""

    @classmethod
    def on(cls, axes: Axes, middle: _Span, scale: float) -> AxesPanel:
        """The axes, with (0, 0) in the ``middle`` and ``scale`` points per unit of its data."""
        paper = Paper.on(axes)
        across, up = (
            (-0.5 * POINT * length, 0.5 * POINT * length) for length in (paper.width, paper.height)
        )
        place = Affine2D().scale(1.0 / scale).translate(*middle) + axes.transData
        return cls(axes, axes.patch, place, across, up, np.ones(2))

    def strip(self, xs: Any, ys: Any, width: float, **how: Any) -> None:
        """Draws a line as wide as now, also when the axes have got another size or limits."""
        canvas: Any = self.canvas

        def points() -> float:
            (left, _), (right, _) = self.place.transform([(0.0, 0.0), (POINT, 0.0)])
            return abs(float(right - left)) / float(canvas.figure.dpi)

        self.add(_Strip(xs, ys, width, points, **how))


def round_values(shown: _Span, most: int, steps: Sequence[float]) -> list[float]:
    """Round values in a range, in at most so many equal steps: these times a power of ten."""
    low, high = shown
    near = 1e-9 * (high - low)
    values = MaxNLocator(most, steps=steps).tick_values(low, high)
    return [float(value) for value in values if low - near <= value <= high + near]


def _numbers(values: Sequence[float], shown: _Span) -> list[str]:
    """Values as texts with as many digits as tell them apart."""
    formatter: Any = ScalarFormatter()
    formatter.create_dummy_axis()
    formatter.axis.set_view_interval(*shown)
    return list(formatter.format_ticks(values))


def _printable(text: str) -> str:
    """``text`` on one line, without what a picture file could not hold."""
    return "".join(c for c in " ".join(text.split()) if c.isprintable())


def one_line(text: str, most: int) -> str:
    """``text`` on one line of at most so many letters."""
    text = _printable(text)
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def wrapped(text: str, width: int, most: int) -> list[str]:
    """``text`` in at most so many lines."""
    return textwrap.wrap(_printable(text), width, max_lines=most, placeholder=" …")
