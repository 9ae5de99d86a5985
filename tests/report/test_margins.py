"""The picture of margins: its texts, bars and marks."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from made_up_margins import margins
from PIL import Image

from frenetic.errors import FreneticError
from frenetic.report.margins import draw_margins


def texts_of(path: Path) -> list[str]:
    """Return the texts of an SVG picture."""
    return re.findall(r"<text[^>]*>([^<]*)</text>", path.read_text(encoding="utf-8"))


def test_a_picture_names_quantities_amounts_and_ranges(tmp_path: Path) -> None:
    path = tmp_path / "m.svg"
    draw_margins(margins(), path)
    texts = texts_of(path)
    for text in ("more delay", "0.3 s", "1 s", "less friction", "never", "0.01", "usual"):
        assert text in texts, texts
    assert any("80 random roads of rural &lt;80&gt; $x$" in text for text in texts)
    assert any("Diamond: first failure on the 2 most demanding roads" in text for text in texts)
    without = tuple(replace(margin, demanding=()) for margin in margins().margins)
    draw_margins(replace(margins(), margins=without), path)
    assert not any("Diamond" in text for text in texts_of(path))


def test_a_bar_is_as_long_as_its_share_of_the_range(tmp_path: Path) -> None:
    path = tmp_path / "m.png"
    draw_margins(margins(), path)
    with Image.open(path) as picture:
        pixels = picture.convert("RGB")
        colours = [pixels.getpixel((x, 115)) for x in range(pixels.width)]  # in the first bar
        blue = sum(colour == (11, 95, 165) for colour in colours)
        axes_width = (11.0 - 3.45 - 2.1) * 110
        assert blue == pytest.approx(0.3 * axes_width, abs=20)


def test_another_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FreneticError, match=r"must end with \.png, \.svg or \.pdf"):
        draw_margins(margins(), tmp_path / "m.gif")
