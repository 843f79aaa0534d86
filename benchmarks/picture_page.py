"""An HTML page with pictures of ground truth, prediction and error side by side."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from PIL import Image

from benchmarks.metrics import Maps
from fipt_blender.core.report.comparison import tone_mapped
from fipt_blender.core.run.runfolder import atomic_path

ERROR_GAIN = 4.0

_TEMPLATE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Accuracy</title>
<style>
body { font-family: sans-serif; margin: 2em; background: #fff; color: #222 }
table { border-collapse: collapse } td, th { padding: .2em .8em; text-align: right }
td:first-child, th:first-child { text-align: left } img { width: 24em; image-rendering: pixelated }
</style>
<h1>Accuracy</h1>
<table><tr><th></th>{% for title in titles %}<th>{{ title }}</th>{% endfor %}</tr>
{% for name, values in rows %}<tr><td>{{ name }}</td>{% for value in values %}<td>{{ value }}</td>
{% endfor %}</tr>{% endfor %}</table>
{% for view, strips in views.items() %}<h2>{{ view }}</h2>
{% for title, files in strips %}<p>{{ title }}: truth, prediction, error &times; {{ gain }}<br>
{% for file in files %}<img src="{{ file }}" alt=""> {% endfor %}</p>
{% endfor %}{% endfor %}</html>
"""


class PicturePage:
    """Collects pictures and then writes the page.

    Args:
        folder: where index.html and the pictures go.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._views: dict[str, list[tuple[str, list[str]]]] = {}

    def add_maps(self, view: str, predicted: Maps, true: Maps) -> None:
        """Add all maps of a view."""
        for name in ("kd", "a_prime", "roughness", "metallic", "emission"):
            one, other = getattr(predicted, name), getattr(true, name)
            if name == "emission":
                one, other = tone_mapped(one), tone_mapped(other)
            self._add(view, name, one, other)

    def add_images(self, view: str, title: str, predicted: np.ndarray, true: np.ndarray) -> None:
        """Add a rendered image (H, W, 3), linear radiance."""
        self._add(view, title, tone_mapped(predicted), tone_mapped(true))

    def _add(self, view: str, title: str, predicted: np.ndarray, true: np.ndarray) -> None:
        files = []
        for kind, values in (
            ("truth", true),
            ("prediction", predicted),
            ("error", np.abs(predicted - true) * ERROR_GAIN),
        ):
            name = f"{view}_{title}_{kind}.png".replace("/", "_").replace(" ", "_").replace(",", "")
            pixels = np.round(np.clip(np.nan_to_num(values), 0.0, 1.0) * 255.0).astype(np.uint8)
            with atomic_path(self._folder / name) as temporary:
                Image.fromarray(pixels).save(temporary)
            files.append(name)
        self._views.setdefault(view, []).append((title, files))

    def write(self, result: dict[str, Any]) -> None:
        """Write index.html with the pictures and a table of the figures of `accuracy.score`."""
        groups = [(split, figures) for split, figures in result.items() if isinstance(figures, dict)]
        titles, columns = [], []
        for split, figures in groups:
            titles += [f"{split}, {kind}" for kind in ("paper", "strict", "edge", "inside")]
            columns += [figures, figures["strict"], figures["edge"], figures["inside"]]
        names = [name for name in groups[0][1]["strict"]] if groups else []
        rows = [(name, [_text(column.get(name)) for column in columns]) for name in names]
        environment = jinja2.Environment(autoescape=True)
        page = environment.from_string(_TEMPLATE).render(
            titles=titles, rows=rows, views=self._views, gain=ERROR_GAIN
        )
        with atomic_path(self._folder / "index.html") as temporary:
            temporary.write_text(page, encoding="utf-8")


def _text(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
