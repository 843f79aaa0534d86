"""Memory does not grow with the number of views, because data per pixel is stored in files."""

from __future__ import annotations

import io
import os
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from fipt_blender.core.checks import consistency
from fipt_blender.core.checks.view_check import ViewCheck, check_views
from fipt_blender.core.light import emitters, environment, observations
from fipt_blender.core.light.baking import open_shadings
from fipt_blender.core.light.emitters import bright_triangles, group_fixtures
from fipt_blender.core.light.observations import Observations, observe
from fipt_blender.core.material import training_input as training_input_module
from fipt_blender.core.material.closed_form import fit_cells
from fipt_blender.core.material.hints import place_hints
from fipt_blender.core.material.training_input import material_units, training_input
from fipt_blender.core.parts.labels import NO_PART, Parts
from fipt_blender.core.pixels.store import NO_TRIANGLE, PixelStore
from fipt_blender.core.run.messages import Reporter
from fipt_blender.core.surface.room import Room
from samples.panel_pixels import IS_PANEL, PARTS, ROOM, SETTINGS, make_pixels

# An array of one number a pixel, of the smallest kind that is kept, would be four bytes.
MOST_BYTES = 2.0
NO_PARTS = Parts(np.full(len(ROOM.triangles), NO_PART, np.int32), "none")


def peak(action: Callable[[], object]) -> int:
    """Peak bytes of numpy and Python; mapped files do not count."""
    tracemalloc.start()
    try:
        action()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def lamps(pixels: PixelStore, room: Room) -> None:
    marked = bright_triangles(room, pixels)
    assert marked.triangles.tolist() == [12, 13]
    # Of a lamp, whose pixels are few, all are looked at together; here there is none.
    assert group_fixtures(room, np.zeros(len(room.triangles), bool), pixels) == []


def everything(seen: Observations) -> None:
    seen.cache()
    seen.cache(without=IS_PANEL)
    assert len(seen.part) == len(seen.donor) == len(seen.pixels)


def agreement_of(pixels: PixelStore, room: Room) -> None:
    assert check_views(pixels, room, PARTS.triangle_part, SETTINGS, Reporter(io.StringIO())) == ViewCheck()


def window(pixels: PixelStore) -> None:
    """Make the upper third of each photograph show the outside."""
    for index in range(len(pixels.views)):
        rows = pixels.rows(index)
        above = slice(rows.start, rows.start + (rows.stop - rows.start) // 3)
        pixels.triangle[above], pixels.pure[above] = NO_TRIANGLE, True


def learn_from(seen: Observations) -> None:
    levels = np.array([0.1, 0.5, 1.0], np.float32)
    shadings = open_shadings(seen.folder, len(seen.pixels), levels, create=True)
    hints = place_hints([], ROOM.vertices, ROOM.triangles, seen.parts, seen.surface)
    data = training_input(seen, shadings, SETTINGS, hints)
    cells = fit_cells(data)
    assert 0 < len(cells.keys) < len(seen.pixels)
    units = material_units(data)
    assert len(units.triangle) == len(seen.parts.triangle_part)


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[PixelStore, Observations]]:
    """Pixels of few and of many views, and what is known of them."""
    folder, found = tmp_path_factory.mktemp("captures"), []
    for views in (6, 18):
        pixels = make_pixels(folder / f"{views}", views)
        found.append((pixels, observe(ROOM, pixels, PARTS, SETTINGS, folder / f"observed {views}")))
    return found


@pytest.mark.parametrize(
    "action", ["observe", "look up", "lamps", "agree", "learn", "learn without parts", "look outside"]
)
def test_memory_of_the_views(action: str, captures: list, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Smaller than these captures, as their usual sizes are smaller than large ones.
    monkeypatch.setattr(emitters, "CHUNK", 4096)
    monkeypatch.setattr(observations, "FOOTPRINT_PIXELS", 1000)
    monkeypatch.setattr(consistency, "GAIN_PIXELS", 5000)
    monkeypatch.setattr(environment, "MAX_PIXELS", 3)
    monkeypatch.setattr(training_input_module, "PROJECTION_PIXELS", 500)
    # How many views are in memory at the same moment is otherwise chance.
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    peaks, sizes = [], []
    for pixels, known in (captures[0], *captures):  # the first warms up
        if action == "look outside":
            pixels = make_pixels(tmp_path / f"{len(sizes)}", len(pixels.views))
            window(pixels)
        actions: dict[str, Callable[[], object]] = {
            "look up": partial(everything, known),
            "lamps": partial(lamps, pixels, ROOM),
            "agree": partial(agreement_of, pixels, ROOM),
            "learn": partial(learn_from, known),
            "learn without parts": partial(learn_from, replace(known, parts=NO_PARTS)),
        }
        again = partial(observe, ROOM, pixels, PARTS, SETTINGS, tmp_path / "observed")
        peaks.append(peak(actions.get(action, again)))
        sizes.append(len(pixels))
    slope = (peaks[2] - peaks[1]) / (sizes[2] - sizes[1])
    assert slope < MOST_BYTES, f"{slope:.1f} bytes a pixel"
