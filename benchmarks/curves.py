# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves of cost against size: fitted exponents, and plots with logarithmic axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from fipt_blender.core.run.runfolder import atomic_path

_COLORS = ("#c0392b", "#2471a3", "#1e8449", "#b9770e", "#6c3483", "#626567")
_WIDTH, _HEIGHT = 900, 560
_LEFT, _TOP, _RIGHT, _BOTTOM = 90, 50, 250, 60


def fit_exponent(sizes: Sequence[float], values: Sequence[float | None]) -> float | None:
    """Exponent b of values = a sizes^b, by least squares of logarithms; None without two positive values."""
    known = [(size, value) for size, value in zip(sizes, values, strict=True) if value and value > 0.0]
    if len({size for size, _ in known}) < 2:
        return None
    x, y = np.log(np.array(known, np.float64)).T
    x -= x.mean()
    return float((x * y).sum() / (x * x).sum())


def draw_curves(
    title: str, sizes: Sequence[float], lines: Mapping[str, Sequence[float | None]]
) -> Image.Image:
    """Plot lines over the sizes with logarithmic axes; the legend contains the exponents.

    Args:
        title: above the plot.
        sizes: (n,) above zero.
        lines: (n,) values by name; None and zero are not drawn. An empty line still takes its colour.
    """
    font = ImageFont.load_default(15)
    image = Image.new("RGB", (_WIDTH, _HEIGHT), "white")
    draw = ImageDraw.Draw(image)
    values = [value for line in lines.values() for value in line if value and value > 0.0]
    low, high = np.log10(min(values, default=1.0)), np.log10(max(values, default=10.0))
    bottom, top = np.floor(low), max(np.ceil(high), np.floor(low) + 1.0)
    first, last = np.log10(min(sizes)), np.log10(max(sizes))
    span = max(last - first, 1e-9)

    def place(size: float, value: float) -> tuple[float, float]:
        x = _LEFT + (np.log10(size) - first) / span * (_WIDTH - _LEFT - _RIGHT)
        y = _HEIGHT - _BOTTOM - (np.log10(value) - bottom) / (top - bottom) * (_HEIGHT - _TOP - _BOTTOM)
        return float(x), float(y)

    draw.text((_LEFT, 14), title, fill="black", font=ImageFont.load_default(18))
    for decade in range(int(bottom), int(top) + 1):
        _, y = place(min(sizes), 10.0**decade)
        draw.line([(_LEFT, y), (_WIDTH - _RIGHT, y)], fill="#dddddd")
        draw.text((_LEFT - 8, y), f"{10.0**decade:g}", fill="black", font=font, anchor="rm")
    for size in sizes:
        x, y = place(size, 10.0**bottom)
        draw.line([(x, _TOP), (x, y)], fill="#dddddd")
        text = f"{size:g}" if size < 1e4 else f"{size:.1e}"
        draw.text((x, y + 10), text, fill="black", font=font, anchor="ma")
    shown = 0
    for number, (name, line) in enumerate(lines.items()):
        if not any(line):
            continue
        color = _COLORS[number % len(_COLORS)]
        points = [place(size, value) for size, value in zip(sizes, line, strict=True) if value and value > 0]
        if len(points) > 1:
            draw.line(points, fill=color, width=3)
        for x, y in points:
            draw.ellipse([x - 4, y - 4, x + 4, y + 4], fill=color)
        exponent = fit_exponent(sizes, line)
        text = name if exponent is None else f"{name}, exponent {exponent:.2f}"
        draw.text((_WIDTH - _RIGHT + 16, _TOP + 24 * shown), text, fill=color, font=font)
        shown += 1
    return image


def write_pictures(rows: Sequence[Sequence[Image.Image]], path: Path) -> None:
    """Write the pictures of :func:`draw_curves`, given in rows, to one PNG."""
    columns = max((len(row) for row in rows), default=1)
    page = Image.new("RGB", (columns * _WIDTH, max(len(rows), 1) * _HEIGHT), "white")
    for down, row in enumerate(rows):
        for right, picture in enumerate(row):
            page.paste(picture, (right * _WIDTH, down * _HEIGHT))
    with atomic_path(path) as temporary:
        page.save(temporary)
