"""Colours, sizes and file formats that all pictures share, and paper to draw on."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from PIL import Image

from frenetic._support.files import replacing
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome

SUFFIXES: Final = (".png", ".svg", ".pdf")
"""Valid suffixes of a picture's file."""
DPI: Final = 110  # [dots/inch]; our choice

# Sizes of a page, in inches; our choice.
WIDTH: Final = 11.0
MARGIN: Final = 0.45
INNER_WIDTH: Final = WIDTH - 2.0 * MARGIN
POINT: Final = 72.0
"""Points per inch; lines and letters are measured in points."""

# Colours.
INK: Final = "#1d2733"
"""Colour of texts and marks."""
QUIET: Final = "#6a7684"
"""Colour of secondary texts and lines."""
FAINT: Final = "#c9d0d8"
"""Colour of axes."""
PANEL: Final = "#f4f6f8"
"""Colour of the ground around a road."""
GRID: Final = "#e8ebef"
ALARM: Final = "#d1232a"
"""Colour of failures and of the lane's edge."""
OUTCOME_COLOURS: Final[Mapping[Outcome, str]] = {
    Outcome.PASS: "#1b8a6b",
    Outcome.FAIL: ALARM,
    Outcome.INVALID: "#c98a00",
    Outcome.ERROR: "#7a5aa6",
}

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
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "path.sketch": None,
    "savefig.bbox": "standard",
    "svg.fonttype": "none",  # text stays text: it can be searched and selected
    "svg.hashsalt": "frenetic",
    "pdf.fonttype": 42,
}
"""Settings of Matplotlib while a picture is drawn."""


def form_of(path: Path | str) -> str:
    """Return the format of a picture by the suffix of its path: png, svg or pdf.

    Raises:
        FreneticError: the path has another suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        allowed = ", ".join(SUFFIXES[:-1]) + f" or {SUFFIXES[-1]}"
        raise FreneticError(f"cannot draw {path}: a picture's name must end with {allowed}")
    return suffix[1:]


def write_figure(figure: Figure, path: Path | str, form: str) -> None:
    """Draw a figure and write it, completely or not at all.

    Args:
        figure: the figure.
        path: path of the file; an existing file is replaced.
        form: format of the file, from `form_of`.

    Raises:
        FreneticError: the file cannot be written.
    """
    path = Path(path)
    content = encode_figure(figure, form)
    try:
        with replacing(path) as partial:
            partial.write_bytes(content)
    except OSError as error:
        raise FreneticError(
            f"cannot write the picture {path}: {error.strerror or error}"
        ) from error


def encode_figure(figure: Figure, form: str, *, colours: int | None = None) -> bytes:
    """Return the bytes of a picture's file.

    Args:
        figure: the figure.
        form: format of the file, from `form_of`.
        colours: number of colours of a PNG, which makes the file small; None for all colours.
    """
    canvas = FigureCanvasAgg(figure)
    buffer = BytesIO()
    with warnings.catch_warnings():
        # A title may have letters that the font lacks; Matplotlib draws boxes in their place.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        if form == "png":
            canvas.draw()
            # Nothing is transparent: without that channel, encoding takes half the time.
            pixels = Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba())
            image = pixels.convert("RGB")
            if colours is not None:
                image = image.quantize(colours, kmeans=3)  # so that small marks keep their colours
            image.save(buffer, form, compress_level=3 if colours is None else 9, dpi=(DPI, DPI))
        else:
            no_date: Any = {"Date" if form == "svg" else "CreationDate": None}
            figure.savefig(buffer, format=form, dpi=DPI, metadata=no_date)
    return buffer.getvalue()


@dataclass(frozen=True)
class Paper:
    """A figure or axes, on which places are in inches right of and below the upper left corner."""

    canvas: Figure | Axes
    width: float
    """Width, in inches."""
    height: float
    """Height, in inches."""

    @classmethod
    def new(cls, width: float, height: float, dpi: float = DPI) -> Paper:
        """Return an empty figure as paper; sizes are in inches."""
        return cls(Figure(figsize=(width, height), dpi=dpi, facecolor="white"), width, height)

    @classmethod
    def on(cls, axes: Axes) -> Paper:
        """Return existing axes as paper of their present size."""
        box, dpi = axes.bbox, axes.figure.dpi
        return cls(axes, box.width / dpi, box.height / dpi)

    def text(self, x: float, y: float, text: str, *, size: float, **style: Any) -> Any:
        """Write a text at a place; ``size`` is in points, ``style`` as for Matplotlib's `Text`."""
        style = {"va": "baseline", "transform": self._unit_square, **style}
        return self.canvas.text(x / self.width, 1.0 - y / self.height, text, size=size, **style)

    def bar(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """Draw a filled rectangle; ``x`` and ``y`` are its upper left corner."""
        left, bottom, right_by, up_by = self._shares(x, y, width, height)
        style: Any = {"facecolor": colour, "edgecolor": "none", "transform": self._unit_square}
        self.canvas.add_artist(Rectangle((left, bottom), right_by, up_by, **style))

    def line(self, xs: Sequence[float], ys: Sequence[float], **style: Any) -> None:
        """Draw a line through points; ``style`` as for Matplotlib's `Line2D`."""
        x_shares = [x / self.width for x in xs]
        y_shares = [1.0 - y / self.height for y in ys]
        self.canvas.add_artist(Line2D(x_shares, y_shares, transform=self._unit_square, **style))

    def axes(
        self, x: float, y: float, width: float, height: float, *, bare: bool = True, **style: Any
    ) -> Axes:
        """Return new axes; ``x`` and ``y`` are their upper left corner.

        Bare axes have neither ticks nor an edge. ``style`` is as for Matplotlib's `add_axes`.
        """
        place = self._shares(x, y, width, height)
        canvas: Any = self.canvas
        add = canvas.add_axes if isinstance(canvas, Figure) else canvas.inset_axes
        axes: Axes = add(place, **style)
        if bare:
            axes.set(xticks=[], yticks=[])
            axes.spines[:].set_visible(False)
        return axes

    @property
    def figure(self) -> Figure:
        """The figure, or the figure of the axes."""
        canvas = self.canvas
        figure = canvas if isinstance(canvas, Figure) else canvas.figure
        assert isinstance(figure, Figure)
        return figure

    @property
    def _unit_square(self) -> Any:
        """Transform of the unit square to the paper."""
        canvas = self.canvas
        return canvas.transFigure if isinstance(canvas, Figure) else canvas.transAxes

    def _shares(
        self, x: float, y: float, width: float, height: float
    ) -> tuple[float, float, float, float]:
        """Return left, bottom, width and height of a rectangle in shares of the paper."""
        bottom = 1.0 - (y + height) / self.height
        return x / self.width, bottom, width / self.width, height / self.height


def _printable(text: str) -> str:
    """Return ``text`` on one line, without characters that a picture file cannot hold."""
    return "".join(letter for letter in " ".join(text.split()) if letter.isprintable())


def one_line(text: str, most: int) -> str:
    """Return ``text`` on one line, cut to at most ``most`` letters."""
    text = _printable(text)
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


def wrapped(text: str, width: int, most: int) -> list[str]:
    """Return ``text`` in at most ``most`` lines of at most ``width`` letters each."""
    return textwrap.wrap(_printable(text), width, max_lines=most, placeholder=" …")
