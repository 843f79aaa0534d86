# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photographs that do not fit the others are left out or brought to their exposure, and named in messages."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ..light.agreement import (
    SurfaceCells,
    describe,
    exposure_gains,
    misaligned_views,
    surface_cells,
    unlike_exposures,
)
from ..light.observations import median_footprint
from ..light.unmeshed import shown_by, unmeshed_lights
from ..scene.pixels import LEFT_OUT, PixelStore
from ..scene.room import Room
from .messages import Reporter
from .settings import Settings


@dataclass(frozen=True)
class ViewCheck:
    """What was done to single views.

    Attributes:
        left_out: name of each misaligned view to the pixels by which it is off.
        exposure: name of each view that was exposed otherwise to the factor by which it was brighter.
        lamps: positions in metres of lamps that the mesh lacks.
    """

    left_out: dict[str, float] = field(default_factory=dict)
    exposure: dict[str, float] = field(default_factory=dict)
    lamps: list[list[float]] = field(default_factory=list)

    def facts(self) -> dict[str, Any]:
        """For statistics.json."""
        return asdict(self)


def check_views(
    pixels: PixelStore, room: Room, part: np.ndarray, settings: Settings, reporter: Reporter
) -> ViewCheck:
    """Leave misaligned views out of the pixels and bring all to one exposure, as the settings allow.

    Args:
        pixels: changed in place: pixels of misaligned views become LEFT_OUT, radiance is divided by gains.
        part: (T,) int part of each triangle, negative without.
        reporter: gets the warnings ``view-misaligned``, ``view-exposure`` and ``lamp-without-mesh``.
    """
    found = ViewCheck()
    if len(pixels.views) < 2:
        return found
    cells = surface_cells(pixels, room, part, median_footprint(pixels))
    gains = exposure_gains(cells)
    if settings.reject_views:
        fits = misaligned_views(cells, gains)
        if fits:
            found.left_out.update({pixels.views[i].name: round(fit.shift, 1) for i, fit in fits.items()})
            texts = {index: f"about {fit.shift:.0f} pixels off" for index, fit in fits.items()}
            reporter.warning(
                "view-misaligned",
                f"{len(fits)} of {len(pixels.views)} photographs do not lie where their cameras say and are "
                f"left out: {describe(pixels.views, texts)}.",
                "Mend their camera poses, or set reject_views to false to use them all the same.",
            )
            for index in fits:
                part_of = slice(int(pixels.ranges[index]), int(pixels.ranges[index + 1]))
                pixels.triangle[part_of] = LEFT_OUT
                pixels.pure[part_of] = False
            gains = exposure_gains(cells)
    if settings.correct_exposure:
        unlike = unlike_exposures(gains)
        if len(unlike):
            texts = {int(i): f"× {gains[i]:.2f}" for i in unlike}
            found.exposure.update({pixels.views[i].name: round(float(gains[i]), 4) for i in unlike})
            reporter.warning(
                "view-exposure",
                f"{len(unlike)} of {len(pixels.views)} photographs are exposed otherwise than the rest; this "
                f"is corrected: {describe(pixels.views, texts)}.",
                "Nothing needs to be done, unless that is wrong: set correct_exposure to false then.",
            )
            for index in unlike:
                part_of = slice(int(pixels.ranges[index]), int(pixels.ranges[index + 1]))
                pixels.radiance[part_of] /= np.float32(gains[index])
    found.lamps.extend(_leave_out_unmeshed(cells, settings, reporter))
    return found


def _leave_out_unmeshed(cells: SurfaceCells, settings: Settings, reporter: Reporter) -> list[list[float]]:
    """Leave out the pixels that show a lamp which the mesh lacks; the lamps' positions in metres.

    They would paint the lamp onto the walls behind, as bright albedo or as phantom emitters.
    """
    pixels = cells.pixels
    footprint = median_footprint(pixels)
    lamps = unmeshed_lights(cells, footprint, np.random.default_rng([settings.seed, 4]))
    for lamp in lamps:
        shown = shown_by(pixels, lamp, 1.5 * footprint)
        pixels.triangle[shown] = LEFT_OUT
        pixels.pure[shown] = False
    positions = [[round(float(x), 3) for x in lamp.position] for lamp in lamps]
    if lamps:
        places = "; ".join(
            f"({x:.2f}, {y:.2f}, {z:.2f}) m, in {lamp.views} photographs"
            for (x, y, z), lamp in zip(positions, lamps, strict=True)
        )
        reporter.warning(
            "lamp-without-mesh",
            f"The photographs show {len(lamps)} lamps where the mesh has nothing: {places}. Those pixels are "
            "left out, but the light of these lamps is not explained.",
            "Model each lamp there (a simple shape of its size will do) and run again.",
        )
    return positions
