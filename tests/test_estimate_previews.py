# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures that a run shows while it works."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fipt_blender.core.capture.images import write_exr
from fipt_blender.core.capture.views import View
from fipt_blender.core.estimate.previews import Preview
from fipt_blender.core.optics.lights import EmitterTable
from fipt_blender.core.pixels.store import fill_pixels, open_pixels
from samples.small_rooms import make_room, table

WIDTH, HEIGHT = 24, 16


def downward_view(folder: Path, name: str, x: float, height: float) -> View:
    """A camera that looks straight down at (x, 0, 0)."""
    image = folder / f"{name}.exr"
    write_exr(image, np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [x, 0.0, height]
    return View(name, "train", image, WIDTH, HEIGHT, 20.0, 20.0, WIDTH / 2, HEIGHT / 2, pose)


@pytest.fixture
def preview(tmp_path: Path) -> Preview:
    """Of a floor, mostly shown by the first view, and of a panel beside it, only shown by the second."""
    room = make_room(
        [[[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], [[9, -1, 0], [10, -1, 0], [10, 1, 0], [9, 1, 0]]]
    )
    views = [downward_view(tmp_path, "floor", 0.0, 4.0)]
    views.append(downward_view(tmp_path, "panel", 9.5, 2.0))
    pixels = open_pixels(tmp_path / "pixels", views, create=True)
    fill_pixels(pixels, room, lambda done: None)
    return Preview(tmp_path / "previews", pixels, np.array([0, 0, 1, 1]))


def pictures(preview: Preview, emitters: EmitterTable) -> list[np.ndarray]:
    """Base colour and emission."""

    def colors(rows: np.ndarray) -> np.ndarray:
        return np.full((len(rows), 3), 0.5, np.float32)

    return [np.asarray(Image.open(path)) for path in preview.estimate("training", colors, emitters)]


def test_emission_is_of_a_view_that_shows_a_lamp(preview: Preview) -> None:
    color, emission = pictures(preview, table([2, 3], [30.0, 30.0, 30.0]))
    assert emission.max() > 200 and color.min() > 0  # the whole picture of the base color shows the floor


def test_emission_is_of_the_same_view_where_that_shows_a_lamp(preview: Preview) -> None:
    color, emission = pictures(preview, table([0], [30.0, 30.0, 30.0]))
    lit = emission.max(axis=2) > 200
    assert lit.any() and not lit.all() and (lit == (color.max(axis=2) == 0)).all()


def test_without_lamps_emission_is_black(preview: Preview) -> None:
    assert not pictures(preview, EmitterTable.empty())[1].any()
