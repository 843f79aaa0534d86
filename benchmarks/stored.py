# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The closed-form estimate of a finished run, made again from its stored pixels and shadings.

Import after Mitsuba's variant was set.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.metrics import ClosedForm
from fipt_blender.core.estimate.state import estimation_views
from fipt_blender.core.light.baking import open_shadings
from fipt_blender.core.light.observations import observe
from fipt_blender.core.light.shadings import roughness_levels
from fipt_blender.core.material.closed_form import fit_cells
from fipt_blender.core.material.training_input import training_input
from fipt_blender.core.run.runfolder import RunFolder
from fipt_blender.core.run.settings import Settings
from fipt_blender.core.scene.labels import choose_parts, room_pieces
from fipt_blender.core.scene.pixels import open_pixels
from fipt_blender.core.scene.room import load_room


class StoredEstimate:
    """Pixels and shadings of a finished run, which is only read, whatever code made it.

    Args:
        run: has kept its stage folder.
        settings: of the run.
        scratch: empty folder for what follows from the pixels.

    Attributes:
        views: whose pixels are stored.

    Raises:
        FiptError: where an array can't be read or does not fit.
    """

    def __init__(self, run: RunFolder, settings: Settings, scratch: Path) -> None:
        room = load_room(run)
        self._segments = None if room.scan is None else room_pieces(room)
        self.views = estimation_views(run, settings)
        self.pixels = open_pixels(run.stage / "pixels", self.views)
        bounds = zip(self.pixels.ranges[:-1], self.pixels.ranges[1:], strict=True)
        triangles = [np.asarray(self.pixels.triangle[first:last]) for first, last in bounds]
        parts = choose_parts(room, self.views, triangles)
        self._pieces = None if parts.kind == "part" else room_pieces(room)
        self._observations = observe(room, self.pixels, parts, settings, scratch)
        levels = (settings.roughness_levels, settings.roughness_min, settings.roughness_spacing)
        self._levels = roughness_levels(*levels)
        self._shadings = open_shadings(run.stage / "shadings", len(self.pixels), len(self._levels))

    def closed_form(self, settings: Settings) -> ClosedForm:
        """The estimate with other settings; those of earlier stages have no effect."""
        data = training_input(
            self._observations, self._pieces, self._shadings, self._levels, settings, segments=self._segments
        )
        cells, _ = fit_cells(data)
        rows = np.asarray(self._observations.pool)
        values = cells.values[cells.of_pixels(data, rows)]
        material = np.where((data.group >= 0)[:, None], data.materials.of_pixels[data.group], np.nan)
        return ClosedForm(rows, values[:, :3] * (1.0 - values[:, 4:]), *material.T)
