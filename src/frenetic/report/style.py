"""Style and files of all pictures."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

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

STYLE: Final[dict[str, Any]] = {
    "font.family": ["sans-serif"],
    "font.sans-serif": ["DejaVu Sans", "Verdana"],  # as wide: for SVGs shown elsewhere
    "font.size": 9.0,
    "text.usetex": False,
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


def form_of(path: Path) -> str:
    """The form of a picture by its suffix: png, svg or pdf.

    Raises:
        FreneticError: another suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        allowed = ", ".join(SUFFIXES[:-1]) + f" or {SUFFIXES[-1]}"
        raise FreneticError(f"cannot draw {path}: a picture's name must end with {allowed}")
    return suffix[1:]


def write_figure(figure: Figure, path: Path, form: str) -> None:
    """Draws a picture and writes it whole or not at all.

    Raises:
        FreneticError: the file cannot be written.
    """
    FigureCanvasAgg(figure)
    undated: dict[str, dict[str, Any]] = {
        "png": {},
        "svg": {"Date": None},
        "pdf": {"CreationDate": None},
    }
    drawn = BytesIO()
    with warnings.catch_warnings():
        # A title may have letters that the font lacks; boxes in their place suffice.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(drawn, format=form, dpi=DPI, metadata=undated[form])
    path = Path(path)
    try:
        with replacing(path) as partial:
            partial.write_bytes(drawn.getvalue())
    except OSError as error:
        raise FreneticError(
            f"cannot write the picture {path}: {error.strerror or error}"
        ) from error


@dataclass(frozen=True)
class Paper:
    """A figure on which things are placed in inches from the upper left corner."""

    figure: Figure
    width: float
    height: float

    def text(self, x: float, y: float, text: str, *, size: float, **how: Any) -> Any:
        """Writes a text."""
        how.setdefault("va", "baseline")
        return self.figure.text(
            x / self.width, 1.0 - y / self.height, text, size=size, parse_math=False, **how
        )

    def axes(self, x: float, y: float, width: float, height: float) -> Any:
        """Axes for a chart."""
        return self.figure.add_axes(
            (
                x / self.width,
                1.0 - (y + height) / self.height,
                width / self.width,
                height / self.height,
            )
        )

    def bar(self, x: float, y: float, width: float, height: float, colour: str) -> None:
        """A filled rectangle."""
        self.figure.add_artist(
            Rectangle(
                (x / self.width, 1.0 - (y + height) / self.height),
                width / self.width,
                height / self.height,
                facecolor=colour,
                edgecolor="none",
            )
        )

    def line(self, xs: Sequence[float], ys: Sequence[float], **how: Any) -> None:
        """A line through points."""
        self.figure.add_artist(
            Line2D([x / self.width for x in xs], [1.0 - y / self.height for y in ys], **how)
        )

    def panel(self, x: float, y: float, width: float, height: float) -> Any:
        """Axes of so many points (1/72 inch), whose data are points from their centre."""
        axes = self.axes(x, y, width / POINT, height / POINT)
        axes.set_facecolor(PANEL)
        axes.set_xlim(-width / 2.0, width / 2.0)
        axes.set_ylim(-height / 2.0, height / 2.0)
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_visible(False)
        return axes


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
