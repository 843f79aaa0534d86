# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the radiance cache leaves out beside emitters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from fipt_blender.core.light.observations import observe
from samples.panel_pixels import IS_PANEL, PARTS, ROOM, SETTINGS, WALL_RADIANCE, make_pixels


@pytest.mark.parametrize("rim_width", [1, 2])
def test_rim_pixels_of_an_emitter_stay_out_of_the_cache(tmp_path: Path, rim_width: int) -> None:
    """A bright rim one pixel wide is the lamp's own light: cells beside the lamp keep the wall's radiance."""
    pixels = make_pixels(tmp_path / "pixels", 6)
    for index, view in enumerate(pixels.views):
        rows = pixels.rows(index)
        on_panel = (np.asarray(pixels.triangle[rows]) >= 12).reshape(view.height, view.width)
        rim = binary_dilation(on_panel, np.ones((3, 3)), iterations=rim_width).ravel()
        pixels.own[rows] = np.where(rim, 100.0, WALL_RADIANCE)[:, None]
    cache = observe(ROOM, pixels, PARTS, SETTINGS, tmp_path / "observed").cache(without=IS_PANEL)
    assert (cache == WALL_RADIANCE).all() == (rim_width == 1)
