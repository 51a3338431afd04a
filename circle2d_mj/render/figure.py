"""Figures made of pictures, with titles and the scale of heat maps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from circle2d_mj.core.view import Picture
from circle2d_mj.render.canvas import REGION, heat_colours

PAPER, INK, FAINT = (255, 255, 255), (20, 20, 20), (85, 85, 85)


def figure(
    rows: Sequence[Sequence[Picture | None]],
    columns: Sequence[str],
    *,
    title: str = "",
    row_titles: Sequence[str] = (),
    captions: Sequence[Sequence[str]] = (),
    most_visits: int | None = None,
) -> Picture:
    """Arrange pictures of equal size in rows: [height, width, 3] uint8.

    None leaves a gap. columns: title of each column; title: title of the figure; row_titles: title
    of each row, on its left, with one line or more; captions: a line below each picture;
    most_visits: draw the scale of heat maps at the bottom; the darkest colour stands for this many
    visits or more.
    """
    size = next(len(picture) for row in rows for picture in row if picture is not None)
    text, small = _font(size, 17), _font(size, 20)
    # Column titles must not be wider than pictures. 0.95: small type is wider than in proportion.
    too_wide = max(1.0, max((_width(text, t) / (0.95 * size) for t in columns), default=1.0))
    gap = size // 24
    left = gap + (max((_width(text, t) for t in row_titles), default=-gap) + gap)
    above, below = 2 * gap if any(columns) else gap, gap + (gap * 5 // 4 if captions else 0)
    head = gap // 2 + (2 * gap if title else 0)
    width = left + len(columns) * (size + gap)
    height = head + above + len(rows) * (size + below) + (5 * gap // 2 if most_visits else 0)
    image = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(image)
    draw.text((width // 2, head // 2), title, INK, _font(size, 15), anchor="mm")
    for column, words in enumerate(columns):
        middle = left + column * (size + gap) + size // 2
        draw.text((middle, head + above // 2), words, INK, _font(size, 17 * too_wide), anchor="mm")
    for row, pictures in enumerate(rows):
        top = head + above + row * (size + below)
        if row_titles:
            draw.multiline_text((gap, top + size // 2), row_titles[row], INK, text, anchor="lm")
        for column, picture in enumerate(pictures):
            corner = left + column * (size + gap)
            if picture is not None:
                image.paste(Image.fromarray(picture), (corner, top))
                draw.rectangle((corner, top, corner + size - 1, top + size - 1), outline=REGION)
            if captions:
                place = (corner + size // 2, top + size + gap * 4 // 5)
                draw.text(place, captions[row][column], FAINT, _font(size, 23), anchor="mm")
    if most_visits:
        _draw_scale(image, draw, small, gap, most_visits)
    return np.asarray(image)


def _draw_scale(
    image: Image.Image,
    draw: ImageDraw.ImageDraw,
    font: ImageFont.FreeTypeFont,
    gap: int,
    most_visits: int,
) -> None:
    """Draw the scale of heat maps at the bottom of the figure, horizontally centred."""
    length, height = min(image.width // 3, 12 * gap), gap * 3 // 4
    words = ("1 visit", f"{most_visits:,} visits and more (logarithmic)")
    # Centre the bar and its words together; the words on the right are longer.
    aside = (_width(font, words[1]) - _width(font, words[0])) // 2
    left, top = (image.width - length) // 2 - aside, image.height - 2 * gap
    colours = heat_colours(np.linspace(0.0, 1.0, length))
    image.paste(Image.fromarray(np.repeat(colours[None], height, axis=0)), (left, top))
    middle = top + height // 2
    draw.text((left - gap // 2, middle), words[0], FAINT, font, anchor="rm")
    draw.text((left + length + gap // 2, middle), words[1], FAINT, font, anchor="lm")


def _font(size: int, lines: float) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size / lines)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font


def _width(font: ImageFont.FreeTypeFont, text: str) -> int:
    return round(max(map(font.getlength, text.split("\n"))))
