"""Style and files of all pictures."""

from __future__ import annotations

import warnings
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from frenetic._support.files import replacing
from frenetic.errors import FreneticError

SUFFIXES: Final = (".png", ".svg", ".pdf")
"""Valid suffixes of a picture's file."""
DPI: Final = 110

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
